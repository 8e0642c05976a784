"""Compare models of small photographs with and without a lower peak threshold where features run out, side by side.

    python benchmarks/thresholds.py [fountain-p11] [sceaux] [--sizes 640 860 1000]

The photographs are made grey and scaled to a size of the longer side in pixels. `COLMAP's` is its own peak threshold,
given in `features.colmap`; `lower` is the default. For each: photographs extracted again, features, verified matches,
and of a mapping registered photographs, points, reprojection error and, of fountain-p11, whose poses are known, the
error of positions after a similarity. Core seconds are of features and matches. A mapping is the same with every seed;
sizes that are nearly the same show what is chance.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import MappingProxyType

import numpy as np
from calibration import truth_of
from guard_sets import DATA
from lens_sets import position_error_mm
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.colmap.calibration.calibrate import Known
from colmap_ihe.colmap.features import extract_features
from colmap_ihe.colmap.lower_thresholds import COLMAPS_THRESHOLD
from colmap_ihe.colmap.mapping import map_images
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.project.options import CameraOptions, FeaturesOptions, SparseOptions

_CHOICES = {"COLMAP's": {"sift": {"peak_threshold": COLMAPS_THRESHOLD}}, "lower": {}}
_COLUMNS = (
    "set",
    "threshold",
    "again",
    "features",
    "matches",
    "registered",
    "points",
    "error px",
    "position error mm",
    "core s",
)


def write_scaled(name: str, size: int, folder: Path) -> list[str]:
    """Write the photographs of a set in grey; return their names."""
    folder.mkdir(parents=True)
    names = []
    for file in sorted((DATA / name).glob("*.[jJ][pP][gG]")):
        with Image.open(file) as picture:
            scale = size / max(picture.size)
            sides = (round(picture.width * scale), round(picture.height * scale))
            picture.convert("L").resize(sides, Image.Resampling.LANCZOS).save(folder / f"{file.name}.png")
        names.append(f"{file.name}.png")
    return names


def core_seconds() -> float:
    spent = os.times()
    return spent.user + spent.system


def measured(
    folder: Path, names: list[str], choice: str, poses: Mapping[str, NDArray[np.float64]]
) -> list[str]:
    """Return the cells of a row."""
    root = folder / choice
    root.mkdir()
    database = root / "database.db"
    options = FeaturesOptions.model_validate({"colmap": _CHOICES[choice]})
    camera = CameraOptions(mode="single")
    begun = core_seconds()
    with ThreadPoolExecutor(2) as executor:
        counts = extract_features(
            database, folder / "grey", names, None, camera, options, root, executor, SILENT
        )
    pycolmap.match_exhaustive(database)
    spent = core_seconds() - begun
    with pycolmap.Database.open(database) as opened:
        matches = opened.num_inlier_matches()
    model = mapped(root, folder / "grey", len(names))
    return [
        f"{counts.extracted_again} of {len(names)}",
        f"{counts.features:,}",
        f"{matches:,}",
        f"{model.num_reg_images()}",
        f"{model.num_points3D():,}",
        f"{model.compute_mean_reprojection_error():.3f}",
        f"{position_error_mm(model, poses):.2f}" if poses else "-",
        f"{spent:.0f}",
    ]


def mapped(
    root: Path, grey: Path, images: int, seed: int = 0, colmap: Mapping[str, float] = MappingProxyType({})
) -> pycolmap.Reconstruction:
    out = root / f"model-{seed}"
    options = SparseOptions(seed=seed, colmap=dict(colmap))
    known = Known(check_shared=True)
    map_images(root / "database.db", grey, out, options, images, SILENT, known=known)
    return pycolmap.Reconstruction(out / "0")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="*", default=["fountain-p11", "sceaux"])
    parser.add_argument("--sizes", type=int, nargs="+", default=[640, 860, 1000])
    parsed = parser.parse_args()
    rows = []
    with quiet(), tempfile.TemporaryDirectory() as temporary:
        for name, size in ((name, size) for name in parsed.sets for size in parsed.sizes):
            folder = Path(temporary) / f"{name}-{size}"
            names = write_scaled(name, size, folder / "grey")
            poses = truth_of(DATA / name) if name == "fountain-p11" else {}
            poses = {f"{photograph}.png": pose for photograph, pose in poses.items()}
            for choice in _CHOICES:
                rows.append((f"{name}, {size} px", choice, *measured(folder, names, choice, poses)))
                print(json.dumps(rows[-1]), flush=True)
    print_table("small photographs", rows, _COLUMNS)


if __name__ == "__main__":
    main()
