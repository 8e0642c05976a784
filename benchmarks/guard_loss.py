"""Ask whether the guard could spare colour detail: how much of it triplets lose that are equal in contrast.

    python benchmarks/guard_loss.py FOLDER [FOLDER ...]

For each folder of JPEG photographs and each closeness the least and the greatest loss among the triplets that it
admits, and that of the flattest among them. Loss is in percent of the blocks with detail, by the measure of the
second grey (grey/second_fit.py): a block is lost of which a grey keeps less than 0.3 of the contrast that the best
direction in colour shows. First over the set, then in the photograph that loses most.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.ihe import fit_cells
from colmap_ihe.grey.second_fit import blocks_of
from colmap_ihe.grey.weights import FIXED, Triplet, triplets
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import discover

CLOSENESSES = (0.998, 0.99, 0.97, 0.95, 0.9)
MOST = 150  # triplets that are measured for a closeness
LOST, DETAIL, FLATTEST, FLOOR = 0.3, 3.0, 0.05, 0.02
SIX = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Measured:
    """Hold `blocks` with detail, (n, 3, 3), the greatest contrast squared of each, the `photograph` that it is of, and
    the noise of the set."""

    blocks: F64
    best: F64
    photograph: NDArray[np.intp]
    noise: F64

    def loss(self, triplet: tuple[float, float, float]) -> tuple[float, float]:
        """Return the percentage lost of the set, and of the photograph that loses most."""
        weights = np.array(triplet)
        shown = np.einsum("i,nij,j->n", weights, self.blocks, weights) / (weights @ self.noise @ weights)
        lost = shown < LOST**2 * self.best
        by_photograph = np.bincount(self.photograph, lost) / np.maximum(1, np.bincount(self.photograph))
        return 100 * float(lost.mean()), 100 * float(by_photograph.max())


def main() -> None:
    for folder in sys.argv[1:]:
        histogram, contrast, blocks = Histogram(), Contrast(), list[F64]()
        for capture in discover(Path(folder)).captures:
            if capture.kind != "coded":
                continue
            rgb = np.asarray(read_photograph(capture).rgb, np.uint8)
            histogram.add(rgb)
            contrast.add(rgb)
            blocks.append(blocks_of(rgb[..., 1], rgb).colours.astype(np.float64))
        print(f"\n{folder}, {len(blocks)} photographs\n")
        report(histogram, contrast, measured(blocks))


def measured(blocks: list[F64]) -> Measured:
    every = np.concatenate(blocks)
    flattest = np.argsort(every[:, :3].sum(axis=1), kind="stable")[: int(FLATTEST * len(every))]
    noise = every[flattest].mean(axis=0)[SIX] + FLOOR * np.eye(3)
    whitening = np.linalg.inv(np.linalg.cholesky(noise))
    best = np.asarray(np.linalg.eigvalsh(whitening @ every[:, SIX] @ whitening.T)[:, 2], np.float64)
    photograph = np.repeat(np.arange(len(blocks)), [len(b) for b in blocks])
    shows = best > DETAIL**2
    return Measured(every[shows][:, SIX], best[shows], photograph[shows], noise)


def report(histogram: Histogram, contrast: Contrast, blocks: Measured) -> None:
    grid = triplets()
    snr = contrast.snr_of(grid)
    fixed = {"Rec.709": FIXED["rec709"], "mean": FIXED["mean"], ".8 .19 .01": (0.8, 0.19, 0.01)}
    for name, weights in fixed.items():
        print(f"{name}: contrast {contrast.share_of(weights):.3f}, lost {words(blocks.loss(weights))}")
    print("\n| closeness | triplets | least | most | flattest |\n|---|--:|---|---|---|")
    for closeness in CLOSENESSES:
        admitted = [t for t, value in zip(grid, snr, strict=True) if value >= closeness * snr.max()]
        some = admitted[:: max(1, len(admitted) // MOST)]
        losses = {t: blocks.loss(part(t)) for t in some}
        ends = [min(some, key=losses.__getitem__), max(some, key=losses.__getitem__)]
        flattest = fit_cells(histogram, admitted).triplet
        cells = [f"{words(part(t))}: {words(losses[t])}" for t in ends]
        cells.append(f"{words(flattest)}: {words(blocks.loss(flattest))}")
        print(f"| {closeness} | {len(admitted)} | {' | '.join(cells)} |")


def part(triplet: Triplet) -> tuple[float, float, float]:
    red, green, blue = (weight / 100 for weight in triplet)
    return red, green, blue


def words(numbers: tuple[float, ...]) -> str:
    return " ".join(f"{number:.2f}" for number in numbers)


if __name__ == "__main__":
    main()
