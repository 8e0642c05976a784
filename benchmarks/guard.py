"""Measure how the weights affect matching: correct matches of every triplet of a grid on many sets.

    python benchmarks/guard.py table SET [...] [--work DIR] [--demo DIR] [--step 0.2] [--triplet R,G,B]
    python benchmarks/guard.py list

For each triplet and pair, correct matches with COLMAP's SIFT on the CPU, at an equal budget (the 5,000
strongest an image) and at COLMAP's default settings (about 8,192, the coarsest). Written after every triplet to
WORK/SET.json, where a second run goes on. `guard_rules.py` judges rules for the guard by these tables.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from guard_sets import Set, all_sets
from numpy.typing import NDArray

import colmap_ihe  # noqa: F401  before pycolmap
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.grey.convert import tone_table
from colmap_ihe.grey.weights import FIXED, triplets

BUDGET, DEFAULT = 5000, 8192
RATIO, MAX_ANGLE = 0.8, 0.7
ERROR_PX = 3.0
_TENTHS = ["442", "00A", "A00", "0A0", "550", "505", "055", "622", "262", "226"]
DESIGN = [(int(t[0], 16) / 10, int(t[1], 16) / 10, int(t[2], 16) / 10) for t in _TENTHS]
"""Where a triplet's gain is measured first: enough for a smooth surface over the triangle."""
_SIGMA0 = 1.6 * 2 ** (1 / 3)  # VLFeat's

Features = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]


def grey_images(given: Set, triplet: tuple[float, float, float], tone: str) -> list[NDArray[np.uint8]]:
    """Convert as `colmap_ihe.grey` converts them; linear by the set-wide white point of this triplet."""
    weights = np.array(triplet, np.float32)
    planes = [rgb.astype(np.float32) @ weights for rgb in given.images]
    if given.images[0].dtype == np.uint8:
        return [np.asarray(p + 0.5, np.uint8) for p in planes]
    white = float(np.percentile(np.concatenate([p[::2, ::2].ravel() for p in planes]), 99.8)) / 65535
    table = tone_table(min(1.0, white), "sqrt" if tone == "sqrt" else "linear")
    return [table[np.asarray(p + 0.5, np.uint16)] for p in planes]


def features(grey: NDArray[np.uint8]) -> Features:
    """Return all that COLMAP's SIFT finds: (x, y, scale, angle) (N, 4), descriptors (N, 128), strength (N,)."""
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = 1
    options.sift.max_num_features = 200_000
    keypoints, descriptors = pycolmap.Sift(options, pycolmap.Device.cpu).extract(np.ascontiguousarray(grey))
    return keypoints, np.asarray(descriptors, np.float32), strength(grey, keypoints)


def strength(grey: NDArray[np.uint8], keypoints: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return |difference of Gaussians| at each keypoint, of the level it was found in."""
    level = np.rint(3 * np.log2(np.maximum(keypoints[:, 2], 0.1) / _SIGMA0)).astype(int)
    result = np.zeros(len(keypoints), np.float32)
    image = np.asarray(cv2.resize(grey.astype(np.float32), None, fx=2, fy=2), np.float32)
    scale, sigma = 2.0, 1.0  # pixels of `image` per pixel; blur of `image` in its own pixels
    for number in range(level.min(initial=0), level.max(initial=0) + 1):
        wanted = _SIGMA0 * 2 ** (number / 3) * scale
        while wanted >= 4:
            image = np.asarray(
                cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.float32
            )
            scale, sigma, wanted = scale / 2, sigma / 2, wanted / 2
        low = _blurred(image, sigma, wanted)
        high = _blurred(image, sigma, wanted * 2 ** (1 / 3))
        chosen = level == number
        x = np.clip((keypoints[chosen, 0] * scale).astype(int), 0, image.shape[1] - 1)
        y = np.clip((keypoints[chosen, 1] * scale).astype(int), 0, image.shape[0] - 1)
        result[chosen] = np.abs(high[y, x] - low[y, x])
    return result


def _blurred(image: NDArray[np.float32], sigma: float, wanted: float) -> NDArray[np.float32]:
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), max(0.1, (wanted**2 - sigma**2) ** 0.5 if wanted > sigma else 0.1))
    )


def strongest(found: Features, count: int) -> Features:
    order = np.argsort(-found[2], kind="stable")[:count]
    return found[0][order], found[1][order], found[2][order]


def coarsest(found: Features, count: int, whole_levels: bool = True) -> Features:
    """Keep features as COLMAP does: whole levels of the scale space from the coarsest, until there are more than
    `count` places (a place with two orientations is one). Up to half as many again may stay, and one place
    more or less decides about a level: without `whole_levels`, `count` places, whatever their level."""
    places, which = np.unique(found[0][:, :3], axis=0, return_inverse=True)
    if len(places) <= count:
        return found
    level = 3 * np.log2(np.maximum(places[:, 2], 0.1) / _SIGMA0)
    if whole_levels:
        level = np.rint(level)
    least = np.sort(level)[::-1][count if whole_levels else count - 1]
    kept = (level >= least)[which.ravel()]
    return found[0][kept], found[1][kept], found[2][kept]


def matches(first: Features, second: Features) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the places of mutual nearest neighbours that pass the ratio test, by angles between descriptors as in
    COLMAP."""
    a, b = (f[1] / np.linalg.norm(f[1], axis=1, keepdims=True) for f in (first, second))
    if not len(a) or not len(b):
        return np.zeros((0, 2)), np.zeros((0, 2))
    likeness = a @ b.T
    there = np.argmax(likeness, axis=1)
    back = np.argmax(likeness, axis=0)
    rows = np.arange(len(a))
    best = np.arccos(np.clip(likeness[rows, there], -1, 1))
    likeness[rows, there] = -1
    next_best = np.arccos(np.clip(likeness.max(axis=1), -1, 1))
    good = (best <= MAX_ANGLE) & (best < RATIO * next_best) & (back[there] == rows)
    return first[0][good, :2].astype(float), second[0][there[good], :2].astype(float)


def correct(given: Set, pair: tuple[int, int], a: NDArray[np.float64], b: NDArray[np.float64]) -> int:
    ones = np.ones((len(a), 1))
    a, b = np.hstack((a, ones)), np.hstack((b, ones))
    if pair in given.homography:
        image = a @ given.homography[pair].T
        return int((np.linalg.norm(image[:, :2] / image[:, 2:] - b[:, :2], axis=1) < ERROR_PX).sum())
    fundamental = given.fundamental[pair]
    there, back = a @ fundamental.T, b @ fundamental
    error = np.sum(b * there, axis=1) ** 2
    error /= np.maximum(np.sum(there[:, :2] ** 2, axis=1) + np.sum(back[:, :2] ** 2, axis=1), 1e-30)
    return int((error < ERROR_PX**2 / 2).sum())


def reference_geometry(given: Set) -> None:
    """Estimate, where there is no truth, one fundamental matrix a pair, from the matches of three greys."""
    if given.fundamental or given.homography:
        return
    pooled: dict[tuple[int, int], list[Any]] = {pair: [] for pair in given.pairs}
    for triplet in (FIXED["rec709"], FIXED["mean"], (0.5, 0.0, 0.5)):
        found = [strongest(features(g), BUDGET) for g in grey_images(given, triplet, "sqrt")]
        for pair in given.pairs:
            pooled[pair].append(matches(found[pair[0]], found[pair[1]]))
    for pair, both in pooled.items():
        a, b = (np.concatenate([m[side] for m in both]) for side in (0, 1))
        cv2.setRNGSeed(0)
        matrix, _ = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, 1.5, 0.9999, 20000)
        given.fundamental[pair] = np.asarray(matrix)


def measure(given: Set, triplet: tuple[float, float, float], tone: str) -> dict[str, Any]:
    return {"weights": triplet, **measure_greys(given, grey_images(given, triplet, tone))}


def measure_greys(given: Set, greys: list[NDArray[np.uint8]]) -> dict[str, Any]:
    """Return features an image, and correct matches a pair in each way of keeping features."""
    found = [features(g) for g in greys]
    row: dict[str, Any] = {"features": [len(f[0]) for f in found]}
    ways = {
        "budget": [strongest(f, BUDGET) for f in found],
        "default": [coarsest(f, DEFAULT) for f in found],
        "smooth": [coarsest(f, DEFAULT, whole_levels=False) for f in found],
    }
    for name, kept in ways.items():
        row[name] = [correct(given, p, *matches(kept[p[0]], kept[p[1]])) for p in given.pairs]
    return row


def table(name: str, given: Set, path: Path, wanted: list[tuple[float, float, float]], tone: str) -> None:
    reference_geometry(given)
    rows = json.loads(path.read_text())["rows"] if path.is_file() else []
    known = {tuple(np.round(r["weights"], 4)) for r in rows}
    for triplet in wanted:
        if tuple(np.round(triplet, 4)) in known:
            continue
        began = time.monotonic()
        rows.append(measure(given, triplet, tone))
        path.write_text(json.dumps({"set": name, "tone": tone, "rows": rows}))
        base = rows[0]
        gains = " ".join(
            f"{100 * (sum(rows[-1][k]) / max(1, sum(base[k])) - 1):+6.1f}%"
            for k in ("budget", "default", "smooth")
        )
        print(
            f"{name} {np.round(triplet, 3)} {rows[-1]['features']} {sum(rows[-1]['budget'])} "
            f"{sum(rows[-1]['default'])} {gains} {time.monotonic() - began:.0f} s",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["table", "list"])
    parser.add_argument("sets", nargs="*")
    parser.add_argument("--work", type=Path, default=Path("guard-work"))
    parser.add_argument("--demo", type=Path, default=Path("demo"))
    parser.add_argument("--step", type=float, default=0.0, help="and a grid of this step")
    parser.add_argument("--tone", default="sqrt")
    parser.add_argument("--triplet", action="append", default=[], help="R,G,B: these, not the grid")
    parsed = parser.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # pycolmap.Sift: arrays, not objects
    pycolmap.logging.minloglevel = 2
    parsed.work.mkdir(parents=True, exist_ok=True)
    cv2.setNumThreads(1)
    sets = all_sets(parsed.work / "sets", parsed.demo)
    if parsed.what == "list":
        print(*sets, sep="\n")
        return
    grid = [(i / 100, j / 100, k / 100) for i, j, k in (triplets(parsed.step) if parsed.step else ())]
    wanted = [FIXED["rec709"], FIXED["mean"], *DESIGN, *grid]
    if parsed.triplet:
        wanted = [FIXED["rec709"]]
        for text in parsed.triplet:
            red, green, blue = map(float, text.split(","))
            wanted.append((red, green, blue))
    for name in parsed.sets or sets:
        suffix = "" if parsed.tone == "sqrt" else f"-{parsed.tone}"
        table(name + suffix, sets[name](), parsed.work / f"{name}{suffix}.json", wanted, parsed.tone)


if __name__ == "__main__":
    main()
