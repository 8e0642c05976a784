"""The compiled inner loops of the grey room (kernels.c), each on NumPy arrays.

Loaded as a plain shared library: ctypes gives up the interpreter's lock for the time of a call, so threads
run side by side. Arrays are checked here, for C does not.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import CapabilityError

LEVELS = 256
Rules = NDArray[np.float32]
"""(m, 6): red, green, blue, fine, scale, offset; the level of a colour is `floor(floor(fine (red R + green G +
blue B)) scale + offset)`, at most 255. See `coded_rules` and `linear_rules`."""

Gathered = tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint64]]
"""Least and greatest codes of M boxes, planes (3, M), and their mass, (M,)."""

_FINE = 4


def _load() -> ctypes.CDLL:
    path = Path(__file__).with_name("libkernels.so")
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise CapabilityError(
            f"{path}: the compiled part of colmap-ihe cannot be loaded ({error})",
            hint="install colmap-ihe with pip, which builds it, as in `pip install .`",
        ) from error
    for name in ("occupied", "gather"):
        getattr(library, name).restype = ctypes.c_size_t
    return library


_C = _load()


def coded_rules(triplets: Sequence[tuple[int, int, int]]) -> Rules:
    """Levels of gamma-coded values for weights in hundredths: `(i R + j G + k B + 50) // 100`, exactly."""
    rules = np.empty((len(triplets), 6), np.float32)
    rules[:, :3] = triplets
    rules[:, 3:] = (1, 0.01, 0.505)  # 0.005 from every integer at least, and float32 errs by 0.00003
    return rules


def parts_rule(numerators: NDArray[np.float64], parts: int) -> Rules | None:
    """The nearest level, halves up, of weights that are whole numbers of `parts`; None if they are not whole."""
    whole = np.rint(numerators)
    if np.abs(numerators - whole).max() > 1e-6:
        return None
    offset = 0.5 + (0.5 / parts if parts % 2 == 0 else 0)  # 0.5 / parts from every integer at least
    return np.array([[*whole, 1, 1 / parts, offset]], np.float32)


def linear_rules(triplets: Sequence[tuple[int, int, int]], whites: Sequence[int]) -> Rules:
    """Levels of linear values: `(i R + j G + k B) * 256 // white`, exactly. `whites` are multiples of 1024."""
    step = np.asarray(whites, np.float64) / LEVELS / _FINE
    if (step % 1 != 0).any() or (step < 1).any():
        raise ValueError(f"{whites=}, expected multiples of {LEVELS * _FINE}")
    rules = np.empty((len(triplets), 6), np.float32)
    rules[:, :3] = triplets
    rules[:, 3] = 1 / _FINE
    rules[:, 4] = 1 / step
    rules[:, 5] = 0.5 / step  # 0.00008 from every integer at least, and float32 errs by 0.00003
    return rules


def count_colours(rgb: NDArray[np.generic], counts: NDArray[np.uint32], code: NDArray[np.uint8]) -> None:
    """Adds the pixels of rgb, (..., 3) uint8, or uint16 of which `code` (65536,) gives the code of each value,
    to the table `counts` (2^24,), at `place` of their codes."""
    pixels = np.ascontiguousarray(rgb)
    _check(counts, np.uint32, (1 << 24,))
    if pixels.dtype == np.uint8:
        _C.count_colours_8(_at(pixels), _size(pixels.size // 3), _at(counts))
    elif pixels.dtype == np.uint16:
        _check(code, np.uint8, (65536,))
        _C.count_colours_16(_at(pixels), _size(pixels.size // 3), _at(code), _at(counts))
    else:
        raise ValueError(f"{rgb.dtype=}, expected uint8 or uint16")


def place_of(codes: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Where a table of `count_colours` counts the codes (..., 3): ordered by R-G, B-G and G modulo 256, for the
    colours of a photograph lie close together there."""
    red, green, blue = (codes[..., c].astype(np.int64) for c in range(3))
    return np.asarray((red - green & 255) << 16 | (blue - green & 255) << 8 | green)


def codes_at(place: NDArray[np.int64]) -> NDArray[np.uint8]:
    """The codes (M, 3) counted at places (M,)."""
    green = place & 255
    return np.stack([(place >> 16) + green & 255, green, (place >> 8) + green & 255], axis=1).astype(np.uint8)


def occupied(counts: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """Keys of the occupied places of a table (2^24,), (M,), each with its place in the lower 24 bits; sorted so
    that cubes within cubes of RGB come together."""
    _check(counts, np.uint32, (1 << 24,))
    keys = np.empty(_C.occupied(_at(counts), None), np.uint64)
    _C.occupied(_at(counts), _at(keys))
    _C.sort_places(_at(keys), _at(np.empty_like(keys)), _size(len(keys)))
    return keys


def gather(
    keys: NDArray[np.uint64], masses: NDArray[np.uint64], bits: int, heavy: int
) -> tuple[Gathered, Gathered]:
    """Keys of `occupied` and their masses, (M,) each: those heavier than `heavy`, and the others in cubes of
    2^bits codes."""
    n = len(keys)
    _check(keys, np.uint64, (n,))
    _check(masses, np.uint64, (n,))
    low, high = np.empty((3, n), np.uint8), np.empty((3, n), np.uint8)
    mass = np.empty(n, np.uint64)
    cubes = ctypes.c_size_t()
    places = (_at(low), _at(high), _at(mass), ctypes.byref(cubes))
    m = _C.gather(_at(keys), _size(n), _at(masses), ctypes.c_uint32(bits), ctypes.c_uint64(heavy), *places)
    alone, together = slice(0, m), slice(n - cubes.value, n)
    return (low[:, alone], high[:, alone], mass[alone]), (low[:, together], high[:, together], mass[together])


def count_boxes(planes: NDArray[np.float32], mass: NDArray[np.uint64], rules: Rules) -> NDArray[np.uint64]:
    """Grey histograms (m, 256) of boxes of one colour each: planes (3, M), mass (M,)."""
    _check_boxes(planes, mass, rules)
    out = np.zeros((len(rules), LEVELS), np.uint64)
    _C.count_boxes(_at(planes), _at(mass), _size(len(mass)), _at(rules), _size(len(rules)), _at(out))
    return out


def bound_boxes(
    low: NDArray[np.float32],
    high: NDArray[np.float32],
    mass: NDArray[np.uint64],
    rules: Rules,
    known: NDArray[np.uint64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """For each rule a lower bound of Q, the sum of squared counts, over all ways in which the pixels of each
    box may fall in the run of levels that it reaches, and Q for an even spread: (m,) each. `known` are counts
    (m, 256) to which those of the boxes are added.

    For any prices p of the levels, Q = sum n^2 >= sum (2 p n - p^2), and the sum of n p is at least each box's
    mass times the least price in its run. With the even spread for prices the bound is close.
    """
    _check_boxes(low, mass, rules)
    _check(high, np.float32, low.shape)
    _check(known, np.uint64, (len(rules), LEVELS))
    bound, even = np.empty(len(rules)), np.empty(len(rules))
    runs = np.empty((LEVELS, LEVELS), np.uint64)
    boxes = (_at(low), _at(high), _at(mass), _size(len(mass)))
    out = (_at(runs), _at(bound), _at(even))
    _C.bound_boxes(*boxes, _at(rules), _size(len(rules)), _at(known), *out)
    return bound, even


def quantile_boxes(
    planes: NDArray[np.float32], mass: NDArray[np.uint64], rules: Rules, width: int, needed: int
) -> NDArray[np.uint32]:
    """For each rule the bin of `width`, a power of two, in which boxes (3, M) in the order of their weighted
    sums reach a mass of `needed`: (m,)."""
    _check_boxes(planes, mass, rules)
    most = (1 << 24) // width
    bins, out = np.empty(most, np.uint64), np.empty(len(rules), np.uint32)
    _C.quantile_boxes(
        _at(planes), _at(mass), _size(len(mass)), _at(rules), _size(len(rules)), ctypes.c_float(width),
        ctypes.c_uint64(needed), _at(bins), ctypes.c_uint32(most), _at(out),
    )  # fmt: skip
    return out


def count_pixels(rgb: NDArray[np.uint16], rules: Rules) -> NDArray[np.uint64]:
    """Grey histograms (m, 256) of the pixels of rgb, (..., 3) uint16."""
    _check(rules, np.float32, (len(rules), 6))
    pixels = np.ascontiguousarray(rgb)
    _check(pixels, np.uint16, pixels.shape)
    out = np.zeros((len(rules), LEVELS), np.uint64)
    _C.count_pixels_16(_at(pixels), _size(pixels.size // 3), _at(rules), _size(len(rules)), _at(out))
    return out


def weigh(rgb: NDArray[np.uint8], rule: Rules) -> NDArray[np.uint8]:
    """Levels of rgb, (H, W, 3) uint8, by one rule, (1, 6): (H, W) uint8."""
    _check(rule, np.float32, (1, 6))
    pixels = np.ascontiguousarray(rgb)
    _check(pixels, np.uint8, (*rgb.shape[:2], 3))
    out = np.empty(rgb.shape[:2], np.uint8)
    _C.weigh_8(_at(pixels), _size(out.size), _at(rule), _at(out))
    return out


def _check_boxes(planes: NDArray[np.float32], mass: NDArray[np.uint64], rules: Rules) -> None:
    _check(planes, np.float32, (3, len(mass)))
    _check(mass, np.uint64, (len(mass),))
    _check(rules, np.float32, (len(rules), 6))


def _check(array: NDArray[np.generic], dtype: type[np.generic], shape: tuple[int, ...]) -> None:
    if array.dtype != dtype or array.shape != shape or not array.flags.c_contiguous:
        raise ValueError(f"{array.shape=} {array.dtype=}, expected contiguous {shape} {np.dtype(dtype)}")


def _at(array: NDArray[np.generic]) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)  # which keeps the array alive for the call


def _size(n: int) -> ctypes.c_size_t:
    return ctypes.c_size_t(n)
