"""Compare features of large photographs: COLMAP's, coarse first, and OpenCV's SIFT, with the models made of them.

    python benchmarks/coarse_first.py [fountain-p11] [sceaux] [portico-1 ...] [--size 1500] [--cap 3000] [--seeds 3]
                                      [--choices colmap auto opencv] [--tolerances 0 0]

The photographs are made grey and scaled to a size of the longer side in pixels; `portico-N` is the demo's scene
rendered anew with seed N and eight views. `--cap` is `max_num_features`: with 3,000 at 1,500 pixels it binds as
COLMAP's 8,192 do at 2,500. `colmap` and `auto` are those of `features.octaves`, `opencv` the SIFT of OpenCV at
half of COLMAP's threshold, its descriptors made as COLMAP's and its coarsest features kept. For each: features,
verified matches, and of mappings with seeds from 0 on the means of registered photographs, points, points in more than
three photographs, reprojection error and position error where poses are known. Core seconds are of features, of
matching, and of a mapping with calibration. Its adjustments end by `--tolerances`, local and global, if these are
given: COLMAP's are 0 and 0. All is done on one thread, so that the same features give the same model. Last come the
mean logarithms of the ratios of `auto` to `colmap` over the porticos, with their standard errors.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections import defaultdict
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from calibration import truth_of
from guard_sets import DATA
from lens_sets import position_error_mm
from numpy.typing import NDArray
from PIL import Image
from thresholds import core_seconds, mapped, write_scaled

from colmap_ihe.colmap.features import extract_features
from colmap_ihe.colmap.lower_thresholds import COLMAPS_THRESHOLD
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.evaluation.truth import key_of, read_truth
from colmap_ihe.machine import threads
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.project.options import CameraOptions, FeaturesOptions

_CHOICES = ("colmap", "auto", "opencv")
_TOLERANCES = ("ba_local_function_tolerance", "ba_global_function_tolerance")
_VIEWS = 8
_COLUMNS = (
    "set",
    "octaves",
    "features",
    "matches",
    "registered",
    "points",
    "in > 3",
    "error px",
    "position error mm",
    "core s, features",
    "matching",
    "mapping",
)
Poses = Mapping[str, NDArray[np.float64]]


def prepared(name: str, size: int, folder: Path) -> tuple[list[str], Poses]:
    """Write grey photographs below a folder; return their names, and poses where they are known."""
    if name.startswith("portico-"):
        sides = (size, 2 * round(size / 3))
        render_demo(folder / "demo", views=_VIEWS, size=sides, seed=int(name.split("-")[1]))
        files = sorted((folder / "demo" / "images").glob("*.jpg"))
        (folder / "grey").mkdir()
        for file in files:
            with Image.open(file) as picture:
                picture.convert("L").save(folder / "grey" / f"{file.name}.png")
        truth = read_truth(folder / "demo" / "truth").images
        return [f"{f.name}.png" for f in files], {
            f"{f.name}.png": truth[key_of(f.name)].cam_from_world for f in files
        }
    names = write_scaled(name, size, folder / "grey")
    poses = truth_of(DATA / name) if name == "fountain-p11" else {}
    return names, {f"{photograph}.png": pose for photograph, pose in poses.items()}


def extract_by_opencv(database: Path, grey: Path, names: list[str], cap: int) -> None:
    """Write OpenCV's features as COLMAP's would be: pixel centres at one half, at most two directions, root of the
    share of each bin."""
    pycolmap.Database.open(database).close()
    reader = pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL")
    pycolmap.import_images(
        database, grey, camera_mode=pycolmap.CameraMode.SINGLE, image_names=names, options=reader
    )
    sift = cv2.SIFT.create(0, 3, 3 * COLMAPS_THRESHOLD / 2, 10, 1.6, True)  # divided by its three layers
    with pycolmap.Database.open(database) as opened:
        for image in opened.read_all_images():
            picture = cv2.imread(str(grey / image.name), cv2.IMREAD_GRAYSCALE)
            assert picture is not None
            keypoints, bins = sift.detectAndCompute(picture, None)
            rows = np.array([(*k.pt, k.size / 2, np.radians(k.angle)) for k in keypoints], np.float32)
            rows[:, :2] += 0.5
            kept = coarsest(rows, cap)
            roots = np.sqrt(bins[kept] / np.maximum(bins[kept].sum(axis=1, keepdims=True), 1))
            descriptors = np.clip(np.rint(512 * roots), 0, 255).astype(np.uint8)
            opened.write_keypoints(image.image_id, rows[kept])
            kind = pycolmap.FeatureExtractorType.SIFT
            opened.write_descriptors(image.image_id, pycolmap.FeatureDescriptors(kind, descriptors))


def coarsest(rows: NDArray[np.float32], cap: int) -> NDArray[np.intp]:
    """Return the rows of x, y, size and angle at the `cap` places of the coarsest, two directions of each at most."""
    places, inverse = np.unique(rows[:, :3], axis=0, return_inverse=True)
    chosen = np.zeros(len(places), bool)
    chosen[np.argsort(-places[:, 2], kind="stable")[:cap]] = True
    order = np.argsort(inverse, kind="stable")
    begins = np.searchsorted(inverse[order], np.arange(len(places)))
    rank = np.empty(len(rows), int)
    rank[order] = np.arange(len(rows)) - begins[inverse[order]]
    return np.flatnonzero(chosen[inverse] & (rank < 2))


@dataclass(frozen=True)
class Outcome:
    """Hold what was found with one choice: numbers, and means over the seeds; position errors in millimetres."""

    features: int
    matches: int
    registered: float
    points: float
    over_three: float
    error_px: float
    errors_mm: list[float]
    extraction_s: float
    matching_s: float
    mapping_s: float

    def cells(self) -> list[str]:
        errors = self.errors_mm
        return [
            f"{self.features:,}",
            f"{self.matches:,}",
            f"{self.registered:.1f}",
            f"{self.points:,.0f}",
            f"{self.over_three:,.0f}",
            f"{self.error_px:.3f}",
            f"{np.mean(errors):.2f} ({min(errors):.2f} to {max(errors):.2f})" if errors else "-",
            f"{self.extraction_s:.1f}",
            f"{self.matching_s:.1f}",
            f"{self.mapping_s:.1f}",
        ]


def measured(
    folder: Path,
    names: list[str],
    choice: str,
    cap: int,
    seeds: int,
    poses: Poses,
    mapping: Mapping[str, float],
) -> Outcome:
    """Return what one choice of octaves gives, with COLMAP's options for `mapping`."""
    root = folder / choice
    root.mkdir()
    database = root / "database.db"
    begun = core_seconds()
    if choice == "opencv":
        extract_by_opencv(database, folder / "grey", names, cap)
    else:
        colmap = {"sift": {"max_num_features": cap}, "num_threads": 1}
        options = FeaturesOptions.model_validate({"octaves": choice, "colmap": colmap})
        camera = CameraOptions(mode="single")
        with ThreadPoolExecutor(1) as executor:
            extract_features(database, folder / "grey", names, None, camera, options, root, executor, SILENT)
    extracted = core_seconds()
    pycolmap.match_exhaustive(database, matching_options=pycolmap.FeatureMatchingOptions(num_threads=1))
    matched = core_seconds()
    with pycolmap.Database.open(database) as opened:
        features, matches = opened.num_keypoints(), opened.num_inlier_matches()
    models = [mapped(root, folder / "grey", len(names), seed, mapping) for seed in range(seeds)]
    mapping_s = (core_seconds() - matched) / seeds
    tracks = [[point.track.length() for point in model.points3D.values()] for model in models]
    return Outcome(
        features,
        matches,
        float(np.mean([model.num_reg_images() for model in models])),
        float(np.mean([len(lengths) for lengths in tracks])),
        float(np.mean([np.count_nonzero(np.array(lengths) > 3) for lengths in tracks])),
        float(np.mean([model.compute_mean_reprojection_error() for model in models])),
        [position_error_mm(model, poses) for model in models] if poses else [],
        extracted - begun,
        matched - extracted,
        mapping_s,
    )


def ratios(outcomes: Mapping[str, Mapping[str, Outcome]]) -> list[tuple[str, str]]:
    """Return, by name, the mean logarithm of the ratios of `auto` to `colmap` of the porticos, in percent."""
    pairs = [(o["auto"], o["colmap"]) for name, o in outcomes.items() if name.startswith("portico-")]
    if len(pairs) < 2:
        return []
    taken: dict[str, Callable[[Outcome], float]] = {
        "matches": lambda outcome: outcome.matches,
        "points": lambda outcome: outcome.points,
        "in > 3": lambda outcome: outcome.over_three,
        "error px": lambda outcome: outcome.error_px,
        "position error mm": lambda outcome: float(np.mean(outcome.errors_mm)),
    }
    logs = {name: [np.log(value(a) / value(c)) for a, c in pairs] for name, value in taken.items()}
    return [
        (name, f"{100 * np.mean(some):+.2f} % +- {100 * np.std(some, ddof=1) / len(some) ** 0.5:.2f}")
        for name, some in logs.items()
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="*", default=["fountain-p11", "sceaux"])
    parser.add_argument("--size", type=int, default=1500)
    parser.add_argument("--cap", type=int, default=3000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--choices", nargs="+", default=_CHOICES)
    parser.add_argument("--tolerances", type=float, nargs=2, default=())
    parsed = parser.parse_args()
    mapping = dict(zip(_TOLERANCES, parsed.tolerances, strict=False))
    rows = []
    outcomes: dict[str, dict[str, Outcome]] = defaultdict(dict)
    cv2.setNumThreads(1)
    with quiet(), tempfile.TemporaryDirectory() as temporary, threads.limited(1):
        for name in parsed.sets:
            folder = Path(temporary) / name
            names, poses = prepared(name, parsed.size, folder)
            for choice in parsed.choices:
                outcome = measured(folder, names, choice, parsed.cap, parsed.seeds, poses, mapping)
                outcomes[name][choice] = outcome
                rows.append((name, choice, *outcome.cells()))
                print(json.dumps(rows[-1]), flush=True)
    print_table(f"{parsed.size} pixels, {parsed.cap} features", rows, _COLUMNS)
    if set(parsed.choices) >= {"auto", "colmap"}:
        print_table("auto to colmap, porticos", ratios(outcomes), ("", "log of the ratio"))


if __name__ == "__main__":
    main()
