"""Contrast preserving decolorization is OpenCV's, with channels in OpenCV's order and its failures named."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from oracle import scene

from colmap_ihe.errors import CapabilityError, PhotographError
from colmap_ihe.grey.methods.contrast_preserving import contrast_preserving


def test_it_is_what_opencv_gives_for_the_photograph_as_it_reads_it() -> None:
    image = scene(1, 80, 100)
    # A PPM stores red, green, blue; OpenCV's reader knows its own order.
    read: Any = cv2.imdecode(np.frombuffer(b"P6 100 80 255\n" + image.tobytes(), np.uint8), cv2.IMREAD_COLOR)
    expected = cv2.decolor(read)[0]
    grey = contrast_preserving(image.astype(np.float32) / np.float32(255))
    np.testing.assert_array_equal(np.rint(grey * 255), expected)
    assert len(np.unique(expected)) > 50


def test_an_answer_that_is_black_all_over_is_refused() -> None:
    image = np.zeros((64, 64, 3), np.float32)
    image[:, 32:] = (0.8, 0, 0)
    with pytest.raises(PhotographError, match="found no grey") as caught:
        contrast_preserving(image)
    assert "realtime" in caught.value.hint


def test_an_opencv_without_decolor_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, "decolor")
    with pytest.raises(CapabilityError, match="no `decolor`"):
        contrast_preserving(np.zeros((8, 8, 3), np.float32))
