"""Whole numbers come back as they were packed."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from colmap_ihe.report.packed import packed


def unpacked(stored: dict[str, Any]) -> NDArray[np.int64]:
    """Return (N, K) int64: what `packed` was given."""
    content = zlib.decompress(base64.b64decode(stored["data"]))
    planes = np.frombuffer(content, np.uint8).reshape(stored["bytes"], stored["width"], -1).astype(np.int64)
    unsigned = sum(plane << (8 * n) for n, plane in enumerate(planes))
    differences = np.where(unsigned & 1, -(unsigned + 1) // 2, unsigned // 2)
    return np.asarray(np.cumsum(differences.T, axis=0))


@pytest.mark.parametrize(
    ("values", "size"),
    [
        (np.array([[0, 5], [-3, 65535], [7, 0]]), 3), (np.array([5, 5, 6, 4]), 1), (np.zeros((0, 3), int), 1),
        (np.array([2**30 - 1, 0, 2**30 - 1]), 4), (np.array([[-127, 127, 1]] * 9), 1),
    ],
)  # fmt: skip
def test_they_come_back(values: NDArray[np.int64], size: int) -> None:
    stored = packed(values)
    assert (stored["bytes"], stored["width"]) == (size, values.shape[1] if values.ndim > 1 else 1)
    assert np.array_equal(unpacked(stored), values if values.ndim > 1 else values[:, None])


def test_neighbours_that_differ_little_take_little() -> None:
    smooth = np.arange(90_000).reshape(-1, 3) // 2
    assert len(packed(smooth)["data"]) < smooth.size / 20
