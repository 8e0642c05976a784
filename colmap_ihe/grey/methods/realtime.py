"""Find the one of 66 triplets that keeps the contrasts of colour best, whatever their order (realtime).

After Lu, Xu and Jia, "Real-time contrast preserving decolorization", SIGGRAPH Asia 2012 Technical Briefs:
differences between pixels of a thumbnail, some neighbours and some far apart, are compared with the
difference in grey under each triplet by a mixture of two Gaussians, one for either order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.srgb import Float32, bands, checked
from colmap_ihe.grey.weights import FIXED, triplets

Triplet = tuple[float, float, float]

GRID: NDArray[np.float64] = np.array(triplets(0.1)) / 100
"""(66, 3): the weights that are tried."""

_SIGMA = 0.05
_SIDE = 64
_NORM = 1.41
_LEAST = 0.05
_SEED = 2012
_UNIT = 1 << 32  # of the fixed-point sums
TOWARDS_REC709: NDArray[np.float64] = ((GRID - np.array(FIXED["rec709"])) ** 2).sum(axis=1)


class RealtimeSet:
    """Gather the sum of the objective over all pairs of a set, for each triplet.

    Sums are whole numbers, so photographs may be added in any order and grouping. Each weighs as much as
    it has pairs that differ; these come from a thumbnail of 64 x 64 pixels' area, so about equally.
    """

    def __init__(self) -> None:
        self.sums: list[int] = [0] * len(GRID)
        self.pairs = 0
        self.images = 0

    def add(self, rgb: Float32) -> None:
        """Add one photograph: (H, W, 3) float32 in [0, 1], coded. Raises ValueError for anything else."""
        differences, contrast = pairs(checked(rgb))
        grey = differences @ GRID.T
        fits = np.logaddexp(*(-(((grey + c[:, None]) / _SIGMA) ** 2) for c in (contrast, -contrast)))
        self.sums = [a + round(float(b) * _UNIT) for a, b in zip(self.sums, fits.sum(axis=0), strict=True)]
        self.pairs += len(contrast)
        self.images += 1

    def __add__(self, other: RealtimeSet) -> RealtimeSet:
        total = RealtimeSet()
        total.sums = [a + b for a, b in zip(self.sums, other.sums, strict=True)]
        total.pairs = self.pairs + other.pairs
        total.images = self.images + other.images
        return total

    def finish(self) -> Triplet:
        """Return the weights of red, green and blue. Ties, as where nothing has colour, go to the nearest to Rec.709.
        Raises ValueError for a set without photographs."""
        if not self.images:
            raise ValueError("no photographs were added, expected at least one")
        best = max(range(len(GRID)), key=lambda n: (self.sums[n], -float(TOWARDS_REC709[n])))
        red, green, blue = (float(w) for w in GRID[best])
        return red, green, blue


def realtime(rgb: Float32) -> Float32:
    """Return the grey of one photograph with weights of its own, which breaks colour consistency.

    rgb: (H, W, 3) float32 in [0, 1], coded. Returns (H, W) float32 in [0, 1]. R = G = B = v gives v.
    Raises ValueError for another shape or dtype.
    """
    fitted = RealtimeSet()
    fitted.add(rgb)
    return weighed(rgb, fitted.finish())


def weighed(rgb: Float32, triplet: Triplet) -> Float32:
    """Return wr R + wg G + wb B: (H, W, 3) float32 in, (H, W) float32 out."""
    checked(rgb)
    grey = np.empty(rgb.shape[:2], np.float32)
    for rows in bands(rgb):
        grey[rows] = np.clip(rgb[rows] @ np.array(triplet, np.float32), 0, 1)
    return grey


def pairs(rgb: Float32) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return differences (N, 3) of pairs of pixels, and their contrast (N,), pairs below 0.05 left out.

    Each pixel of the thumbnail with one drawn at random, and the neighbours along rows and columns of a
    thumbnail half that size.
    """
    scale = _SIDE / np.sqrt(rgb.shape[0] * rgb.shape[1])
    whole = _nearest(rgb, scale).astype(np.float64)
    half = _nearest(whole, 0.5)
    far = whole.reshape(-1, 3)
    far = far - far[np.random.default_rng(_SEED).permutation(len(far))]
    along, down = half[:, 1:] - half[:, :-1], half[1:] - half[:-1]
    differences = np.concatenate([far, along.reshape(-1, 3), down.reshape(-1, 3)])
    contrast = np.sqrt((differences**2).sum(axis=1)) / _NORM
    kept = contrast >= _LEAST
    return differences[kept], contrast[kept]


def _nearest(rgb: NDArray[np.floating], scale: float) -> NDArray[np.floating]:
    index = []
    for size in rgb.shape[:2]:
        count = max(1, round(size * scale))
        index.append(((np.arange(count) + 0.5) * size / count).astype(np.int64))
    return rgb[np.ix_(*index)]
