"""Judge the guard by the tables of `guard.py`: what each closeness would have chosen, and what that gains.

    python benchmarks/guard_rules.py [SET ...] [--work DIR] [--demo DIR]

Gains between the triplets that were measured are read off a smooth surface. Each cell: triplet, and percent
of correct matches above Rec.709 at an equal budget / of the coarsest 8,192 / at COLMAP's default settings.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from guard_sets import Set, all_sets
from numpy.typing import NDArray

import colmap_ihe  # noqa: F401  before pycolmap
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.weights import triplets

CLOSENESSES = (1.0, 0.999, 0.998, 0.995, 0.99, 0.98, 0.95, 0.9, 0.8)
PIXELS = 250_000  # for S
FIGURES = ("budget", "smooth", "default")

F64 = NDArray[np.float64]
Surface = Callable[[F64], F64]


def surface(weights: F64, gains: F64) -> Surface:
    """Fit a quadratic in the weights, and what that leaves as a Gaussian process of width .25 and 1 % noise."""

    def quadratic(w: F64) -> F64:
        r, g = w[:, 0], w[:, 1]
        return np.stack((np.ones(len(w)), r, g, r * r, g * g, r * g), axis=1)

    def near(a: F64, b: F64) -> F64:
        return np.asarray(np.exp(-((a[:, None] - b[None]) ** 2).sum(axis=2) / (2 * 0.25**2)))

    trust = np.exp(3 * np.minimum(0, gains))  # it is the top that matters
    factors = np.linalg.lstsq(quadratic(weights) * trust[:, None], gains * trust, rcond=None)[0]
    rest = gains - quadratic(weights) @ factors
    spread = max(1e-4, float(rest.var()))
    pull = spread * np.linalg.solve(near(weights, weights) * spread + 1e-4 * np.eye(len(weights)), rest)
    return lambda w: quadratic(w) @ factors + near(w, weights) @ pull


def surfaces(path: Path) -> list[Surface]:
    rows = json.loads(path.read_text())["rows"]
    weights = np.array([row["weights"] for row in rows])
    found = []
    for figure in FIGURES:
        counts = np.array([max(1, sum(row[figure])) for row in rows], float)
        found.append(surface(weights, np.log(counts / counts[0])))
    return found


def flatness(given: Set, grid: list[tuple[int, int, int]]) -> F64:
    """Return S of every triplet, from a sample of the pixels."""
    pixels = np.concatenate([rgb.reshape(-1, 3) for rgb in given.images])
    pixels = pixels[:: max(1, len(pixels) // PIXELS)].astype(np.uint32)
    planes = [np.ascontiguousarray(pixels[:, c]) for c in range(3)]
    found = []
    for i, j, k in grid:
        grey = planes[0] * np.uint32(i) + planes[1] * np.uint32(j) + planes[2] * np.uint32(k)
        if given.images[0].dtype == np.uint8:
            levels = (grey + np.uint32(50)) // np.uint32(100)
        else:
            place = int(0.998 * len(grey))
            white = int(np.partition(grey, place)[place]) + 1
            levels = np.minimum(grey.astype(np.float64) * (256 / white), 255).astype(np.uint32)
        share = np.bincount(levels, minlength=256) / len(grey)
        found.append(float((share**2).sum() - 1 / 256))
    return np.array(found)


def judge(name: str, given: Set, table: Path) -> None:
    grid = triplets(0.01)
    weights = np.array(grid) / 100
    contrast = Contrast("coded" if given.images[0].dtype == np.uint8 else "linear")
    for rgb in given.images:
        contrast.add(rgb)
    snr, score = contrast.snr_of(grid), flatness(given, grid)
    gain = surfaces(table)

    def cell(place: int) -> str:
        found = [100 * float(np.expm1(f(weights[place : place + 1])[0])) for f in gain]
        return f"{grid[place]} " + "/".join(f"{g:+.0f}" for g in found)

    print(f"{name}\n  paper's IHE {cell(int(np.argmin(score)))}")
    chosen = np.array([grid.index(t) for t in contrast.admitted(grid)])
    default = contrast.snr_of([(21, 72, 7)])[0] / snr.max()
    print(f"  Rec.709 has {default:.3f} of the best contrast")
    print(f"  as built {len(chosen):4d} admitted {cell(int(chosen[np.argmin(score[chosen])]))}")
    for closeness in CLOSENESSES:
        admitted = np.flatnonzero(snr >= closeness * snr.max())
        print(
            f"  {closeness:5.3f} {len(admitted):4d} admitted {cell(int(admitted[np.argmin(score[admitted])]))}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="*")
    parser.add_argument("--work", type=Path, default=Path("guard-work"))
    parser.add_argument("--demo", type=Path, default=Path("demo"))
    parsed = parser.parse_args()
    cv2.setNumThreads(1)
    sets = all_sets(parsed.work / "sets", parsed.demo)
    for name in parsed.sets or [n for n in sets if (parsed.work / f"{n}.json").is_file()]:
        judge(name, sets[name](), parsed.work / f"{name}.json")


if __name__ == "__main__":
    main()
