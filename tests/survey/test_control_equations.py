"""The derivatives of what a survey adds, against differences."""

from __future__ import annotations

import numpy as np
from survey_block import survey_block

from colmap_ihe.colmap.calibration.block import part_of
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.survey.adjustment import free_cameras
from colmap_ihe.survey.control_equations import ControlTerms, rows_of

STEP = 1e-6


def test_derivatives_are_those_of_the_residuals() -> None:
    made = survey_block(4, 4, 60)
    ids = sorted(made.model.reg_image_ids())
    assert len(ids) == 4
    block = part_of(made.model, ids, [1]).block
    free = free_cameras([made.model.cameras[1]], [[0, 1, 2, 3]])
    draw = np.random.default_rng(0)
    points = np.array([made.model.points3D[i].xyz for i in sorted(made.model.points3D)[:3]])
    images = np.array([0, 1, 2, 3, 0], np.intp)
    numbers = np.array([0, 1, 2, 0, 1], np.intp)
    pixels = draw.uniform(300, 900, (5, 2))
    terms = ControlTerms(
        points,
        points + 0.01,
        np.array([0.5, np.inf, 0.2]),
        images,
        numbers,
        pixels,
        np.full(5, 1e4),  # so that none is taken for wrong, which weighs less
        np.array([(0, 2)], np.intp),
        np.array([1.0]),
        np.array([0.1]),
        np.array([1, 3], np.intp),
        draw.normal(0, 1, (2, 3)),
        np.full(2, 1e3),
    )
    values = np.zeros(4)
    rows = rows_of(terms, block, free, values, points)
    size = rows.jacobian.shape[1]
    assert size == 6 * 4 + 4 + 3 * 3
    for column in range(size):
        move = np.zeros(size)
        move[column] = STEP
        turned = np.stack([pycolmap.Rotation3d(t).matrix() for t in move[:24].reshape(-1, 6)[:, :3]])
        shifted = move[:24].reshape(-1, 6)[:, 3:]
        ahead = type(block)(
            turned @ block.rotations,
            block.translations + shifted,
            block.cameras,
            block.points,
            block.image,
            block.point,
            block.pixels,
        )
        after = rows_of(terms, ahead, free, move[24:28], points + move[28:].reshape(-1, 3))
        expected = (after.residuals - rows.residuals) / STEP
        scale = np.abs(rows.jacobian[:, column]).max() + 1e-9
        np.testing.assert_allclose(rows.jacobian[:, column], expected, atol=2e-4 * scale)
