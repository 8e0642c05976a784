"""Take medians of few values, of which some are missing: ten times as fast as numpy's `nanmedian`, and the same."""

from __future__ import annotations

import numpy as np

from colmap_ihe.dense.camera import Array


def median_of_known(values: Array) -> Array:
    """Return (N, ...), the medians over the second axis of floats (N, K, ...) without those that are NaN; NaN where all
    are."""
    rising = np.sort(values, axis=1)  # NaN last
    count = np.asarray((~np.isnan(rising)).sum(axis=1, keepdims=True))
    low, high = (
        np.take_along_axis(rising, row, axis=1) for row in (np.maximum(count - 1, 0) // 2, count // 2)
    )
    none_between = np.asarray(count % 2 == 1)
    return np.where(none_between, low, (low + np.where(none_between, low, high)) / 2)[:, 0].astype(
        values.dtype
    )
