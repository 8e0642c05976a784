"""The steps of minimal development on the mosaic, before demosaicing: arrays in, arrays out.

Order: dark frame or black level, flat field, bad pixels, green equilibrium (Intensity Histogram Equalisation,
2016, section on RAW processing; order as settled in docs/method.md).
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

FULL = 65535
"""What saturation becomes."""
_FLOOR = 1  # LibRaw takes 0 for a defect in the files of some makers
_MARK_BELOW = 16  # of the black level: where it is lower, a pixel may well be 0 by itself
_GREENS = (1, 3)
_STRIP = 1 << 16  # pixels
_CELLS = 48  # rows that are whole cells of every pattern: 2, 6, 8 and 16
_MOST_UNEQUAL = 0.1  # greens further apart are no matter of the sensor
_TILES = 16  # a side, to compare the greens in
_CLIPPED = 0.95  # of saturation
_REACH = 2  # pixels around a bad one that its value is guessed from
_FEWEST_NEIGHBOURS = 2


@dataclass(frozen=True, eq=False)
class Mosaic:
    """Hold what a sensor saw. `values`: (H, W) uint16, in the sensor's units. `pattern`: (n, n) uint8, the colour of
    each pixel of a cell: red 0, green 1, blue 2, the second green of a Bayer cell 3. `black`: (H, W) float32 or (n, n)
    float32 as `pattern`; `white`: the value of saturation."""

    values: NDArray[np.uint16]
    pattern: NDArray[np.uint8]
    black: NDArray[np.float32]
    white: float

    def __post_init__(self) -> None:
        """Raise ValueError for arrays of another shape."""
        if not self.values.ndim == self.pattern.ndim == self.black.ndim == 2:
            raise ValueError(
                f"{self.values.shape=} {self.pattern.shape=} {self.black.shape=}, expected planes"
            )

    @property
    def span(self) -> float:
        """Return the range from black to white, of the channel with the largest."""
        return self.white - float(self.black.min())


@dataclass(frozen=True, eq=False)
class Frames:
    """Hold what is known of the sensor besides. `dark`: (H, W) float32, what the shot would be without light, in the
    sensor's units; `flat`: (H, W) float32, what to multiply by for an even response, of mean 1 in each channel; `bad`:
    (N, 2) integers, row and column of bad pixels."""

    dark: NDArray[np.float32] | None = None
    flat: NDArray[np.float32] | None = None
    bad: NDArray[np.intp] | None = None


def calibrated(
    mosaic: Mosaic, frames: Frames, *, green_equilibrium: bool, out: NDArray[np.uint16] | None = None
) -> NDArray[np.uint16]:
    """Return (H, W) uint16, linear, 1 for no light and 65535 at saturation; written into `out` if given, which may be
    `mosaic.values`. Raises ValueError for frames of another size."""
    shape = mosaic.values.shape
    for name, frame in (("dark", frames.dark), ("flat", frames.flat)):
        if frame is not None and frame.shape != shape:
            raise ValueError(f"{name}: {frame.shape=}, expected {shape}")
    values = np.empty(shape, np.uint16) if out is None else out
    height = max(1, _STRIP // shape[1] // _CELLS) * _CELLS  # what stays in the cache is quick
    gains = np.full(mosaic.pattern.shape, FULL / mosaic.span, np.float32)
    if green_equilibrium:
        gains *= green_gains(mosaic, frames)
    gains = _repeated(gains, (height, shape[1]))
    dark = _repeated(mosaic.black, (height, shape[1])) if frames.dark is None else frames.dark
    marked = [] if frames.bad is None else [frames.bad]
    for top in range(0, shape[0], height):
        rows = slice(top, top + height)
        seen = mosaic.values[rows]
        if mosaic.black.min() >= _MARK_BELOW and not seen.all():  # the camera's own mark of a bad pixel is 0
            marked.append(np.argwhere(seen == 0) + np.array((top, 0)))
        linear = seen.astype(np.float32)
        linear -= dark[rows] if dark.shape == shape else dark[: len(seen)]
        linear *= gains[: len(seen)]
        if frames.flat is not None:
            linear *= frames.flat[rows]
        if seen.max() >= mosaic.white:  # saturated stays saturated, whatever black, gains and flat field say
            linear[seen >= mosaic.white] = FULL
        linear += 0.5
        values[rows] = np.clip(linear, _FLOOR, FULL, out=linear)
    if marked:
        repair(values, mosaic.pattern, np.concatenate(marked))
    return values


def _repeated(cell: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return a cell of a pattern over the strip that `shape` is, or one number where all are the same."""
    if (cell == cell.flat[0]).all():
        return np.full((1, 1), cell.flat[0], np.float32)
    if cell.shape[1] == shape[1]:
        return cell
    return np.ascontiguousarray(tiled(cell, shape))


def tiled(cell: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Return a cell repeated over a plane of this shape."""
    times = [-(-side // n) for side, n in zip(shape, cell.shape, strict=True)]
    return np.tile(cell, times)[: shape[0], : shape[1]]


def repair(values: NDArray[np.uint16], pattern: NDArray[np.uint8], bad: NDArray[np.intp]) -> None:
    """Give each bad pixel the median of the good ones of its colour around it, in place.

    values: (H, W) uint16. bad: (N, 2), row and column; those outside are passed over. A pixel with no good
    neighbour of its colour within four pixels stays as it is.
    """
    height, width = values.shape
    inside = (bad >= 0).all(axis=1) & (bad[:, 0] < height) & (bad[:, 1] < width)
    left = np.unique(bad[inside], axis=0)
    is_bad = np.zeros(values.shape, bool)
    is_bad[left[:, 0], left[:, 1]] = True
    for reach in (_REACH, 2 * _REACH):
        steps = np.array([(y, x) for y in range(-reach, reach + 1) for x in range(-reach, reach + 1)])
        rows, columns = (left[:, None, axis] + steps[:, axis] for axis in (0, 1))
        usable = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        rows, columns = rows.clip(0, height - 1), columns.clip(0, width - 1)
        n = pattern.shape[0]
        colour = pattern[rows % n, columns % n]
        usable &= (colour == pattern[left[:, 0] % n, left[:, 1] % n][:, None]) & ~is_bad[rows, columns]
        enough = usable.sum(axis=1) >= _FEWEST_NEIGHBOURS
        around = np.where(usable, values[rows, columns].astype(np.float32), np.float32(np.nan))[enough]
        if len(around):
            values[left[enough, 0], left[enough, 1]] = np.rint(np.nanmedian(around, axis=1))
        left = left[~enough]
        if not len(left):
            return


def green_gains(mosaic: Mosaic, frames: Frames) -> NDArray[np.float32]:
    """Return the factors, (n, n) float32, so that the two greens of a Bayer cell have one mean; 1 for the other
    colours and for any other pattern.

    Each of some second greens is compared with the four first ones around it, so that a slope of the light
    cancels. The ratio is the median over tiles, so that a fine pattern in a part of the picture is not taken for
    the sensor's, and counts if it is near 1.
    """
    gains = np.ones(mosaic.pattern.shape, np.float32)
    places = [np.argwhere(mosaic.pattern == g) for g in _GREENS]
    if mosaic.pattern.shape != (2, 2) or any(len(p) != 1 for p in places):
        return gains
    first_green, second_green = (tuple(p[0]) for p in places)
    step = 2 * max(1, min(mosaic.values.shape) // 1024)  # a quarter of a million cells are enough
    corner = (second_green[0] + 2, second_green[1] + 2)
    around = [_light(mosaic, frames, (corner[0] + y, corner[1] + x), step) for y in (-1, 1) for x in (-1, 1)]
    second = _light(mosaic, frames, corner, step)
    rows, columns = (min(part.shape[axis] for part in (*around, second)) for axis in (0, 1))
    first = np.mean([part[:rows, :columns] for part in around], axis=0)
    second = second[:rows, :columns]
    usable = np.maximum(first, second) < _CLIPPED * mosaic.span
    ratios = []
    for tile_rows in np.array_split(np.arange(rows), _TILES):
        for tile_columns in np.array_split(np.arange(columns), _TILES):
            tile = np.ix_(tile_rows, tile_columns)
            ok = usable[tile]
            if ok.any() and ok.mean() > 0.5 and first[tile][ok].sum() > 0:
                ratios.append(float(second[tile][ok].sum() / first[tile][ok].sum()))
    ratio = median(ratios) if ratios else 1.0
    if abs(ratio - 1) <= _MOST_UNEQUAL:
        gains[first_green], gains[second_green] = (1 + ratio) / 2, (1 + ratio) / (2 * ratio)
    return gains


def _light(mosaic: Mosaic, frames: Frames, corner: tuple[int, int], step: int) -> NDArray[np.float32]:
    """Return every `step`th pixel from `corner` on, above black, float32, in the sensor's units."""
    every = (slice(corner[0], None, step), slice(corner[1], None, step))
    dark = mosaic.black if frames.dark is None else frames.dark
    n = dark.shape[0]
    level = dark[every] if dark.shape == mosaic.values.shape else dark[corner[0] % n, corner[1] % n]
    light = mosaic.values[every] - level
    return np.asarray(light if frames.flat is None else light * frames.flat[every], np.float32)
