"""Medians of a few values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from colmap_ihe.dense.texture.median import median_of_known


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("columns", [1, 2, 5, 12])
@pytest.mark.filterwarnings("ignore:All-NaN")
def test_medians_are_those_of_numpy(dtype: type[np.floating[Any]], columns: int) -> None:
    draw = np.random.default_rng(columns)
    values = draw.normal(100, 60, (500, columns, 3)).astype(dtype)
    values[draw.random(values.shape) < 0.5] = np.nan
    values[0] = np.nan
    median = median_of_known(values)
    assert median.dtype == dtype
    assert np.isnan(median).any()
    np.testing.assert_array_equal(median, np.nanmedian(values, axis=1))
