"""Draw a model small, for a list of several: its mesh or its points, lit, from the front and a little aside."""

from __future__ import annotations

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from colmap_ihe.report.contents import Cloud, Surface

U8 = NDArray[np.uint8]
_F64 = NDArray[np.float64]

_ASIDE, _ABOVE = 0.35, 0.25  # radians that the eye is moved by, as the viewer begins
_EDGE = 0.04  # of the picture, free
_INNER, _MOST = (
    10.0,
    1.0,
)  # percent of the points at each end of an axis: the heart of the model, and all of it
_BESIDE = 0.2  # of the extent of the heart: how far beside it the picture reaches, if there is anything
_TRIANGLES = 150_000  # that are drawn, of more evenly spread
_COVER = 3  # times the picture, in all: points are unevenly spread
_GAP = 5  # pixels between points: a narrower gap is filled
_LARGEST = 7  # pixels of a point, which stands for what lies between few of them
_PAPER = 243  # level of the ground
_LIGHT = np.array([0.35, 0.55, 0.76])


def model_picture(surface: Surface | None, cloud: Cloud, width: int, height: int) -> U8:
    """Return (height, width, 3) uint8 sRGB of a surface, or of the cloud where there is none."""
    if surface is not None and len(surface.faces):
        places, colours, normals = _of_surface(surface)
        shade = 0.6 + 0.45 * np.abs(_turned(normals) @ _LIGHT)
        colours = colours * shade[:, None]
    else:
        kept = np.isfinite(cloud.positions).all(axis=1)
        places, colours = cloud.positions[kept].astype(np.float64), cloud.colours[kept].astype(np.float64)
    return _splatted(_turned(places), colours, width, height)


def _of_surface(surface: Surface) -> tuple[_F64, _F64, _F64]:
    """Return middles of triangles, (F, 3), with their colours and normals."""
    faces = surface.faces[:: -(-len(surface.faces) // _TRIANGLES)]
    places = surface.positions[faces].mean(axis=1).astype(np.float64)
    normals = surface.normals[faces].mean(axis=1).astype(np.float64)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-9)[:, None]
    if surface.texture is not None and surface.uv is not None:
        texture = simplejpeg.decode_jpeg(surface.texture.jpeg)
        sides = np.array(texture.shape[1::-1])
        column, row = np.clip(surface.uv[faces].mean(axis=1) * sides, 0, sides - 1).astype(np.intp).T
        return places, texture[row, column].astype(np.float64), normals
    assert surface.colours is not None
    return places, surface.colours[faces].mean(axis=1), normals


def _turned(points: NDArray[np.floating]) -> _F64:
    """Return (N, 3): to the right, upwards and towards an eye that looks from a little aside and above."""
    cos_a, sin_a, cos_b, sin_b = np.cos(_ASIDE), np.sin(_ASIDE), np.cos(_ABOVE), np.sin(_ABOVE)
    x, y, z = np.asarray(points, np.float64).T
    back = x * sin_a + z * cos_a
    return np.stack([x * cos_a - z * sin_a, y * cos_b - back * sin_b, y * sin_b + back * cos_b], axis=1)


def _splatted(places: _F64, colours: _F64, width: int, height: int) -> U8:
    """Return a picture of points, nearest in front, each as large as the gaps between them."""
    drawn = np.full((height, width, 3), _PAPER, np.uint8)
    if not len(places):
        return drawn
    least, low, high, most = np.percentile(places[:, :2], (_MOST, _INNER, 100 - _INNER, 100 - _MOST), axis=0)
    beside = _BESIDE * (high - low)
    low, high = np.maximum(least, low - beside), np.minimum(most, high + beside)
    extent = np.maximum(high - low, 1e-9)
    room = np.array([width, height]) * (1 - 2 * _EDGE)
    scale = float((room / extent).min())
    at = (places[:, :2] - (low + high) / 2) * scale * (1, -1) + np.array([width, height]) / 2
    size = int(np.clip(np.ceil((_COVER * scale**2 * extent.prod() / len(places)) ** 0.5), 1, _LARGEST))
    order = np.argsort(places[:, 2], kind="stable")
    tones = np.clip(colours[order], 0, 255).astype(np.uint8)
    for right in range(size):
        for down in range(size):
            column, row = np.floor(at[order] + (right, down)).astype(np.intp).T - size // 2
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            drawn[row[inside], column[inside]] = tones[inside]
    return _closed(drawn)


def _closed(drawn: U8) -> U8:
    """Return a picture with its narrow gaps filled from what is beside them."""
    filled = (drawn != _PAPER).any(axis=2).astype(np.uint8)
    gaps = cv2.morphologyEx(filled, cv2.MORPH_CLOSE, np.ones((_GAP, _GAP), np.uint8)) - filled
    return np.asarray(cv2.medianBlur(cv2.inpaint(drawn, gaps, 2, cv2.INPAINT_TELEA), 3), np.uint8)
