"""The joint colour histogram of a set of photographs: all that the fit needs to know of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.weights import Encoding

_CODES = 256
_CELLS = _CODES**3
_IMAGE_MASS = 1 << 36
"""The mass of one image under `weighting: image`: rounding per pixel shows in the 4th digit at most, and 2^53
holds 131,072 images."""

LINEAR_EDGES: NDArray[np.int64] = np.ceil(65535 * (np.arange(_CODES + 1) / _CODES) ** 2).astype(np.int64)
"""Cell c of linear 16-bit input holds the values LINEAR_EDGES[c] <= v < LINEAR_EDGES[c + 1]: even steps
of the square root, so that cells are about as wide as the photon noise in them."""
LINEAR_EDGES[-1] = 65536

_LINEAR_CODE: NDArray[np.uint8] = np.repeat(np.arange(_CODES, dtype=np.uint8), np.diff(LINEAR_EDGES))


@dataclass(frozen=True)
class Cells:
    """The occupied cells of a histogram: M boxes of colours, and the pixels in each.

    `low`, `high`: (M, 3) int64, the least and greatest R, G, B of a box, both inclusive; equal for
    coded input. `mass`: (M,) int64, pixels (or weighted pixels).
    """

    low: NDArray[np.int64]
    high: NDArray[np.int64]
    mass: NDArray[np.int64]


class Histogram:
    """How many pixels of the set have each colour. Adding histograms is pooling their photographs.

    Coded 8-bit input is counted exactly, one cell a colour. Linear 16-bit input is counted in 256
    cells a channel, even in the square root; `Cells` says what range of values each holds, so that a
    search over it can bound what the rounding hides. Counts are integers: order and grouping of the
    images cannot change them.
    """

    def __init__(self, encoding: Encoding = "coded") -> None:
        self.encoding: Encoding = encoding
        self.counts: NDArray[np.int64] = np.zeros(_CELLS, np.int64)
        self.images = 0
        self.pixels = 0

    def add(self, rgb: NDArray[np.uint8] | NDArray[np.uint16], *, weighting: str = "pixel") -> None:
        """Counts one photograph.

        rgb: (H, W, 3); uint8 gamma-coded for `coded`, uint16 linear with 65535 at sensor saturation
        for `linear`. `weighting="image"` gives every photograph the same mass. Raises ValueError on
        another shape or dtype.
        """
        expected = np.uint8 if self.encoding == "coded" else np.uint16
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != expected or not rgb.size:
            raise ValueError(f"{rgb.shape=} {rgb.dtype=}, expected (H, W, 3) {np.dtype(expected)}")
        pixels = rgb.shape[0] * rgb.shape[1]
        mass = self.mass_of(rgb, weighting)
        # Bands of rows keep the index array small beside the image itself.
        band = max(1, (1 << 20) // rgb.shape[1])
        for top in range(0, rgb.shape[0], band):
            codes = rgb[top : top + band]
            if self.encoding == "linear":
                codes = _LINEAR_CODE[codes]
            index = codes[..., 0].astype(np.int32)
            index <<= 8
            index |= codes[..., 1]
            index <<= 8
            index |= codes[..., 2]
            np.add.at(self.counts, index.reshape(-1), mass)
        self.images += 1
        self.pixels += pixels

    @staticmethod
    def mass_of(rgb: NDArray[np.uint8] | NDArray[np.uint16], weighting: str) -> int:
        """What one pixel of this photograph counts."""
        return 1 if weighting == "pixel" else _IMAGE_MASS // (rgb.shape[0] * rgb.shape[1])

    def __add__(self, other: Histogram) -> Histogram:
        if self.encoding != other.encoding:
            raise ValueError(
                f"{self.encoding=} and {other.encoding=} do not add: their values differ in kind"
            )
        total = Histogram(self.encoding)
        total.counts = self.counts + other.counts
        total.images = self.images + other.images
        total.pixels = self.pixels + other.pixels
        return total

    def cells(self) -> Cells:
        """The occupied cells, ordered by colour."""
        index = np.flatnonzero(self.counts)
        codes = np.stack([index >> 16, (index >> 8) & 255, index & 255], axis=1)
        if self.encoding == "coded":
            return Cells(codes, codes, self.counts[index])
        return Cells(LINEAR_EDGES[codes], LINEAR_EDGES[codes + 1] - 1, self.counts[index])
