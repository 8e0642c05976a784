"""The public names, as the README uses them."""

from __future__ import annotations

import numpy as np
import pytest

import colmap_ihe


def test_every_public_name_is_there() -> None:
    assert all(hasattr(colmap_ihe, name) for name in colmap_ihe.__all__)


def test_weights_of_arrays_are_those_of_their_histogram() -> None:
    """Green is flat from 0 to 255, red and blue are constant: the flattest grey is green's."""
    ramp = np.broadcast_to(np.arange(256, dtype=np.uint8), (16, 256))
    rgb = np.stack([np.full_like(ramp, 90), ramp, np.full_like(ramp, 160)], axis=2)
    weights = colmap_ihe.fit_weights([rgb, rgb[::-1].copy()])
    assert (weights.triplet, weights.tones, weights.images) == ((0.0, 1.0, 0.0), 256, 2)
    assert weights.score == pytest.approx(0.0, abs=1e-15)
    assert np.array_equal(colmap_ihe.to_grey(rgb, weights), ramp)


def test_linear_arrays_are_scaled_by_their_own_white_point() -> None:
    """A channel of a quarter of the response, but flat, is not judged for being dark."""
    ramp = np.broadcast_to(np.linspace(0, 16000, 4096).astype(np.uint16), (16, 4096))
    bright = np.where(ramp > 8000, 60000, 50000).astype(np.uint16)
    weights = colmap_ihe.fit_weights([np.stack([bright, ramp, bright], axis=2)])
    assert weights.encoding == "linear"
    assert weights.triplet == (0.0, 1.0, 0.0)
    assert 0.9 * 16000 / 65535 < weights.white < 1.1 * 16000 / 65535


@pytest.mark.parametrize("images", [[], [np.zeros((4, 4), np.uint8)], [np.zeros((4, 4, 3), np.float32)]])
def test_other_arrays_are_refused(images: list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]) -> None:
    with pytest.raises(ValueError, match="expected"):
        colmap_ihe.fit_weights(images)
