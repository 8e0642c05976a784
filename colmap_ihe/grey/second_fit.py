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
_SEES = 0.5  # a second grey that keeps so much of it shows it
_DETAIL = 3.0  # times the noise: contrast of a block that holds detail
_FLATTEST = 0.05  # of the blocks, which noise is measured in
_FLOOR = 0.04  # levels squared, of noise: rounding, and flat areas of strong compression
_MOST_GAIN = 3.0  # levels of the second grey for a level of a channel
_DIRECTIONS = 4000
_MOST_BLOCKS = 20_000  # that the direction is sought with
ENOUGH, ENOUGH_OF_PHOTOGRAPH = 0.01, 0.03
"""Shares of the blocks with detail, of the set or of two of its photographs, which the grey must lose and the second
show. Measured (benchmarks/colour.py): stone below 0.003 and 0.005, the demo's paintings 0.04 and more."""
_OF_SIX = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Blocks:
    """Hold the detail of a photograph by blocks: `colours` (n, 6) float32, the covariance RR GG BB RG RB GB of its
    colours in the band, `grey` (n,) float32 the variance of its grey there, in levels squared."""

    colours: NDArray[np.float32]
    grey: NDArray[np.float32]


@dataclass(frozen=True)
class SecondFit:
    """Hold what came of the fit. `lost`: the share of the blocks with detail of which the grey keeps little, of the
    set; `by_photograph` the same of each; `regained`: the part of them, of all blocks, that the second shows. `second`
    is None where the first does without."""

    lost: float
    regained: float
    by_photograph: tuple[float, ...]
    second: SecondGrey | None


def blocks_of(grey: U8, colour: U8) -> Blocks:
    """Measure a photograph from its grey (H, W) and its colours (H, W, 3), both uint8. Blocks that are clipped or
    without any change are left out."""
    colours, greys = band(shrunk(colour)), band(shrunk(grey))
    pairs = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    products = np.stack([_means(colours[..., i] * colours[..., j]) for i, j in pairs], axis=-1).reshape(-1, 6)
    variance = _means(np.square(greys)).ravel()
    shows = (products[:, :3] > 0).all(axis=1)
    return Blocks(products[shows], variance[shows])


def fit_second(photographs: Sequence[Blocks], name: str | None = None) -> SecondFit:
    """Return the second grey that shows most blocks of those that the first loses: at least half of their contrast.

    Contrast is in units of the noise, as the guard has it: sqrt(w'Cw / w'Nw) of the best weights w there are. Of
    directions that show equally many, that with most contrast in all of them. With the `name` of fixed weights these
    are taken, however little is lost.
    """
    colours = np.concatenate([np.empty((0, 6), np.float32), *(p.colours for p in photographs)]).astype(
        np.float64
    )
    grey = np.concatenate([np.empty(0, np.float32), *(p.grey for p in photographs)]).astype(np.float64)
    if not len(grey):
        return SecondFit(0.0, 0.0, (0.0,) * len(photographs), None)
    flattest = np.argsort(colours[:, :3].sum(axis=1), kind="stable")[: max(1, int(_FLATTEST * len(grey)))]
    noise = colours[flattest].mean(axis=0)[_OF_SIX] + _FLOOR * np.eye(3)
    grey_noise = float(grey[flattest].mean()) + _FLOOR
    whitening = np.linalg.inv(np.linalg.cholesky(noise))
    white = whitening @ colours[:, _OF_SIX] @ whitening.T
    best = np.asarray(np.linalg.eigvalsh(white)[:, 2], np.float64)
    detailed = best > _DETAIL**2
    lost = detailed & (grey / grey_noise < _LOST**2 * best)
    direction = _direction(white[lost], best[lost]) @ whitening if name is None else np.array(FIXED[name])
    second = _scaled(direction, noise, grey_noise, name or "fitted")
    seen = np.einsum("i,nij,j->n", direction, colours[:, _OF_SIX], direction) / (
        direction @ noise @ direction
    )
    regained = lost & (seen >= _SEES**2 * best)
    ends = np.cumsum([0, *(len(p.grey) for p in photographs)])
    parts = [slice(*both) for both in pairwise(ends)]
    of_each = [_share(regained[part], detailed[part]) for part in parts]
    needed = _share(regained, detailed) >= ENOUGH or sum(s >= ENOUGH_OF_PHOTOGRAPH for s in of_each) >= 2
    return SecondFit(
        _share(lost, detailed),
        _share(regained, detailed),
        tuple(_share(lost[part], detailed[part]) for part in parts),
        second if needed or name is not None else None,
    )


def _direction(white: F64, best: F64) -> F64:
    """Return (3,), of whitened colours, for blocks (n, 3, 3) whose greatest contrast squared is `best` (n,)."""
    if not len(best):
        return np.array([0.0, 0.0, 1.0])
    some = np.unique(np.linspace(0, len(best) - 1, _MOST_BLOCKS).astype(int))
    # Half a sphere, evenly (Fibonacci lattice).
    number = np.arange(_DIRECTIONS) + 0.5
    up, turn = number / _DIRECTIONS, np.pi * (1 + 5**0.5) * number
    aside = np.sqrt(1 - up**2)
    directions = np.stack((aside * np.cos(turn), aside * np.sin(turn), up), axis=1)
    shown, total = np.empty(_DIRECTIONS), np.empty(_DIRECTIONS)
    six = white[some].reshape(-1, 9).T
    for begin in range(0, _DIRECTIONS, 100):
        u = directions[begin : begin + 100]
        contrast = np.einsum("ni,nj->nij", u, u).reshape(-1, 9) @ six
        shown[begin : begin + 100] = (contrast >= _SEES**2 * best[some]).sum(axis=1)
        total[begin : begin + 100] = np.log1p(contrast).sum(axis=1)
    return np.asarray(directions[np.lexsort((-total, -shown))[0]])


def _scaled(direction: F64, noise: F64, grey_noise: float, name: str) -> SecondGrey:
    """Return the direction with as much noise as the first grey has, or less where that would clip."""
    own = float(direction @ noise @ direction)
    gain = min(float(np.sqrt(grey_noise / own)), _MOST_GAIN / float(np.abs(direction).max()))
    red, green, blue = (float(round(w, 4)) for w in gain * direction)
    return SecondGrey(red, green, blue, grey_noise, own * gain**2, name)


def _means(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the mean over each block of (H, W); what is left at the edges does not count."""
    height, width = (n // _BLOCK for n in values.shape)
    if not height or not width:
        return np.empty((0, 0), np.float32)
    whole = values[: height * _BLOCK, : width * _BLOCK]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> float:
    return float(part.sum() / max(1, whole.sum()))
