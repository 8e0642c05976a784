"""Find greys whose differences come as near as can be to signed differences in colour (Color2Gray).

After Gooch, Olsen, Tumblin and Gooch, "Color2Gray: salience-preserving color removal", SIGGRAPH 2005, with
every pixel compared with every other. Two colours are to differ by their lightness, or, where chrominance
differs more, by that: compressed to `ALPHA` at most, and brighter towards the hue `THETA`.

Over all pairs the least squares have a closed form: the grey of a colour is the mean of its target
differences from all pixels, plus the mean lightness. That is a function of the colour, smooth but for a step
where hues turn, and depends on the other pixels only through how many have which colour. So colours are
pooled in 16 steps a channel, the function is computed on a lattice of 33 steps a channel, and pixels are
interpolated in it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.srgb import Float32, bands, checked, grey_of_lightness, lab

ALPHA = 10.0
"""The most, in units of CIELAB, by which chrominance alone may set two greys apart."""

THETA = math.pi / 4
"""The hue angle in CIELAB that turns brighter; its opposite turns darker."""

_STEPS = 16
_LATTICE = 32
_SIDE = _LATTICE + 1
_CHUNK = 1 << 19


def color2gray(rgb: Float32, alpha: float = ALPHA, theta: float = THETA) -> Float32:
    """Return the grey of one photograph. Which hues turn bright is up to `theta` (radians): no value suits all.

    rgb: (H, W, 3) float32 in [0, 1], coded. Returns (H, W) float32 in [0, 1]. Colours are pooled and
    interpolated as said above; a test bounds what that costs. Raises ValueError for another shape or dtype.
    """
    colours, mass = _pooled(checked(rgb))
    nodes = np.flatnonzero(_needed(rgb))
    axis = np.arange(_SIDE, dtype=np.float32) / np.float32(_LATTICE)
    node_rgb = axis[np.stack(np.unravel_index(nodes, (_SIDE, _SIDE, _SIDE)), axis=1)]
    table = np.zeros(_SIDE**3, np.float32)
    table[nodes] = _solved(lab(node_rgb), lab(colours), mass, alpha, theta)
    grey = np.empty(rgb.shape[:2], np.float32)
    for rows in bands(rgb):
        grey[rows] = grey_of_lightness(_interpolated(table, rgb[rows]))
    return grey


def target(first: Float32, second: Float32, alpha: float, theta: float) -> Float32:
    """Return (n, m): by how much `first` (n, 3) is to be brighter than `second` (m, 3), L*a*b* and L*."""
    lightness, red, yellow = (first[:, None, c] - second[None, :, c] for c in range(3))
    crunched = np.float32(alpha) * np.tanh(np.hypot(red, yellow) / np.float32(alpha))
    turn = np.sign(np.float32(math.cos(theta)) * red + np.float32(math.sin(theta)) * yellow)
    return np.where(np.abs(lightness) > crunched, lightness, turn * crunched)


def _solved(
    nodes: Float32, colours: Float32, mass: NDArray[np.float64], alpha: float, theta: float
) -> Float32:
    """Return L* of the grey (n,) of `nodes` (n, 3), in a photograph of `colours` (m, 3) by `mass` (m,)."""
    share = mass / mass.sum()
    chunk = max(1, _CHUNK // len(colours))
    means = [
        target(nodes[start : start + chunk], colours, alpha, theta) @ share
        for start in range(0, len(nodes), chunk)
    ]
    return np.asarray(np.concatenate(means) + colours[:, 0] @ share, np.float32)


def _pooled(rgb: Float32) -> tuple[Float32, NDArray[np.float64]]:
    """Return mean colour (m, 3) and number of pixels (m,) of each occupied cell of 16 steps a channel."""
    cells = _STEPS**3
    mass, sums = np.zeros(cells), np.zeros((3, cells))
    for rows in bands(rgb):
        flat = np.clip(rgb[rows].reshape(-1, 3), 0, 1)
        code = np.minimum((flat * _STEPS).astype(np.int64), _STEPS - 1)
        index = (code[:, 0] * _STEPS + code[:, 1]) * _STEPS + code[:, 2]
        mass += np.bincount(index, minlength=cells)
        for c in range(3):
            sums[c] += np.bincount(index, weights=flat[:, c], minlength=cells)
    used = mass > 0
    return (sums[:, used] / mass[used]).T.astype(np.float32), mass[used]


def _needed(rgb: Float32) -> NDArray[np.bool_]:
    """Return (33, 33, 33): the nodes of the lattice at the corners of a cell that holds a pixel."""
    cells = np.zeros((_LATTICE, _LATTICE, _LATTICE), bool)
    for rows in bands(rgb):
        code, _ = _place(rgb[rows])
        cells[code[..., 0], code[..., 1], code[..., 2]] = True
    nodes = np.zeros((_SIDE, _SIDE, _SIDE), bool)
    for corner in np.ndindex(2, 2, 2):
        nodes[tuple(slice(c, c + _LATTICE) for c in corner)] |= cells
    return nodes


def _place(rgb: Float32) -> tuple[NDArray[np.int32], Float32]:
    """Return the cell of the lattice that each colour lies in, and where in it (0 to 1), both like rgb."""
    scaled = np.clip(rgb, 0, 1) * np.float32(_LATTICE)
    code = np.minimum(scaled.astype(np.int32), _LATTICE - 1)
    return code, scaled - code.astype(np.float32)


def _interpolated(table: Float32, rgb: Float32) -> Float32:
    """Interpolate table (33^3,) trilinearly at rgb (..., 3)."""
    code, within = _place(rgb)
    index = (code[..., 0] * _SIDE + code[..., 1]) * _SIDE + code[..., 2]
    edges = [(np.float32(1) - within[..., c], within[..., c]) for c in range(3)]
    total = np.zeros(rgb.shape[:-1], np.float32)
    for r, g, b in np.ndindex(2, 2, 2):
        total += edges[0][r] * edges[1][g] * edges[2][b] * table[index + (r * _SIDE + g) * _SIDE + b]
    return total
