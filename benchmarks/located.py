"""Measure how exactly features lie, and how many are matched, between two views of a plane of which all is known.

    python benchmarks/located.py [--size 1500] [--cap 3000] [--noise 1.5]

Photographs of sceaux and fountain-p11 are seen twice as if they were planes, through homographies, from their full
size, with noise, and rounded to grey levels. Features are matched as COLMAP does (ratio .8, both ways) and are
correct within two pixels. For each way to extract: correct matches, the median and the root of the mean square of
their errors in pixels (above one pixel counted as one), and these of the finest level of the image's own
resolution. `whole` is COLMAP's way, `plain` without the doubled image, `lower` that at three quarters of the
threshold and 1.1 of the cap, and `auto` what `features.octaves: auto` does.
"""

from __future__ import annotations

import argparse

import cv2
import numpy as np
from guard_sets import DATA
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.colmap.array_features import extract_arrays
from colmap_ihe.colmap.extraction import extraction_options
from colmap_ihe.colmap.native import quiet
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.project.options import FeaturesOptions

_CORRECT_PX = 2.0
_FINEST = 2.3  # pixels of a feature
_COLUMNS = ("way", "correct", "median px", "rms px", "of the finest", "median px", "rms px")
_WAYS = ("whole", "plain", "lower", "auto")
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]


def views(grey: F32, size: int, noise: float, draw: np.random.Generator) -> tuple[U8, U8, F64]:
    """Return two views of a photograph and the homography from one to the other."""
    height = round(size * 2 / 3)
    softened = cv2.GaussianBlur(grey, (0, 0), 0.5 * grey.shape[1] / size)
    corners = np.array([[0, 0], [size, 0], [size, height], [0, height]], np.float32)
    source = corners * np.array([grey.shape[1] / size, grey.shape[0] / height], np.float32)
    pictures, homographies = [], []
    for strength in (20, 90):
        angle = np.radians(draw.uniform(-12, 12))
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        middle = np.array([size, height]) / 2
        target = (corners + draw.uniform(-strength, strength, (4, 2)) - middle) @ turn.T * 1.05 + middle
        homography = cv2.getPerspectiveTransform(source, target.astype(np.float32))
        seen = cv2.warpPerspective(
            softened, homography, (size, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )
        pictures.append(np.clip(np.rint(seen + draw.normal(0, noise, seen.shape)), 0, 255).astype(np.uint8))
        homographies.append(np.asarray(homography, np.float64))
    return pictures[0], pictures[1], homographies[1] @ np.linalg.inv(homographies[0])


def extracted(pictures: list[U8], way: str, cap: int) -> list[tuple[F32, U8]]:
    """Return keypoints and descriptors of each picture."""
    options = extraction_options(FeaturesOptions())
    options.sift.max_num_features = cap
    if way in ("plain", "lower"):
        options.sift.first_octave, options.sift.num_octaves = 0, 3
    if way == "lower":
        options.sift.peak_threshold *= 0.75
        options.sift.max_num_features = round(1.1 * cap)
    return extract_arrays(pictures, options, "features", octaves="auto" if way == "auto" else "colmap")


def matched(first: U8, second: U8) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows that are nearest to each other and clearly so."""
    cosines = first.astype(np.float32) @ second.astype(np.float32).T / 512**2
    two = np.sort(np.partition(cosines, -2, axis=1)[:, -2:], axis=1)
    nearest = cosines.argmax(axis=1)
    angles = np.arccos(np.clip(two, -1, 1))
    clear = (angles[:, 1] < 0.7) & (angles[:, 1] < 0.8 * angles[:, 0])
    rows = np.flatnonzero(clear & (cosines.argmax(axis=0)[nearest] == np.arange(len(first))))
    return rows, nearest[rows]


def errors_of(pictures: list[U8], homography: F64, way: str, cap: int) -> tuple[F64, F64]:
    """Return the errors of correct matches in pixels, and the sizes of their features."""
    (points, bins), (other_points, other_bins) = extracted(pictures, way, cap)
    rows, others = matched(bins, other_bins)
    places = np.c_[points[rows, :2] - 0.5, np.ones(len(rows))] @ homography.T
    errors = np.linalg.norm(places[:, :2] / places[:, 2:] - (other_points[others, :2] - 0.5), axis=1)
    sizes = np.hypot(points[rows, 2], points[rows, 4])
    return errors[errors < _CORRECT_PX], sizes[errors < _CORRECT_PX]


def cells(errors: F64) -> list[str]:
    rms = np.sqrt(np.mean(np.minimum(errors, 1) ** 2))
    return [f"{len(errors):,}", f"{np.median(errors):.4f}", f"{rms:.4f}"]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=1500)
    parser.add_argument("--cap", type=int, default=3000)
    parser.add_argument("--noise", type=float, default=1.5)
    parsed = parser.parse_args()
    found: dict[str, list[tuple[F64, F64]]] = {way: [] for way in _WAYS}
    files = [
        *sorted((DATA / "sceaux").glob("*.JPG"))[::3],
        *sorted((DATA / "fountain-p11").glob("*.jpg"))[::3],
    ]
    with quiet():
        for number, file in enumerate(files):
            grey = np.array(Image.open(file).convert("L"), np.float32)
            first, second, homography = views(grey, parsed.size, parsed.noise, np.random.default_rng(number))
            for way in _WAYS:
                found[way].append(errors_of([first, second], homography, way, parsed.cap))
    rows = []
    for way, some in found.items():
        errors, sizes = np.concatenate([e for e, _ in some]), np.concatenate([s for _, s in some])
        rows.append((way, *cells(errors), *cells(errors[sizes < _FINEST])))
    print_table(f"{len(files)} pairs, noise {parsed.noise}", rows, _COLUMNS)


if __name__ == "__main__":
    main()
