"""How well parameters are determined, beside how far they come out from the truth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from wall_survey import camera, survey, whole_block

from colmap_ihe.colmap.calibration import deviations as module
from colmap_ihe.colmap.calibration.choose import Chooser
from colmap_ihe.colmap.calibration.deviations import Deviations, deviations_of
from colmap_ihe.colmap.calibration.freedom import Freedom, Lens
from colmap_ihe.colmap.native import pycolmap

PARAMS = (1000, 612, 447, -0.05)


def deviations(
    freedom: Freedom, seed: int = 1, lens: pycolmap.Camera | None = None, **of_scene: Any
) -> tuple[Deviations, pycolmap.Camera]:
    truth = lens or camera(params=PARAMS)
    model = survey([truth], points=500, noise=0.3, seed=seed, **of_scene)
    block, cameras = whole_block(model)
    chooser = Chooser(block, cameras)
    fit = chooser.fit(block, (Lens((0,), (0,), freedom),), cameras)
    return deviations_of(fit, cameras)[0], fit.cameras[0]


def test_deviations_are_those_of_repeated_surveys() -> None:
    every = [deviations(Freedom("SIMPLE_RADIAL", 1, True), seed) for seed in range(12)]
    off = np.array([found.params - PARAMS for _, found in every])
    said = np.array([one.values for one, _ in every])
    spread = np.sqrt(np.mean((off / said) ** 2, axis=0))
    # Principal points are less sure than the model chosen has them: what it leaves out could move them.
    assert (spread[[0, 3]] > 0.6).all()
    assert (spread[[1, 2]] > 0.3).all()
    assert (spread < 1.5).all()


def test_principal_points_are_as_sure_as_with_all_free_that_could_be() -> None:
    chosen, richest = (
        np.array(deviations(freedom)[0].values)
        for freedom in (Freedom("SIMPLE_RADIAL", 1, True), Freedom("FULL_OPENCV", 5, True))
    )
    assert chosen[1:3] == pytest.approx(richest[2:4], rel=0.1)
    alone = camera("SIMPLE_PINHOLE", (1000, 612, 447))  # a model with nothing richer
    simple = np.array(deviations(Freedom("SIMPLE_PINHOLE", 0, True), lens=alone)[0].values)
    assert (chosen[1:3] > 1.2 * simple[1:3]).all()


def test_what_was_held_has_none() -> None:
    found, _ = deviations(Freedom("SIMPLE_RADIAL", 1))
    assert found.values[1:3] == (0, 0)
    assert 0.3 < found.values[0] < 3
    assert 1e-4 < found.values[3] < 2e-3


def test_fewer_photographs_say_less() -> None:
    many, few = (deviations(Freedom("SIMPLE_RADIAL", 1, True), count=count)[0] for count in (8, 4))
    assert (np.array(few.values) > 1.2 * np.array(many.values)).all()


def test_two_focal_lengths_that_move_alike_are_as_sure_and_no_doubt() -> None:
    lens = camera("OPENCV", (1000, 1000, 612, 447, -0.05, 0, 0, 0))
    found, _ = deviations(Freedom("OPENCV", 4, True), lens=lens)
    assert found.values[0] == found.values[1] > 0
    assert not [pair for pair in found.correlated if {"fx", "fy"} == set(pair[:2])]


def test_doubtful_are_a_focal_length_or_principal_point_that_another_may_stand_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = np.eye(5)  # of f, k1, k2, cx, cy
    for one, other, value in ((0, 1, -0.97), (1, 2, 0.99), (3, 4, 0.94)):
        known[one, other] = known[other, one] = value
    monkeypatch.setattr(module, "covariance", lambda *_: known)
    found, _ = deviations(Freedom("RADIAL", 2, True), lens=camera("RADIAL", (1000, 612, 447, -0.05, 0)))
    ((first, second, value),) = found.correlated
    assert (first, second, round(value, 6)) == ("f", "k1", -0.97)


def test_pictures_that_were_turned_are_as_sure() -> None:
    lenses = [
        camera(params=PARAMS),
        camera(params=(1000, 900 - 447, 612, -0.05), camera_id=2, size=(900, 1200)),
    ]
    block, cameras = whole_block(survey(lenses, points=500, noise=0.3, rolls=(0, 0, 90, 90)))
    both = (Lens((0, 1), (0, 1), Freedom("SIMPLE_RADIAL", 1, True)),)
    fit = Chooser(block, cameras).fit(block, both, cameras)
    first, second = (np.array(one.values) for one in deviations_of(fit, cameras))
    np.testing.assert_allclose(second, first[[0, 2, 1, 3]])
