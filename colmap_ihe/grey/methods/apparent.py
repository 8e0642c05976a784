"""Convert to lightness as it appears, with contrast given back where colour had more of it (apparent greyscale).

After Smith, Landes, Thollot and Myszkowski, "Apparent greyscale: a simple and fast conversion to
perceptually accurate images and video", Eurographics 2008. First a fixed function of the colour: L* with the
Helmholtz-Kohlrausch effect (Nayatani 1997, his VCC method: by VAC the brightest colours end above white), as
the package colour-science computes it. Then chromatic unsharp masking: each band of a Laplacian
pyramid is raised by how much the colour contrast in it exceeds the grey contrast.

Local: a pixel's grey depends on its neighbours, so the same colour is not the same grey.
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from colmap_ihe.errors import CapabilityError
from colmap_ihe.grey import srgb
from colmap_ihe.grey.srgb import WHITE, XYZ_FROM_RGB, Float32, bands, checked, grey_of_lightness, lightness

LEVELS = 4
GAIN = 0.5
"""k of the formula, one for every band: the share of the contrast that is given back."""

POWER = 0.5
"""p of the formula: below 1 weak contrasts are raised more than strong ones."""

ADAPTING = 20.0
"""Luminance in cd/m2 that the eye is adapted to."""

_STEP = 0.0005
_WIDEST = 1 << 14
_LEFT, _RIGHT, _BELOW, _ABOVE = 160, 540, 640, 200  # nodes around white that take in all of sRGB


def apparent(rgb: Float32) -> Float32:
    """Return the grey of one photograph. Where nothing is near, R = G = B = v gives v; beside an edge it does not.

    rgb: (H, W, 3) float32 in [0, 1], coded. Returns (H, W) float32 in [0, 1]. Takes about 45 bytes a pixel
    beside them, 1 GB for 24 megapixels. Raises ValueError for another shape or dtype, `CapabilityError`
    where colour-science is not installed.
    """
    seen = apparent_lightness(checked(rgb))
    star, red, yellow = (np.empty(rgb.shape[:2], np.float32) for _ in range(3))
    for rows in bands(rgb):
        star[rows], red[rows], yellow[rows] = np.moveaxis(srgb.lab(rgb[rows]), -1, 0)
    sharpened = _unsharp(seen, [star, red, yellow])
    for rows in bands(rgb):
        sharpened[rows] = grey_of_lightness(sharpened[rows])
    return sharpened


def apparent_lightness(rgb: Float32) -> Float32:
    """Return L* raised by the Helmholtz-Kohlrausch effect, the global half of the method: 0 to 100.

    rgb: (H, W, 3) float32 in [0, 1], coded. Returns (H, W) float32. The effect is read from a table by u'
    and v', 0.0005 apart, which is off by less than 0.02 of L* (a test compares it with the package).
    """
    table = _effect()
    matrix = XYZ_FROM_RGB.T.astype(np.float32)
    u_white, v_white = chromaticity_of_white()
    seen = np.empty(rgb.shape[:2], np.float32)
    for rows in bands(rgb):
        x, y, z = np.moveaxis(srgb.linear(rgb[rows]) @ matrix, -1, 0)
        total = np.maximum(x + 15 * y + 3 * z, np.float32(1e-9))  # black has no hue, and L* = 0
        column = (4 * x / total - np.float32(u_white)) / np.float32(_STEP) + _LEFT
        row = (9 * y / total - np.float32(v_white)) / np.float32(_STEP) + _BELOW
        seen[rows] = lightness(y) * _interpolated(table, column, row)
    return seen


def chromaticity_of_white() -> tuple[float, float]:
    """Return u' and v' of D65."""
    x, y, z = (float(w) for w in WHITE)
    return 4 * x / (x + 15 * y + 3 * z), 9 * y / (x + 15 * y + 3 * z)


@lru_cache(maxsize=1)
def _effect() -> Float32:
    """Return by how much lightness appears raised, on the lattice of v' (rows) and u' (columns)."""
    try:
        with warnings.catch_warnings():  # it warns of packages for plots, which we do not make
            warnings.simplefilter("ignore")
            import colour
    except ImportError as error:
        raise CapabilityError(
            "the conversion `apparent` needs the package colour-science, which is not installed",
            hint="in the clone of colmap-ihe: pip install '.[conversions]'",
        ) from error
    white = np.array(chromaticity_of_white())
    v, u = np.mgrid[-_BELOW : _ABOVE + 1, -_LEFT : _RIGHT + 1] * _STEP
    effect: Any = colour.HelmholtzKohlrausch_effect_object_Nayatani1997(
        np.stack([u, v], axis=-1) + white, white, ADAPTING, method="VCC"
    )
    return np.asarray(effect, np.float32)


def _interpolated(table: Float32, column: Float32, row: Float32) -> Float32:
    """Interpolate table at (row, column), both (h, w); in pieces, for cv2.remap takes no more than 32766 columns."""
    found = np.empty_like(column)
    for left in range(0, column.shape[1], _WIDEST):
        part = slice(left, left + _WIDEST)
        found[:, part] = cv2.remap(
            table, column[:, part], row[:, part], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return found


def _unsharp(grey: Float32, colour_planes: list[Float32]) -> Float32:
    """Return grey + sum over bands of k (dE / |h|)^p h, with h the band of grey and dE that of colour.

    Written as k dE^p |h|^(1-p) sign(h), which has no division.
    """
    planes = [grey, *colour_planes]
    raised = []
    for _ in range(LEVELS):
        smaller, band, squared = [], grey, np.zeros(planes[0].shape, np.float32)
        for number, plane in enumerate(planes):
            down: Any = cv2.pyrDown(plane)
            detail = plane - _up(down, plane.shape)
            if number:
                squared += detail * detail
            else:
                band = detail
            smaller.append(down)
        strength = squared ** np.float32(POWER / 2) * np.abs(band) ** np.float32(1 - POWER)
        raised.append(np.asarray(np.float32(GAIN) * np.sign(band) * strength, np.float32))
        planes = smaller
    total = raised.pop()
    while raised:
        finer = raised.pop()
        total = finer + _up(total, finer.shape)
    return grey + total


def _up(plane: Float32, shape: tuple[int, ...]) -> Float32:
    return np.asarray(cv2.pyrUp(plane, dstsize=(shape[1], shape[0])), np.float32)
