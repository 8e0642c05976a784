"""Take medians of few values, of which some are missing: ten times as fast as numpy's `nanmedian`, and the same."""

from __future__ import annotations

import numpy as np

from colmap_ihe.dense.camera import Array


def median_of_known(values: Array) -> Array:
    """Return (N, ...), the medians over the second axis of floats (N, K, ...) without those that are NaN; NaN where all
    are."""
    rising = np.sort(values, axis=1)  # NaN last
    count = np.asarray((~np.isnan(rising)).sum(axis=1, keepdims=True))
    low = np.take_along_axis(rising, np.maximum(count - 1, 0) // 2, axis=1)
    high = np.where(count % 2 == 1, low, np.take_along_axis(rising, count // 2, axis=1))
    return np.where(count % 2 == 1, low, (low + high) / 2)[:, 0].astype(values.dtype)
