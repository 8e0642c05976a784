"""Measure how far above its noise each grey of a set shows detail, for the guard of the fit.

Detail is the covariance C of the colours in a band of the picture, noise their covariance N where there
should be nothing to see; both are 3x3 and summed over the set. The contrast of every triplet w follows:
sqrt(w'Cw / w'Nw). Detail is measured one octave below the noise, where features are found again.

What noise is depends on how the photograph came about.

Linear (RAW): photon noise. Its variance is the signal itself, in the same units for all colours of one
sensor, so the mean of a channel is its noise but for a factor common to all. Green has twice the samples
of red or blue; bilinear demosaicing passes the noise of each on by itself, green's `_GREEN_SHARE` as
strongly. Read noise matters only where next to no light falls. Nothing is estimated from the picture:
estimates take the blur of demosaiced red and blue for the absence of noise.

Coded (JPEG): the maker's processing is not known, so noise is what the flattest twentieth of the blocks
shows at each brightness, and the rounding to 8 bit. Coding makes noise about even over brightness; a
brightness at which even the flattest blocks are textured shows more, so the quieter half of them counts.

`benchmarks/guard.py` has the experiment behind the bands and `CLOSENESS`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey import kernels
from colmap_ihe.grey.weights import Encoding, Triplet, triplets

CLOSENESS = 0.998
"""A triplet is admitted whose contrast is at least this share of the best one's."""

DEFAULT_ENOUGH = 0.94
"""Where Rec.709's own contrast is at least this share of the best one's, it stays: COLMAP's default is left only
for a gain that the measure is sure of."""

_REC709 = (21.26, 71.52, 7.22)
_GREEN_SHARE = 0.77  # variance of white noise through LibRaw's bilinear demosaic and the noise band, G over R
_SIGMA, _WIDTH = 1.0, 1.6  # the noise band: Gaussians of sigma 1 and 1.6; the detail band at half the size
_BLOCK = 8
_FLATTEST, _BRIGHTNESSES = 0.05, 12
_SATURATED = 0.98
_BLACK = 0.001  # the frame of an undistorted picture: its edge would outweigh all detail
_ROUNDING = 1 / (12 * 255**2) * 0.03  # of 8-bit values, as much of it as lies in the noise band
_TILE, _MARGIN = 128, 16
_SAMPLE = 16  # tiles a photograph; with 4, sets of ten photographs gave other triplets
_GRAIN = 2.0**20  # sums are whole multiples of 1 / _GRAIN, so that adding them is exact in any order
_MOST = 2.0**33  # of a sum, beyond which not all multiples of 1 / _GRAIN are numbers
_IMAGE_MASS = 1 << 24

_F64 = NDArray[np.float64]
_Pixels = NDArray[np.uint8] | NDArray[np.uint16]


class Contrast:
    """Hold detail and noise of the colours of a set. Adding two is pooling their photographs.

    `signal`, `noise`: (3, 3) float64, symmetric, channel values in [0, 1] squared, times pixels. Both are
    kept on a grid on which sums are exact: order and grouping of the photographs cannot change them.
    """

    def __init__(self, encoding: Encoding = "coded") -> None:
        self.encoding: Encoding = encoding
        self.signal: _F64 = np.zeros((3, 3))
        self.noise: _F64 = np.zeros((3, 3))

    def add(self, rgb: NDArray[np.uint8] | NDArray[np.uint16], *, weighting: str = "pixel") -> None:
        """Measure one photograph, in tiles spread evenly over it.

        rgb: (H, W, 3); uint8 gamma-coded for `coded`, uint16 linear with 65535 at sensor saturation for
        `linear`. `weighting="image"` gives every photograph the same mass. Saturated and black pixels do not count.
        Raises ValueError on another shape or dtype.
        """
        expected = np.uint8 if self.encoding == "coded" else np.uint16
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != expected or not rgb.size:
            raise ValueError(f"{rgb.shape=} {rgb.dtype=}, expected (H, W, 3) {np.dtype(expected)}")
        mass = _IMAGE_MASS if weighting == "image" else rgb.shape[0] * rgb.shape[1]
        tiles = list(_tiles(rgb))
        if not any((t[..., c] != t[..., 1]).any() for t in tiles for c in (0, 2)):
            return  # greyscale: any triplet gives the same
        detail = _detail(tiles)
        if detail is None:  # saturated throughout, or smaller than a block
            return
        noise = _flat_noise(tiles) if self.encoding == "coded" else _photon_noise(tiles)
        self.signal = self.signal + _on_grid(detail * mass)
        self.noise = self.noise + _on_grid(noise * mass)

    def __add__(self, other: Contrast) -> Contrast:
        if self.encoding != other.encoding:
            raise ValueError(
                f"{self.encoding=} and {other.encoding=} do not add: their noise differs in kind"
            )
        total = Contrast(self.encoding)
        total.signal = self.signal + other.signal
        total.noise = self.noise + other.noise
        return total

    def as_dict(self) -> dict[str, list[float]]:
        """Return plain values; `from_dict` reads them back, to the bit."""
        return {"signal": self.signal.ravel().tolist(), "noise": self.noise.ravel().tolist()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any], encoding: Encoding) -> Contrast:
        """Read what `as_dict` wrote. Raises ValueError, TypeError or KeyError for what it could not have written."""
        contrast = cls(encoding)
        for name in ("signal", "noise"):
            sums = np.array(values[name], np.float64).reshape(3, 3)
            if not (np.abs(sums) <= _MOST).all() or (sums != sums.T).any() or (sums != _on_grid(sums)).any():
                raise ValueError("sums of contrast that are none")
            setattr(contrast, name, sums)
        return contrast

    def snr_of(self, grid: Sequence[tuple[float, float, float]] | _F64) -> _F64:
        """Return sqrt(w'Cw / w'Nw) of each triplet, in hundredths: (n,) float64; all 0 while nothing was measured."""
        w = np.asarray(grid, np.float64) / 100
        noise, detail = (np.einsum("ni,ni->n", w @ of, w) for of in (self.noise, self.signal))
        ratio = np.divide(np.maximum(detail, 0), noise, out=np.zeros(len(w)), where=noise > 0)
        return np.asarray(np.sqrt(ratio))

    def share_of(self, triplet: tuple[float, float, float]) -> float | None:
        """Return the contrast of weights as a share of the best there is; None where no detail was measured."""
        best = float(self.snr_of(triplets()).max())
        red, green, blue = (100 * w for w in triplet)
        return float(self.snr_of([(red, green, blue)])[0]) / best if best > 0 else None

    def best(self, grid: Sequence[Triplet]) -> Triplet:
        """Return the triplet of greatest contrast; of equals the nearest to Rec.709."""
        return grid[int(np.lexsort((_away(grid), -self.snr_of(grid)))[0])]

    def admitted(self, grid: Sequence[Triplet]) -> list[Triplet]:
        """Return those whose contrast is at least `CLOSENESS` of the best one's, in the order given. Only the nearest
        to Rec.709 where its contrast is `DEFAULT_ENOUGH`; all where no detail was measured."""
        snr, default = self.snr_of(grid), int(np.argmin(_away(grid)))
        if snr.max() > 0 and snr[default] >= DEFAULT_ENOUGH * snr.max():
            return [grid[default]]
        least = CLOSENESS * snr.max()
        return [t for t, value in zip(grid, snr, strict=True) if value >= least]


def _away(grid: Sequence[Triplet]) -> _F64:
    return np.asarray(((np.asarray(grid, np.float64) - _REC709) ** 2).sum(axis=1))


def _on_grid(sums: _F64) -> _F64:
    return np.asarray(np.rint(sums * _GRAIN) / _GRAIN)


def _tiles(rgb: _Pixels) -> Iterator[_Pixels]:
    """Yield at most `_SAMPLE` tiles with margins, in even steps over the photograph; all of a small one."""
    height, width = rgb.shape[:2]
    side = _TILE + 2 * _MARGIN
    across = max(1, min(width // side, round((_SAMPLE * width / height) ** 0.5)))
    down = max(1, min(height // side, _SAMPLE // across))
    if across * down < _SAMPLE and across == max(1, width // side) and down == max(1, height // side):
        yield rgb[: height // 2 * 2, : width // 2 * 2]
        return
    for y in np.linspace(0, height - side, down).astype(int) // 2 * 2:
        for x in np.linspace(0, width - side, across).astype(int) // 2 * 2:
            yield rgb[y : y + side, x : x + side]


@cache
def _band(most: int) -> kernels.Band:
    """Return the band of detail, and where to look for it, of values of which `most` is full scale."""
    coarse = _SIGMA * (_WIDTH**2 - 1) ** 0.5
    taps = [cv2.getGaussianKernel(7, sigma, cv2.CV_32F)[3:, 0] for sigma in (_SIGMA, coarse)]
    exposed = (math.floor(_BLACK * most) + 1, math.ceil(_SATURATED * most) - 1)
    return np.concatenate([*taps, exposed]).astype(np.float32)


def _full_scale(tile: _Pixels) -> int:
    return int(np.iinfo(tile.dtype).max)


def _detail(tiles: Sequence[_Pixels]) -> _F64 | None:
    """Return (3, 3): the mean of d d' in the detail band, over pixels that are not on or beside saturated or black
    ones; None if there are none."""
    start = _MARGIN - 2 * kernels.BAND_REACH
    most = 4 * _full_scale(tiles[0])  # of sums of 2x2 values
    total = np.zeros(7)
    for tile in tiles:
        height, width = (n // 2 * 2 for n in tile.shape[:2])
        if min(height, width) > 2 * _MARGIN:
            total += kernels.measure_detail(tile[start : height - start, start : width - start], _band(most))
    return _symmetric(total[:6] / total[6] / most**2) if total[6] else None


def _photon_noise(tiles: Sequence[_Pixels]) -> _F64:
    """Return (3, 3), up to a factor that all photographs share: n photons vary by sqrt(n)."""
    total, count = np.zeros(3), 0
    for tile in tiles:
        # As three planes: a maximum over the last axis is many times slower.
        brightest = np.maximum(np.maximum(tile[..., 0], tile[..., 1]), tile[..., 2])
        counts = (brightest < _SATURATED * 65535) & (brightest > _BLACK * 65535)
        total += tile[counts].sum(axis=0)
        count += int(counts.sum())
    return np.diag(total / max(1, count) / 65535 * (1, _GREEN_SHARE, 1))


def _flat_noise(tiles: Sequence[_Pixels]) -> _F64:
    """Return the covariance of the noise band in the flattest blocks of the quieter brightnesses, and of rounding."""
    blocks = np.concatenate([_blocks(tile) for tile in tiles])
    exposed = blocks[:, 7] == _BLOCK**2
    shows = (blocks[:, :3] > 0).all(axis=1)  # no frame, no area clipped to one value
    blocks = blocks[exposed & shows]
    if not len(blocks):
        return np.eye(3) * _ROUNDING
    roughness = (blocks[:, :3] / np.median(blocks[:, :3], axis=0)).sum(axis=1)
    found = []
    for group in np.array_split(np.argsort(blocks[:, 6], kind="stable"), _BRIGHTNESSES):
        if len(group):
            flattest = np.argsort(roughness[group], kind="stable")[: max(1, int(_FLATTEST * len(group)))]
            mean = blocks[group[flattest], :6].mean(axis=0, dtype=np.float64)
            found.append(_symmetric(mean / (_BLOCK * _full_scale(tiles[0])) ** 2))
    found.sort(key=np.trace)
    return np.asarray(np.mean(found[: (len(found) + 1) // 2], axis=0) + np.eye(3) * _ROUNDING)


def _blocks(tile: _Pixels) -> NDArray[np.float32]:
    """Return what is measured in the blocks within the margins of a tile: (n, 8)."""
    height, width = ((n - 2 * _MARGIN) // _BLOCK * _BLOCK for n in tile.shape[:2])
    if height <= 0 or width <= 0:
        return np.zeros((0, 8), np.float32)
    start, more = _MARGIN - kernels.BAND_REACH, 2 * kernels.BAND_REACH
    around = tile[start : start + height + more, start : start + width + more]
    return kernels.measure_blocks(around, _band(_full_scale(tile)))


def _symmetric(products: _F64) -> _F64:
    """Return (3, 3) of RR, GG, BB, RG, RB, GB."""
    return products[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
