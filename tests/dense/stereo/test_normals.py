"""Normals of exact depth beside edges."""

from __future__ import annotations

import numpy as np
from planes import REFERENCE_SIZE, camera

from colmap_ihe.dense.camera import Float32
from colmap_ihe.dense.stereo.normals import normals_from_inverse_depth

K = camera([0, 0, 0]).K
WIDTH, HEIGHT = REFERENCE_SIZE


def _degrees(normals: Float32, expected: list[float]) -> Float32:
    cosines = normals.astype(float) @ (np.array(expected) / np.linalg.norm(expected))
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1, 1))), np.float32)


def test_normals_do_not_see_across_a_step() -> None:
    """A slanted plane, z = 4 + 0.5 x, and from column 200 on another, 10 % farther away."""
    x = (np.arange(WIDTH) + 0.5 - K[0, 2]) / K[0, 0]
    inverse = np.tile(((1 - 0.5 * x) / 4).astype(np.float32), (HEIGHT, 1))
    inverse[:, 200:] /= np.float32(1.1)
    angles = _degrees(normals_from_inverse_depth(inverse, K, 8), [0.5, 0, -1])
    assert angles[:, 190:210].max() < 0.5
    assert np.median(angles) < 0.1


def test_normals_of_a_corner_are_those_of_its_sides() -> None:
    """Two walls that meet at column 200, z = 4 + |x|: right up to 2 pixels from there."""
    x = (np.arange(WIDTH) + 0.5 - K[0, 2]) / K[0, 0]
    inverse = np.tile(((1 - np.abs(x)) / 4).astype(np.float32), (HEIGHT, 1))
    normals = normals_from_inverse_depth(inverse, K, 8)
    assert _degrees(normals[:, 202:220], [1, 0, -1]).max() < 2
    assert _degrees(normals[:, 180:198], [-1, 0, -1]).max() < 2


def test_what_has_no_depth_has_no_normal_and_takes_no_part() -> None:
    inverse = np.full((HEIGHT, WIDTH), 0.25, np.float32)
    inverse[:, 150:] = 0
    inverse[10:200:7, 3:150:5] = 0
    normals = normals_from_inverse_depth(inverse, K, 8)
    assert not normals[inverse == 0].any()
    assert _degrees(normals[inverse > 0], [0, 0, -1]).max() < 0.1
