"""How far above its noise each grey of a set shows detail: what the guard of the fit goes by.

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

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.weights import Encoding, triplets

CLOSENESS = 0.998
"""A triplet is admitted whose contrast is at least this share of the best one's."""

DEFAULT_ENOUGH = 0.97
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
_IMAGE_MASS = 1 << 24

_F32 = NDArray[np.float32]
_F64 = NDArray[np.float64]


class Contrast:
    """Detail and noise of the colours of a set. Adding two is pooling their photographs.

    `signal`, `noise`: (3, 3) float64, symmetric, channel values in [0, 1] squared, times pixels. Both are
    kept on a grid on which sums are exact: order and grouping of the photographs cannot change them.
    """

    def __init__(self, encoding: Encoding = "coded") -> None:
        self.encoding: Encoding = encoding
        self.signal: _F64 = np.zeros((3, 3))
        self.noise: _F64 = np.zeros((3, 3))

    def add(self, rgb: NDArray[np.uint8] | NDArray[np.uint16], *, weighting: str = "pixel") -> None:
        """Measures one photograph, in tiles spread evenly over it.

        rgb: (H, W, 3); uint8 gamma-coded for `coded`, uint16 linear with 65535 at sensor saturation for
        `linear`. `weighting="image"` gives every photograph the same mass. Saturated and black pixels do not count.
        Raises ValueError on another shape or dtype.
        """
        expected = np.uint8 if self.encoding == "coded" else np.uint16
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != expected or not rgb.size:
            raise ValueError(f"{rgb.shape=} {rgb.dtype=}, expected (H, W, 3) {np.dtype(expected)}")
        mass = _IMAGE_MASS if weighting == "image" else rgb.shape[0] * rgb.shape[1]
        stored = list(_tiles(rgb))
        if not any((t[..., :2] != t[..., 1:]).any() for t in stored):  # greyscale: any triplet gives the same
            return
        tiles = [np.asarray(tile, np.float32) / np.float32(np.iinfo(rgb.dtype).max) for tile in stored]
        detail = _mean_of_squares([_detail(tile) for tile in tiles])
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

    def snr_of(self, grid: Sequence[tuple[float, float, float]]) -> _F64:
        """sqrt(w'Cw / w'Nw) of each triplet, in hundredths: (n,) float64; all 0 while nothing was measured."""
        w = np.asarray(grid, np.float64) / 100
        noise = np.einsum("ni,ij,nj->n", w, self.noise, w)
        detail = np.einsum("ni,ij,nj->n", w, self.signal, w)
        ratio = np.divide(np.maximum(detail, 0), noise, out=np.zeros(len(w)), where=noise > 0)
        return np.asarray(np.sqrt(ratio))

    def share_of(self, triplet: tuple[float, float, float]) -> float | None:
        """The contrast of weights as a share of the best there is; None where no detail was measured."""
        best = float(self.snr_of(triplets()).max())
        red, green, blue = (100 * w for w in triplet)
        return float(self.snr_of([(red, green, blue)])[0]) / best if best > 0 else None

    def best(self, grid: Sequence[tuple[int, int, int]]) -> tuple[int, int, int]:
        """The triplet of greatest contrast; of equals the nearest to Rec.709."""
        snr = self.snr_of(grid)
        away = ((np.asarray(grid) - _REC709) ** 2).sum(axis=1)
        return grid[int(np.lexsort((away, -snr))[0])]

    def admitted(
        self, grid: Sequence[tuple[int, int, int]], closeness: float = CLOSENESS
    ) -> list[tuple[int, int, int]]:
        """Those whose contrast is at least `closeness` of the best one's, in the order given. Only the nearest to
        Rec.709 where its contrast is `DEFAULT_ENOUGH`; all where no detail was measured."""
        snr = self.snr_of(grid)
        away = ((np.asarray(grid) - _REC709) ** 2).sum(axis=1)
        default = int(np.argmin(away))
        if snr.max() > 0 and snr[default] >= DEFAULT_ENOUGH * snr.max():
            return [grid[default]]
        least = closeness * snr.max()
        return [t for t, value in zip(grid, snr, strict=True) if value >= least]


def _on_grid(sums: _F64) -> _F64:
    return np.asarray(np.rint(sums * _GRAIN) / _GRAIN)


def _tiles(rgb: NDArray[np.uint8] | NDArray[np.uint16]) -> Iterator[NDArray[np.uint8] | NDArray[np.uint16]]:
    """At most `_SAMPLE` tiles with margins, in even steps over the photograph; all of a small one."""
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


def _detail(tile: _F32) -> tuple[_F32, NDArray[np.bool_]]:
    """The detail band of a tile (n, 3), and where it counts (n,): not on or beside saturated or black ones."""
    if min(tile.shape[:2]) < 2 * _MARGIN:
        return np.zeros((0, 3), np.float32), np.zeros(0, bool)
    half = _shrunk(tile, tile.shape[0] // 2, tile.shape[1] // 2)
    counts = cv2.erode(_exposed(half).view(np.uint8), np.ones((7, 7), np.uint8)) > 0
    inside = slice(_MARGIN // 2, -(_MARGIN // 2))
    return _band(half)[inside, inside].reshape(-1, 3), counts[inside, inside].reshape(-1)


def _shrunk(plane: _F32, height: int, width: int) -> _F32:
    return np.asarray(cv2.resize(plane, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _band(tile: _F32) -> _F32:
    fine = cv2.GaussianBlur(tile, (7, 7), _SIGMA)
    coarse = cv2.GaussianBlur(fine, (7, 7), _SIGMA * (_WIDTH**2 - 1) ** 0.5)
    return np.asarray(cv2.subtract(fine, coarse))


def _exposed(values: _F32) -> NDArray[np.bool_]:
    # As three planes: a maximum over the last axis is many times slower.
    brightest = np.maximum(np.maximum(values[..., 0], values[..., 1]), values[..., 2])
    return np.asarray((brightest < _SATURATED) & (brightest > _BLACK))


def _mean_of_squares(parts: list[tuple[_F32, NDArray[np.bool_]]]) -> _F64 | None:
    """(3, 3): the mean of d d' over the vectors that count."""
    total, count = np.zeros((3, 3)), 0
    for band, counts in parts:
        kept = band * counts[:, None]
        total += (kept.T @ kept).astype(np.float64)
        count += int(counts.sum())
    return total / count if count else None


def _photon_noise(tiles: list[_F32]) -> _F64:
    """Up to a factor that all photographs share: light is counted in photons, and n of them vary by sqrt(n)."""
    total, count = np.zeros(3), 0
    for tile in tiles:
        counts = _exposed(tile)
        total += cv2.sumElems(cv2.bitwise_and(tile, tile, mask=counts.view(np.uint8)))[:3]
        count += int(counts.sum())
    return np.diag(total / max(1, count) * (1, _GREEN_SHARE, 1))


def _flat_noise(tiles: list[_F32]) -> _F64:
    """Covariance of the noise band in the flattest blocks, over the quieter brightnesses, and of rounding."""
    parts = [_blocks(tile) for tile in tiles]
    square, level = (np.concatenate([part[n] for part in parts]) for n in (0, 1))
    energy = square[:, (0, 1, 2), (0, 1, 2)]
    shows = (energy > 0).all(axis=1)  # no frame, no area clipped to one value
    if not shows.any():
        return np.eye(3) * _ROUNDING
    square, level, energy = square[shows], level[shows], energy[shows]
    roughness = (energy / np.median(energy, axis=0)).sum(axis=1)
    found = []
    for group in np.array_split(np.argsort(level, kind="stable"), _BRIGHTNESSES):
        if len(group):
            flattest = group[
                np.argsort(roughness[group], kind="stable")[: max(1, int(_FLATTEST * len(group)))]
            ]
            found.append(square[flattest].mean(axis=0, dtype=np.float64))
    found.sort(key=np.trace)
    return np.asarray(np.mean(found[: (len(found) + 1) // 2], axis=0) + np.eye(3) * _ROUNDING)


def _blocks(tile: _F32) -> tuple[_F32, _F32]:
    """Of the well exposed blocks of a tile: mean of d d' in the noise band (n, 3, 3), mean level (n,)."""
    height, width = ((n - 2 * _MARGIN) // _BLOCK * _BLOCK for n in tile.shape[:2])
    if height <= 0 or width <= 0:
        return np.zeros((0, 3, 3), np.float32), np.zeros(0, np.float32)
    inside = (slice(_MARGIN, _MARGIN + height), slice(_MARGIN, _MARGIN + width))
    band, values = _band(tile)[inside], tile[inside]

    def averaged(plane: NDArray[Any]) -> _F32:
        return _shrunk(plane, height // _BLOCK, width // _BLOCK).reshape(-1)

    square = np.empty((height * width // _BLOCK**2, 3, 3), np.float32)
    planes = [np.ascontiguousarray(band[..., c]) for c in range(3)]
    for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        square[:, i, j] = square[:, j, i] = averaged(planes[i] * planes[j])
    left_out = np.asarray(~_exposed(values), np.float32)
    counts = averaged(left_out) == 0
    level = _shrunk(values, height // _BLOCK, width // _BLOCK).mean(axis=2).reshape(-1)
    return square[counts], level[counts]
