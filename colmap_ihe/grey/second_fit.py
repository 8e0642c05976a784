"""Fit the second grey to the detail that the first one loses, over all photographs of a set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.second import U8, SecondGrey, band, shrunk
from colmap_ihe.grey.weights import FIXED

_BLOCK = 8  # a side, in pixels of the half size
_LOST = 0.3  # a grey that keeps less than this share of a block's contrast has lost it
_DETAIL = 3.0  # times the noise: contrast of a block that holds detail, and of one that a second grey shows
_FLATTEST = 0.05  # of the blocks, which noise is measured in
_FLOOR = 0.02  # levels squared, of noise: rounding, and flat areas of strong compression
_MOST_GAIN = 3.0  # levels of the second grey for a level of a channel
_DIRECTIONS = 4000
_MOST_BLOCKS = 20_000  # that the direction is sought with
ENOUGH, ENOUGH_OF_PHOTOGRAPH = 0.015, 0.03
"""Shares of the blocks with detail, of the set or of two of its photographs, which the grey must lose and the second
show. Measured (benchmarks/colours.py): stone below 0.008 and 0.014, the demo's paintings 0.04."""
_ALL = slice(None)
_OF_SIX = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Blocks:
    """Hold the detail of a photograph by blocks: `colours` (n, 6) float32, the covariance RR GG BB RG RB GB of its
    colours in the band, `grey` and `rec709` (n,) float32 the variance of its grey and of COLMAP's default there, both
    rounded to whole levels, in levels squared."""

    colours: NDArray[np.float32]
    grey: NDArray[np.float32]
    rec709: NDArray[np.float32]


@dataclass(frozen=True)
class Noise:
    """Hold what the band holds where there is no detail: `colours`, the covariance RR GG BB RG RB GB, and the variance
    of `grey` and `rec709`, in levels squared."""

    colours: Sequence[float]
    grey: float
    rec709: float

    @property
    def matrix(self) -> F64:
        """Return the covariance of the colours, (3, 3)."""
        return np.asarray(np.array(self.colours)[_OF_SIX])


@dataclass(frozen=True)
class SecondFit:
    """Hold what came of the fit, as shares of the blocks with detail. `lost`: those of which the grey keeps little;
    `lost_by_rec709` the same of COLMAP's default; `regained`: those that the grey loses and the second shows;
    `by_photograph` what the grey loses of each. `second` is None where the first does without."""

    lost: float
    lost_by_rec709: float
    regained: float
    by_photograph: tuple[float, ...]
    noise: Noise
    second: SecondGrey | None


def blocks_of(grey: U8, colour: U8) -> Blocks:
    """Measure a photograph from its grey (H, W) and its colours (H, W, 3), both uint8. Blocks that are clipped or
    without any change are left out."""
    colours, variance, rec709 = _grids(grey, colour)
    shows = (colours[..., :3] > 0).all(axis=-1)
    return Blocks(colours[shows], variance[shows], rec709[shows])


def lost_places(grey: U8, colour: U8, noise: Noise) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where the grey (H, W) of a photograph keeps little of the detail of its colours (H, W, 3), and where
    Rec.709 does: (h, w) bool each, a block of the smaller copy that is measured a pixel."""
    colours, variance, rec709 = _grids(grey, colour)
    judged = _judge(Blocks(colours.reshape(-1, 6), variance.ravel(), rec709.ravel()), noise)
    return judged.lost.reshape(variance.shape), judged.lost_by_rec709.reshape(variance.shape)


def fit_second(photographs: Sequence[Blocks], name: str | None = None) -> SecondFit:
    """Return the second grey that shows most of the detail that the first loses.

    Contrast is in units of the noise, as the guard has it: sqrt(w'Cw / w'Nw) of the best weights w there are. A block
    counts by its contrast squared in the second, up to that of a block that holds detail. What share of the best
    contrast is kept does not count: half of it is more than features and stereo need of a bright pattern, and noise of
    a pale one. With the `name` of fixed weights these are taken, however little is lost.
    """
    every = Blocks(
        np.concatenate([np.empty((0, 6), np.float32), *(p.colours for p in photographs)]),
        np.concatenate([np.empty(0, np.float32), *(p.grey for p in photographs)]),
        np.concatenate([np.empty(0, np.float32), *(p.rec709 for p in photographs)]),
    )
    noise = _noise_of(every)
    judged = _judge(every, noise)
    chosen = _direction(judged) if name is None else np.array(FIXED[name])
    regained = judged.lost & (_contrast(every, noise, chosen) > _DETAIL**2)
    ends = np.cumsum([0, *(len(p.grey) for p in photographs)])
    parts = [slice(*both) for both in pairwise(ends)]

    def share(of: NDArray[np.bool_], part: slice = _ALL) -> float:
        return float(of[part].sum() / max(1, judged.detailed[part].sum()))

    needed = share(regained) >= ENOUGH or sum(share(regained, p) >= ENOUGH_OF_PHOTOGRAPH for p in parts) >= 2
    return SecondFit(
        share(judged.lost),
        share(judged.lost_by_rec709),
        share(regained),
        tuple(share(judged.lost, part) for part in parts),
        noise,
        _scaled(chosen, noise, name or "fitted") if needed or name is not None else None,
    )


@dataclass(frozen=True)
class _Judged:
    """Hold of n blocks: `white` (n, 3, 3) the covariance in colours whose noise is 1 in every direction, `whitening`
    what makes them so, and which of them hold detail and are lost."""

    white: F64
    whitening: F64
    detailed: NDArray[np.bool_]
    lost: NDArray[np.bool_]
    lost_by_rec709: NDArray[np.bool_]


def _judge(blocks: Blocks, noise: Noise) -> _Judged:
    whitening = np.linalg.inv(np.linalg.cholesky(noise.matrix))
    white = whitening @ blocks.colours.astype(np.float64)[:, _OF_SIX] @ whitening.T
    best = np.asarray(np.linalg.eigvalsh(white)[:, 2], np.float64)
    detailed = best > _DETAIL**2
    lost = detailed & (blocks.grey / noise.grey < _LOST**2 * best)
    lost_by_rec709 = detailed & (blocks.rec709 / noise.rec709 < _LOST**2 * best)
    return _Judged(white, whitening, detailed, lost, lost_by_rec709)


def _contrast(blocks: Blocks, noise: Noise, weights: F64) -> F64:
    """Return the contrast squared of each block in a grey of these weights of the colours, (n,)."""
    detail = np.einsum("i,nij,j->n", weights, blocks.colours.astype(np.float64)[:, _OF_SIX], weights)
    return np.asarray(detail / (weights @ noise.matrix @ weights))


def _noise_of(blocks: Blocks) -> Noise:
    """Return the mean over the flattest blocks, and what rounding adds."""
    flattest = np.argsort(blocks.colours[:, :3].sum(axis=1), kind="stable")
    flattest = flattest[: max(1, int(_FLATTEST * len(flattest)))]
    if not len(flattest):
        return Noise((_FLOOR,) * 3 + (0.0,) * 3, _FLOOR, _FLOOR)
    colours = blocks.colours[flattest].astype(np.float64).mean(axis=0) + _FLOOR * np.array([1, 1, 1, 0, 0, 0])
    grey, rec709 = (
        float(values[flattest].astype(np.float64).mean()) + _FLOOR for values in (blocks.grey, blocks.rec709)
    )
    return Noise(tuple(colours.tolist()), grey, rec709)


def _direction(judged: _Judged) -> F64:
    """Return the direction in colour, (3,), that shows most of the detail of the lost blocks."""
    numbers = np.flatnonzero(judged.lost)
    if not len(numbers):
        return np.array(FIXED["blue"])
    some = numbers[np.unique(np.linspace(0, len(numbers) - 1, _MOST_BLOCKS).astype(int))]
    # Half a sphere, evenly (Fibonacci lattice).
    number = np.arange(_DIRECTIONS) + 0.5
    up, turn = number / _DIRECTIONS, np.pi * (1 + 5**0.5) * number
    aside = np.sqrt(1 - up**2)
    directions = np.stack((aside * np.cos(turn), aside * np.sin(turn), up), axis=1)
    shown = np.empty(_DIRECTIONS)
    nine = judged.white[some].reshape(-1, 9).T
    for begin in range(0, _DIRECTIONS, 100):
        u = directions[begin : begin + 100]
        contrast = np.einsum("ni,nj->nij", u, u).reshape(-1, 9) @ nine
        shown[begin : begin + 100] = np.clip(contrast / _DETAIL**2, 0, 1).sum(axis=1)
    return np.asarray(directions[np.argmax(shown)] @ judged.whitening)


def _scaled(direction: F64, noise: Noise, name: str) -> SecondGrey:
    """Return the direction with as much noise as the first grey has, or less where that would clip."""
    own = float(direction @ noise.matrix @ direction)
    gain = min(float(np.sqrt(noise.grey / own)), _MOST_GAIN / float(np.abs(direction).max()))
    red, green, blue = (float(round(w, 4)) for w in gain * direction)
    return SecondGrey(red, green, blue, noise.grey, own * gain**2, name)


def _grids(grey: U8, colour: U8) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return of each block the covariance of the colours, (h, w, 6), and the variances of the grey and of Rec.709,
    (h, w)."""
    weights = np.array(FIXED["rec709"], np.float32)[None]
    rec709 = np.rint(cv2.transform(colour.astype(np.float32), weights)).astype(np.uint8)
    colours = band(shrunk(colour))
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    products = np.stack([_means(colours[..., i] * colours[..., j]) for i, j in pairs], axis=-1)
    variance, of_rec709 = (_means(band(shrunk(values)) ** 2) for values in (grey, rec709))
    return products, variance, of_rec709


def _means(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean over each block of (H, W); what is left at the edges does not count."""
    height, width = (n // _BLOCK for n in values.shape)
    if not height or not width:
        return np.empty((0, 0), np.float32)
    whole = values[: height * _BLOCK, : width * _BLOCK]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32)
