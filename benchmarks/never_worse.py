"""Compare what the trial of greys says with what whole sets bring: features of all photographs, matches of all pairs.

    python benchmarks/never_worse.py [SET ...] [--work DIR]

Every row is one grey of one set against COLMAP's default grey: the gain in verified matches over all pairs of the set,
as the mapper would get them, the gain that the trial states with its standard error, and what the trial makes of it.
The sets are photographs of ../shared/data at half their size or less, and RAW made from them as `guard_sets.py` makes
it. What is done lies in WORK, where a second run goes on.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from guard_sets import DATA, GAINS, expose, linear_of, read_rgb
from numpy.typing import NDArray

from colmap_ihe.colmap.native import quiet
from colmap_ihe.colmap.two_views import Features, features_kept_of, match, verified
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.weights import FIXED, Grey, Weights
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.project.options import FeaturesOptions, FitOptions

SIDE = 1416
QUALITY = 92


def _small(path: Path) -> NDArray[np.uint8]:
    """Return a photograph with its longer side at most `SIDE`, a whole number of times smaller."""
    rgb = read_rgb(path)
    return read_rgb(path, -(-max(rgb.shape) // SIDE)) if max(rgb.shape) > SIDE * 1.1 else rgb


def jpeg_set(name: str, folder: Path, step: int = 1) -> None:
    for path in sorted((DATA / name).glob("*.[jJ]*"))[::step]:
        options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
        cv2.imwrite(str(folder / f"{path.stem}.jpg"), _small(path)[..., ::-1], options)


def raw_set(name: str, folder: Path, iso: int) -> None:
    scenes = [linear_of(_small(path)) for path in sorted((DATA / name).glob("*.[jJ]*"))]
    scenes = [s[: s.shape[0] // 2 * 2, : s.shape[1] // 2 * 2] for s in scenes]
    brightest = float(np.percentile(np.stack([s[::4, ::4] for s in scenes]), 99.8))
    expose([np.asarray(s / brightest, np.float32) for s in scenes], folder, GAINS["a"], iso)


SETS = {
    "sceaux": lambda folder: jpeg_set("sceaux", folder),
    "fountain-p11": lambda folder: jpeg_set("fountain-p11", folder),
    "sacre-coeur": lambda folder: jpeg_set("sacre-coeur", folder),
    "fountain-raw-400": lambda folder: raw_set("fountain-p11", folder, 400),
    "sceaux-raw-1600": lambda folder: raw_set("sceaux", folder, 1600),
}


def whole(captures: Sequence[Capture], grey: Grey, reach: int = 99) -> dict[str, Any]:
    """Return verified matches of all pairs, or of those up to `reach` apart, features, and core seconds of both."""
    began = time.process_time()
    images = [to_grey(read_photograph(c).rgb, grey, "sqrt") for c in captures]
    found = features_kept_of(images, FeaturesOptions())
    features_s = time.process_time() - began
    pairs = [(a, b) for a, b in combinations(range(len(images)), 2) if b - a <= reach]
    inliers = [_inliers(found[a], found[b], images[a], images[b]) for a, b in pairs]
    seconds = time.process_time() - began - features_s
    features = [len(f) for f in found]
    return {"verified": inliers, "features": features, "features_s": features_s, "matches_s": seconds}


def _inliers(a: Features, b: Features, one: NDArray[np.uint8], other: NDArray[np.uint8]) -> int:
    pairs = match(a, b)
    places = a.places[pairs[:, 0]], b.places[pairs[:, 1]]
    return len(verified(*places, (one.shape[1], one.shape[0]), (other.shape[1], other.shape[0])))
