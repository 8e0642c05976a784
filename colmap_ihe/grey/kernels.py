"""Call the compiled loops (kernels.c): colours counted, grey levels of what was counted, and bands of detail.

Loaded as a plain shared library: ctypes gives up the interpreter's lock for the time of a call, so threads
run side by side. Arrays are checked here, for C does not.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import CapabilityError
from colmap_ihe.grey.weights import LEVELS, Rules, Triplet

CELLS = 1 << 24
FULL = 65535
PACKED_BYTES = 14  # of a cell, at the most
_PACKED_AT_ONCE = 1 << 20
_RUN = 16  # places that kernels.c counts together
_SUMS = 8  # of a band, in a block or a tile

Band = NDArray[np.float32]
"""(10,): the taps of two Gaussians of 7, from the middle outwards, whose difference is a band of detail; then the
least and the greatest value, of a pixel's brightest channel, with which the pixel counts."""

BAND_REACH = 6
"""Pixels around one that its value in a band comes from."""


def _load() -> ctypes.CDLL:
    path = Path(__file__).with_name("libkernels.so")
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise CapabilityError(
            f"{path}: the compiled part of colmap-ihe cannot be loaded ({error})",
            hint="install colmap-ihe with pip, which builds it, as in `pip install .` in its clone",
        ) from error
    for name in ("occupied", "gather", "pack_cells", "pack_table"):
        getattr(library, name).restype = ctypes.c_size_t
    return library


C = _load()


def check(array: NDArray[np.generic], dtype: type[np.generic], shape: tuple[int, ...]) -> None:
    """Raise ValueError for an array of another dtype or shape, or one that is not C-contiguous."""
    if array.dtype != dtype or array.shape != shape or not array.flags.c_contiguous:
        raise ValueError(f"{array.shape=} {array.dtype=}, expected contiguous {shape} {np.dtype(dtype)}")


def at(array: NDArray[np.generic]) -> ctypes.c_void_p:
    """Return the address of an array, valid until the call is over."""
    return array.ctypes.data_as(ctypes.c_void_p)  # which keeps it alive


length = ctypes.c_size_t
"""A number of things, as C takes it."""


class Table:
    """Count how often each colour was counted, at its place (see `codes_at`): `low + FULL * high`, (2^24,) uint16 and
    uint32. `low` is 0 only where nothing was counted, and most pages of `high` are never touched."""

    def __init__(self) -> None:
        self.low = np.zeros(CELLS, np.uint16)
        self.high = np.zeros(CELLS, np.uint32)

    def at(self, place: NDArray[Any] | slice) -> NDArray[np.uint64]:
        """Return the counts at places (M,): (M,)."""
        return np.asarray(self.low[place] + FULL * self.high[place].astype(np.uint64))

    def clear(self, place: NDArray[Any]) -> None:
        """Set the counts at places (M,) to 0."""
        self.low[place] = self.high[place] = 0


def held(table: Table, *, emptied: bool = False) -> bytes:
    """Return what a table holds in few bytes, see `packed`; with `emptied` the table is empty then."""
    start, passed = ctypes.c_uint32(), ctypes.c_uint32()
    room = np.empty(_PACKED_AT_ONCE, np.uint8)
    into = (ctypes.c_int(emptied), ctypes.byref(start), ctypes.byref(passed), at(room), length(len(room)))
    of = (at(table.low), at(table.high), *into)
    parts = []
    while start.value < CELLS:
        parts.append(room[: C.pack_table(*of)].tobytes())
    return b"".join(parts)


def packed(place: NDArray[np.uint32], counts: NDArray[np.uint64]) -> bytes:
    """Pack places (M,) in ascending order and their counts (M,), below 2^63, in about two bytes each: how many places
    lie between, and the count, as whole numbers of seven bits a byte, the least first."""
    n = len(place)
    check(place, np.uint32, (n,))
    check(counts, np.uint64, (n,))
    room = np.empty(PACKED_BYTES * n, np.uint8)
    return room[: C.pack_cells(at(place), at(counts), length(n), at(room))].tobytes()


def check_packed(data: bytes, mass: int) -> None:
    """Raise ValueError for anything that `packed` could not have given of counts of `mass` in sum."""
    if not C.packed_is_sound(data, length(len(data)), ctypes.c_uint64(mass)):
        raise ValueError(f"its cells are not in order, or do not hold {mass} pixels")


def add_packed(data: bytes, mass: int, to: Table | NDArray[np.uint64]) -> None:
    """Add what `packed` or `held` gave, counts of `mass` in sum, to a table or to sums (2^24,). Raises ValueError,
    and adds nothing, for anything that they could not have given."""
    check_packed(data, mass)
    if isinstance(to, Table):
        C.add_packed(data, length(len(data)), at(to.low), at(to.high), None)
    else:
        check(to, np.uint64, (CELLS,))
        C.add_packed(data, length(len(data)), None, None, at(to))


def count_colours(rgb: NDArray[np.generic], table: Table, code: NDArray[np.uint8]) -> None:
    """Add the pixels of rgb, (..., 3) uint8, or uint16 of which `code` (65536,) gives the code of each value,
    to the table, at `place` of their codes."""
    pixels = np.ascontiguousarray(rgb)
    if pixels.dtype == np.uint8:
        C.count_colours_8(at(pixels), length(pixels.size // 3), at(table.low), at(table.high))
    elif pixels.dtype == np.uint16:
        check(code, np.uint8, (65536,))
        counts = (at(table.low), at(table.high))
        C.count_colours_16(at(pixels), length(pixels.size // 3), at(code), *counts)
    else:
        raise ValueError(f"{rgb.dtype=}, expected uint8 or uint16")


def codes_at(place: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return the codes (M, 3) counted at places (M,), which are ordered by R-G, B-G and G modulo 256: the colours of a
    photograph lie close together there."""
    green = place & 255
    return np.stack([(place >> 16) + green & 255, green, (place >> 8) + green & 255], axis=1).astype(np.uint8)


def occupied(low: NDArray[np.uint16]) -> NDArray[np.uint64]:
    """Return the keys of the places (2^24,) that are not 0, (M,), each with its place in the lower 24 bits; sorted so
    that cubes within cubes of RGB come together."""
    check(low, np.uint16, (CELLS,))
    keys = np.empty(C.occupied(at(low), None), np.uint64)
    C.occupied(at(low), at(keys))
    C.sort_places(at(keys), at(np.empty_like(keys)), length(len(keys)))
    return keys


def gather(
    keys: NDArray[np.uint64], masses: NDArray[np.uint64], bits: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint64]]:
    """Gather keys of `occupied` and their masses, (M,) each, in N cubes of 2^bits codes. Returns the least and greatest
    codes of each cube, planes (3, N), and its mass (N,)."""
    n = len(keys)
    check(keys, np.uint64, (n,))
    check(masses, np.uint64, (n,))
    low, high = np.empty((3, n), np.uint8), np.empty((3, n), np.uint8)
    mass = np.empty(n, np.uint64)
    outputs = (at(low), at(high), at(mass))
    cubes = C.gather(at(keys), length(n), at(masses), ctypes.c_uint32(bits), *outputs)
    return low[:, :cubes], high[:, :cubes], mass[:cubes]


def count_levels(
    counts: Table | NDArray[np.uint64], triplets: Sequence[Triplet], part: int = 0, parts: int = 1
) -> NDArray[np.uint64]:
    """Return the grey histograms (m, 256) of the colours in a table or in sums (2^24,), or in one of some even parts
    of it, for weights in hundredths: a colour has the grey `(i R + j G + k B + 50) // 100`. Quickest where
    neighbours in `triplets` are alike, most of all in blue."""
    start, end = (ctypes.c_uint32(CELLS // 16 * n // parts * 16) for n in (part, part + 1))
    if isinstance(counts, Table):
        masses: tuple[ctypes.c_void_p | None, ...] = (at(counts.low), at(counts.high), None)
    else:
        check(counts, np.uint64, (CELLS,))
        occupied_places = (counts > 0).astype(np.uint16)
        masses = (at(occupied_places), None, at(counts))
    weights = np.array([(red, blue) for red, _, blue in triplets], np.int16)
    out = np.zeros((len(weights), LEVELS + 2 * _RUN), np.uint64)
    C.count_levels(*masses, start, end, at(weights), length(len(weights)), at(out))
    return np.cumsum(out, axis=0, dtype=np.uint64)[:, _RUN:-_RUN]


def estimate_boxes(
    low: NDArray[np.float32], high: NDArray[np.float32], mass: NDArray[np.uint64], rules: Rules
) -> NDArray[np.float64]:
    """Return for each rule the sum of squared counts, (m,), with the mass of each box, (M,), spread evenly over the
    levels from its least to its greatest colour, planes (3, M)."""
    _check_boxes(low, mass, rules)
    check(high, np.float32, low.shape)
    squares, runs = np.empty(len(rules)), np.empty((LEVELS, LEVELS), np.uint64)
    boxes = (at(low), at(high), at(mass), length(len(mass)))
    C.estimate_boxes(*boxes, at(rules), length(len(rules)), at(runs), at(squares))
    return squares


def quantile_boxes(
    planes: NDArray[np.float32], mass: NDArray[np.uint64], rules: Rules, width: int, needed: int
) -> NDArray[np.uint32]:
    """Return for each rule the bin of `width`, a power of two, in which boxes (3, M) in the order of their weighted
    sums reach a mass of `needed`: (m,)."""
    _check_boxes(planes, mass, rules)
    most = (1 << 24) // width
    bins, out = np.empty(most, np.uint64), np.empty(len(rules), np.uint32)
    C.quantile_boxes(
        at(planes), at(mass), length(len(mass)), at(rules), length(len(rules)), ctypes.c_float(width),
        ctypes.c_uint64(needed), at(bins), ctypes.c_uint32(most), at(out),
    )  # fmt: skip
    return out


def count_pixels(rgb: NDArray[np.uint16], rules: Rules) -> NDArray[np.uint64]:
    """Return the grey histograms (m, 256) of the pixels of rgb, (..., 3) uint16."""
    check(rules, np.float32, (len(rules), 6))
    pixels = np.ascontiguousarray(rgb)
    check(pixels, np.uint16, pixels.shape)
    out = np.zeros((len(rules), LEVELS), np.uint64)
    C.count_pixels_16(at(pixels), length(pixels.size // 3), at(rules), length(len(rules)), at(out))
    return out


def weigh(rgb: NDArray[np.uint8], rule: Rules) -> NDArray[np.uint8]:
    """Return the levels of rgb, (H, W, 3) uint8, by one rule, (1, 6): (H, W) uint8."""
    check(rule, np.float32, (1, 6))
    pixels = np.ascontiguousarray(rgb)
    check(pixels, np.uint8, (*rgb.shape[:2], 3))
    out = np.empty(rgb.shape[:2], np.uint8)
    C.weigh_8(at(pixels), length(out.size), at(rule), at(out))
    return out


def _check_boxes(planes: NDArray[np.float32], mass: NDArray[np.uint64], rules: Rules) -> None:
    check(planes, np.float32, (3, len(mass)))
    check(mass, np.uint64, (len(mass),))
    check(rules, np.float32, (len(rules), 6))


def measure_detail(tile: NDArray[np.generic], band: Band) -> NDArray[np.float64]:
    """Return, of the band of a tile, (H, W, 3) uint8 or uint16, at half its size and of sums of 2x2 values, the sums
    of the products RR, GG, BB, RG, RB, GB, and how many pixels they are of: (7,). A pixel counts with all within 3 of
    it. `2 * BAND_REACH` pixels at each side of the tile are taken for their values alone."""
    out = np.zeros(_SUMS)
    _measure(C.measure_detail, tile, 2 * BAND_REACH, band, out)
    return out[:-1]


def measure_blocks(tile: NDArray[np.generic], band: Band) -> NDArray[np.float32]:
    """Return, of the band of a tile, (H, W, 3) uint8 or uint16, for each block of 8x8 pixels the sums of the products
    RR, GG, BB, RG, RB, GB, the sum of the values, and how many pixels count: (n, 8). `BAND_REACH` pixels at each side
    of the tile are taken for their values alone."""
    down, across = ((n - 2 * BAND_REACH) // 8 for n in tile.shape[:2])
    out = np.empty((down * across, _SUMS), np.float32)
    _measure(C.measure_blocks, tile, BAND_REACH, band, out)
    return out


def _measure(
    function: Callable[..., None], tile: NDArray[np.generic], reach: int, band: Band, out: NDArray[Any]
) -> None:
    height, width = tile.shape[:2]
    pixels = tile.dtype in (np.uint8, np.uint16) and tile.shape[2:] == (3,)
    if not pixels or min(height, width) < 2 * reach + 2:
        raise ValueError(f"{tile.shape=} {tile.dtype=}, expected at least {2 * reach + 2} pixels each way")
    check(band, np.float32, (10,))
    size = tile.itemsize
    if tile.strides[1:] != (3 * size, size) or tile.strides[0] < 0 or not tile.flags.aligned:
        tile = np.array(tile, order="C")
    scratch = np.empty((8, height, width), np.float32)
    sizes = (length(n) for n in (tile.strides[0], size == 2, height, width))
    function(at(tile), *sizes, at(band), at(scratch), at(out))
