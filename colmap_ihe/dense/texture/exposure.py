"""Make photographs of different exposure and flare alike before a texture is made of them.

Each photograph gets a gain and an offset for each channel, by which its colours have the mean and the spread that the
median of all photographs has on the same faces. Offsets along seams (see `level`) then have less to do: they move
whole patches, and with photographs that differ they lead away from what any photograph shows.
"""

from __future__ import annotations

import numpy as np

from colmap_ihe.dense.camera import Float64, Int32, UInt8
from colmap_ihe.dense.texture.median import median_of_known

_LEAST_VIEWS = 3  # of a face, for a median that one photograph does not decide
_FACES = 30_000  # of those, evenly taken, are enough
_LEAST_FACES = 100  # of a photograph
_ROUNDS = 4
_MOST_GAIN = 2.0  # beyond, noise and clipped colours are all that it brings
_LEAST_SPREAD = 2.0  # levels


def exposure_tables(view: Int32, colour: UInt8, count: int) -> UInt8:
    """Return (`count`, 256, 3) uint8: for each of so many photographs the levels of R, G and B that make it like the
    others, its own where nothing tells.

    `view` (F, K) int32 are numbers of photographs, negative for none, `colour` (F, K, 3) uint8 what they show of it.
    """
    gain, offset = np.ones((count, 3)), np.zeros((count, 3))
    rows = np.flatnonzero((view >= 0).sum(axis=1) >= _LEAST_VIEWS)
    rows = rows[:: max(1, len(rows) // _FACES)]
    view, shown = view[rows], colour[rows].astype(np.float64)
    members = [np.nonzero(view == number) for number in range(count)]
    for _ in range(_ROUNDS if len(rows) else 0):
        alike = np.where((view >= 0)[..., None], gain[view] * shown + offset[view], np.nan)
        median = median_of_known(alike)
        for number, (face, column) in enumerate(members):
            if len(face) >= _LEAST_FACES:
                gain[number], offset[number] = _matched(shown[face, column], median[face])
    levels = np.arange(256)[:, None] * gain[:, None] + offset[:, None]
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)


def _matched(shown: Float64, wanted: Float64) -> tuple[Float64, Float64]:
    """Return gain and offset (3,) by which colours (N, 3) have the mean and spread of those that are `wanted`."""
    low, middle, high = np.percentile(shown, (16, 50, 84), axis=0)
    low_w, middle_w, high_w = np.percentile(wanted, (16, 50, 84), axis=0)
    gain = (high_w - low_w) / np.maximum(high - low, _LEAST_SPREAD)
    gain = np.clip(gain, 1 / _MOST_GAIN, _MOST_GAIN)
    return gain, middle_w - gain * middle


def with_table(colours: UInt8, table: UInt8) -> UInt8:
    """Return colours (..., 3) uint8 of one photograph by its `table` (256, 3)."""
    return np.stack([table[colours[..., channel], channel] for channel in range(3)], axis=-1)
