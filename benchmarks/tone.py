"""Measure how the tone curve of RAW and exposure normalisation affect features, matches and cameras.

    python benchmarks/tone.py [matches | cameras] [--work DIR]

RAW of known truth is made from photographs (`guard_sets.expose`), developed, its weights fitted with the guard, and
coded to 8 bit by each tone. `matches`: three images a set, two pairs; features found, and correct matches at an equal
budget of the 5,000 strongest features an image, of the 8,192 coarsest, and of what COLMAP keeps by default (whole
levels of scale, about as many). `cameras`: all eleven of fountain-p11 at a quarter of their size, three seeds.
"Normalised" photographs are multiplied as `develop.exposure: normalise` does; all others are as shot.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from guard import measure_greys, reference_geometry
from guard_sets import DATA, GAINS, Rgb, Set, expose, linear_of, raw_set, read_rgb
from numpy.typing import NDArray

from colmap_ihe.colmap.features import extract_features
from colmap_ihe.colmap.mapping import map_images
from colmap_ihe.colmap.matching import match_features
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.truth import pose_errors, read_truth
from colmap_ihe.grey.convert import TONES, to_grey
from colmap_ihe.grey.ihe import fit_weights
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.adjust import prepared
from colmap_ihe.photographs.exif.metadata import Metadata
from colmap_ihe.photographs.exposure import exposure_gains
from colmap_ihe.photographs.png import encode_png
from colmap_ihe.project.options import CameraOptions, FeaturesOptions, MatchesOptions, SparseOptions
from colmap_ihe.project.recipe import Recipe

MIXED = (0.5, 1.0, 2.0)
SHOTS: tuple[tuple[int, float | tuple[float, float, float]], ...] = (
    (400, 1.0),
    (400, 0.25),
    (1600, 1.0),
    (100, 2.0),
    (400, MIXED),
)
"""ISO, and exposure; 1 puts the 99.8th percentile of green at saturation."""
WAYS = ("budget", "smooth", "default")
SEEDS = (0, 1, 2)
COLUMNS = ("set", "exposure", "tone", "features", "5,000 strongest", "8,192 coarsest", "COLMAP's default")


def normalised(images: Sequence[Rgb], exposures: Sequence[float]) -> list[Rgb]:
    """Level exposures as `develop.exposure: normalise`, by the exposure times of EXIF."""
    shots = {str(n): Metadata(exposure_s=e, f_number=8, iso=100) for n, e in enumerate(exposures)}
    gains, _ = exposure_gains(shots)
    return [prepared(rgb, Recipe(gains=(gains[str(n)],) * 3)) for n, rgb in enumerate(images)]


def greys_of(images: Sequence[Any], tone: Any) -> list[NDArray[np.uint8]]:
    weights = fit_weights(images)
    return [to_grey(rgb, weights, tone) for rgb in images]


def exposures_of(
    images: Sequence[Rgb], exposure: float | tuple[float, ...]
) -> Iterator[tuple[str, Sequence[Rgb]]]:
    yield "as shot", images
    if isinstance(exposure, tuple):
        yield "normalised", normalised(images, exposure)


def gain(row: dict[str, Any], base: dict[str, Any], way: str) -> str:
    return f"{100 * (sum(row[way]) / max(1, sum(base[way])) - 1):+.1f} %"


def matches(work: Path) -> None:
    rows = []
    for name in ("fountain-p11", "sceaux"):
        geometry: Set | None = None
        for iso, exposure in SHOTS:
            given = raw_set(name, work / f"{name}-{iso}-{exposure}", "a", iso, exposure)
            if geometry is None:
                reference_geometry(given)
                geometry = given
            given = replace(given, fundamental=geometry.fundamental)
            words = "/".join(f"{e:g}" for e in np.atleast_1d(exposure))
            base: dict[str, Any] = {}
            for how, images in exposures_of(given.images, exposure):
                one = replace(given, images=list(images))
                for tone in TONES:  # the square root first
                    row = measure_greys(one, greys_of(images, tone))
                    base = base or row
                    shown = [f"{sum(row[w]):,} ({gain(row, base, w)})" for w in WAYS]
                    found = f"{sum(row['features']):,}"
                    rows.append((f"{name.split('-')[0]}, ISO {iso}, x{words}", how, tone, found, *shown))
                    print(*rows[-1], sep=" | ", flush=True)
    print_table("\nmatches, and against the square root as shot", rows, COLUMNS)


def cameras(work: Path) -> None:
    names = sorted(p.stem for p in (DATA / "fountain-p11").glob("*.jpg"))
    scenes = [
        cv2.resize(
            linear_of(read_rgb(DATA / "fountain-p11" / f"{n}.jpg")), (768, 512), interpolation=cv2.INTER_AREA
        )
        for n in names
    ]
    brightest = float(np.percentile(np.stack(scenes)[:, ::2, ::2], 99.8))
    rows = []
    for label, exposures in (
        ("x1", [1.0] * len(names)),
        ("x0.5/1/2", [MIXED[n % 3] for n in range(len(names))]),
    ):
        lit = [np.asarray(s * np.float32(e / brightest)) for s, e in zip(scenes, exposures, strict=True)]
        images = expose(lit, work / f"cameras-{label.replace('/', '-')}", GAINS["a"], 400).images
        for how, shown in exposures_of(images, tuple(exposures) if label != "x1" else 1.0):
            for tone in TONES:
                greys = dict(zip(names, greys_of(shown, tone), strict=True))
                rows.append((f"fountain, ISO 400, {label}", how, tone, *solved(greys)))
                print(*rows[-1], sep=" | ", flush=True)
    columns = (
        "set",
        "exposure",
        "tone",
        "verified matches",
        "registered",
        "points",
        "position mm",
        "rotation deg",
    )
    print_table("\ncameras", rows, columns)


def solved(greys: dict[str, NDArray[np.uint8]]) -> tuple[str, ...]:
    """Return registered images and their errors, mean and standard deviation over the seeds."""
    truth = read_truth(DATA / "fountain-p11" / "gt")
    k = np.loadtxt(DATA / "fountain-p11" / "K.txt")
    params = tuple(float(v) / 4 for v in (k[0, 0], k[1, 1], k[0, 2] + 0.5, k[1, 2] + 0.5))
    camera = CameraOptions(mode="single", model="PINHOLE", params=params)
    found = []
    with tempfile.TemporaryDirectory() as folder, local_executor() as executor:
        root = Path(folder)
        (root / "grey").mkdir()
        for name, grey in greys.items():
            (root / "grey" / f"{name}.png").write_bytes(encode_png(grey))
        files = sorted(f"{name}.png" for name in greys)
        database = root / "database.db"
        extract_features(
            database,
            root / "grey",
            files,
            None,
            camera,
            FeaturesOptions(),
            root,
            executor,
            SILENT,
        )
        counts = match_features(database, root, MatchesOptions(), len(files), executor, SILENT)
        for seed in SEEDS:
            shutil.rmtree(root / "sparse", ignore_errors=True)
            models = map_images(
                database, root / "grey", root / "sparse", SparseOptions(seed=seed), len(files), SILENT
            ).models
            model = pycolmap.Reconstruction(root / "sparse" / "0")
            poses = {
                model.images[i].name: model.images[i].cam_from_world().matrix() for i in model.reg_image_ids()
            }
            errors = pose_errors(poses, truth)
            mean_mm = 1000 * float(np.mean(list(errors.position_m.values())))
            found.append(
                (models[0].registered_images, models[0].points3d, mean_mm, errors.rotation_error_deg)
            )
    mean, spread = np.mean(found, axis=0), np.std(found, axis=0, ddof=1)
    return (
        f"{counts.inliers:,}",
        f"{mean[0]:.1f} of {len(greys)}",
        f"{mean[1]:,.0f}",
        f"{mean[2]:.2f} +- {spread[2]:.2f}",
        f"{mean[3]:.4f} +- {spread[3]:.4f}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", nargs="?", choices=["matches", "cameras"], help="both if not given")
    parser.add_argument("--work", type=Path, help="where the RAW files go, kept; else a temporary folder")
    parsed = parser.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # pycolmap.Sift: arrays, not objects
    pycolmap.logging.minloglevel = 2
    cv2.setNumThreads(1)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as temporary:
        work = parsed.work or Path(temporary)
        for name, run in (("cameras", cameras), ("matches", matches)):
            if parsed.what in (None, name):
                run(work)
    print(f"{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
