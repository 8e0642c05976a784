"""A block of photographs brought into metres, and surveys that are wrong."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import pytest
from survey_block import SurveyBlock, survey_block

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import ControlFileError
from colmap_ihe.survey import control_fit
from colmap_ihe.survey import georeference as module
from colmap_ihe.survey.accuracy import point_rms, rms
from colmap_ihe.survey.alignment import Survey
from colmap_ihe.survey.control import CameraPosition, ScaleBar, SurveyedPoint
from colmap_ihe.survey.georeference import Georeferenced, georeference

FREE = {1: [0, 1, 2, 3]}
ACCURACY = 0.005


@pytest.fixture(scope="module")
def block() -> SurveyBlock:
    return survey_block(12, 12)


def points_of(block: SurveyBlock, accuracy: float = ACCURACY) -> dict[str, SurveyedPoint]:
    draw = np.random.default_rng(5)
    points = {}
    for number, (name, place) in enumerate(block.named.items()):
        x, y, z = (place + draw.normal(0, accuracy, 3)).tolist()
        points[name] = SurveyedPoint(name, (x, y, z), accuracy, "check" if number % 3 == 1 else "control")
    return points


def result_of(
    block: SurveyBlock, survey: Survey, align: str = "auto"
) -> tuple[Georeferenced, pycolmap.Reconstruction]:
    model = pycolmap.Reconstruction(block.model)
    return georeference(model, survey, block.sights, align, FREE), model


def camera_error(block: SurveyBlock, model: pycolmap.Reconstruction) -> float:
    centres = {str(image.name): image.projection_center() for image in model.images.values()}
    return float(np.mean([np.linalg.norm(centres[name] - centre) for name, centre in block.centres.items()]))


def test_check_points_are_as_good_as_the_covariance_says_and_the_bent_model_is_straight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    block = survey_block(12, 12, bent=True)
    survey = Survey(points=points_of(block))
    result, model = result_of(block, survey)
    assert (result.method, result.adjusted, result.warnings) == ("control_points", True, [])
    check = point_rms(result.points, "check")
    expected = rms([p.deviation_m for p in result.points if p.role == "check" and p.deviation_m])
    assert check is not None
    assert expected is not None
    assert 0.4 < check / expected < 1.3
    assert all(not point.used for point in result.points if point.role == "check")
    for point in result.points:
        assert len(point.residuals_px) == point.sights > 1
        assert point.error_px == pytest.approx((np.mean(np.square(point.residuals_px)) / 2) ** 0.5)
    monkeypatch.setattr(module, "MOST_IMAGES", 1)
    moved, _ = result_of(block, survey)
    assert not moved.adjusted
    moved_check = point_rms(moved.points, "check")
    assert moved_check is not None
    assert check < moved_check / 2
    assert model.cameras[1].focal_length == pytest.approx(1400, abs=6)


def _a_metre_off(points: dict[str, SurveyedPoint]) -> None:
    x, y, z = points["T3"].xyz
    points["T3"] = SurveyedPoint("T3", (x + 1, y, z), ACCURACY)


def _ten_accuracies_off(points: dict[str, SurveyedPoint]) -> None:
    x, y, z = points["T3"].xyz
    points["T3"] = SurveyedPoint("T3", (x, y, z + 10 * ACCURACY), ACCURACY)


def _exchanged(points: dict[str, SurveyedPoint]) -> None:
    one, other = points["T2"], points["T8"]
    points["T2"] = SurveyedPoint("T2", other.xyz, ACCURACY)
    points["T8"] = SurveyedPoint("T8", one.xyz, ACCURACY)


@pytest.mark.parametrize(
    ("spoil", "out", "words"),
    [
        (_a_metre_off, {"T3"}, "control points: T3 is left out"),
        (_ten_accuracies_off, {"T3"}, "T3 is left out of the adjustment"),
        (_exchanged, {"T2", "T8"}, "the names of T2 and T8 look exchanged"),
    ],
)
def test_wrong_points_are_named_and_do_not_bend_the_model(
    block: SurveyBlock, spoil: Callable[[dict[str, SurveyedPoint]], None], out: set[str], words: str
) -> None:
    points = points_of(block)
    _, straight = result_of(block, Survey(points=points))
    spoil(points)
    result, model = result_of(block, Survey(points=points))
    assert {p.name for p in result.points if p.reason} == out
    assert any(words in warning for warning in result.warnings)
    assert camera_error(block, model) < 2 * camera_error(block, straight) + 0.005


def test_points_in_a_line_or_seen_once_place_nothing(block: SurveyBlock) -> None:
    low = [name for name, place in block.named.items() if place[2] == 1.0][:4]
    draw = dict.fromkeys(low, None)
    points = {n: SurveyedPoint(n, (float(block.named[n][0]), 0.0, 1.0)) for n in draw}
    model = pycolmap.Reconstruction(block.model)
    before = model.images[1].cam_from_world().matrix()
    once = [s for s in block.sights if s.image == "0.png"]
    for sights, words in ((block.sights, "line"), (once, "none of them")):
        result = georeference(model, Survey(points=points), sights, "auto", FREE)
        assert result.method == ""
        assert any(words in warning for warning in result.warnings)
        np.testing.assert_array_equal(model.images[1].cam_from_world().matrix(), before)
    with pytest.raises(ControlFileError, match="line"):
        georeference(model, Survey(points=points), block.sights, "control_points", FREE)


def test_two_scale_bars_give_the_scale_and_bars_that_disagree_none(block: SurveyBlock) -> None:
    ends = [("T0", "T10"), ("T1", "T11")]
    lengths = [float(np.linalg.norm(block.named[a] - block.named[b])) for a, b in ends]
    bars = [ScaleBar(a, b, length, 0.0005) for (a, b), length in zip(ends, lengths, strict=True)]
    exact = survey_block(12, 12, noise_px=0.05, seed=3)
    result, model = result_of(exact, Survey(bars=bars))
    assert result.method == "scale_bars"
    centres = {str(image.name): image.projection_center() for image in model.images.values()}
    apart = float(np.linalg.norm(centres["0.png"] - centres["11.png"]))
    truth = float(np.linalg.norm(exact.centres["0.png"] - exact.centres["11.png"]))
    assert apart == pytest.approx(truth, rel=2e-3)
    wrong = [bars[0], ScaleBar("T1", "T11", 1.1 * lengths[1], 0.0005)]
    result, _ = result_of(exact, Survey(bars=wrong))
    assert result.method == ""
    assert any("disagree" in warning for warning in result.warnings)


def test_gps_moves_the_model_and_does_not_bend_it(block: SurveyBlock) -> None:
    draw = np.random.default_rng(1)
    transform = pycolmap.GPSTransform()
    fixes: dict[str, tuple[float, float, float]] = {}
    for name, centre in block.centres.items():
        far = 20 * centre + draw.normal(0, 5, 3)
        latitude, longitude, height = transform.enu_to_ellipsoid(far[None], 48.0, 11.0, 500.0)[0].tolist()
        fixes[name] = (longitude, latitude, height)
    model = pycolmap.Reconstruction(block.model)
    before = copy.deepcopy({i: p.xyz for i, p in model.points3D.items()})
    params = list(model.cameras[1].params)
    result = georeference(model, Survey(fixes=fixes), [], "auto", FREE)
    assert (result.method, result.adjusted) == ("gps", False)
    assert list(model.cameras[1].params) == params
    assert result.similarity is not None
    ids = sorted(before)[:50]
    moved = np.array([before[i] for i in ids]) @ result.similarity[:, :3].T + result.similarity[:, 3]
    np.testing.assert_allclose([model.points3D[i].xyz for i in ids], moved, rtol=1e-9, atol=1e-9)


def test_positions_of_five_centimetres_give_the_scale_and_do_no_harm(block: SurveyBlock) -> None:
    draw = np.random.default_rng(2)
    positions = []
    for name, centre in block.centres.items():
        x, y, z = (centre + draw.normal(0, 0.05, 3)).tolist()
        positions.append(CameraPosition(name, (x, y, z), 0.05))
    x, y, z = positions[4].xyz
    positions[4] = CameraPosition(positions[4].image, (x, y + 30, z), 0.05)
    result, model = result_of(block, Survey(positions=positions))
    assert (result.method, result.adjusted) == ("positions", True)
    assert [p.image for p in result.positions if p.reason] == ["4.png"]
    assert camera_error(block, model) < 0.06


def test_two_control_points_do_not_bend_a_model_that_scale_bars_made_metric(block: SurveyBlock) -> None:
    """They are of another frame, about which two points say too little."""
    bar = ScaleBar("T0", "T10", float(np.linalg.norm(block.named["T0"] - block.named["T10"])), 0.0005)
    points = {name: point for name, point in points_of(block).items() if name in ("T3", "T6")}
    far = [CameraPosition("0.png", (500.0, 500.0, 500.0), 0.01)]
    result, model = result_of(block, Survey(points=points, bars=[bar], positions=far))
    assert result.method == "scale_bars"
    assert any("2 of at least 3" in warning for warning in result.warnings)
    assert all(point.role == "seen" for point in result.points)
    alone, other = result_of(block, Survey(bars=[bar]))
    np.testing.assert_allclose(
        model.images[1].projection_center(), other.images[1].projection_center(), atol=1e-9
    )
    assert alone.method == "scale_bars"


def test_a_position_far_from_where_control_points_put_it_is_left_out(block: SurveyBlock) -> None:
    positions = []
    for name, centre in block.centres.items():
        x, y, z = centre.tolist()
        positions.append(CameraPosition(name, (x, y, z + 40 * (name == "5.png")), 0.05))
    points = points_of(block)
    result, model = result_of(block, Survey(points=points, positions=positions))
    assert [p.image for p in result.positions if p.reason] == ["5.png"]
    assert camera_error(block, model) < 0.02


def test_a_point_that_is_wrong_after_three_others_is_named(
    block: SurveyBlock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_ROUNDS", 1)
    monkeypatch.setattr(control_fit, "_TIMES", 0.0)
    result, _ = result_of(block, Survey(points=points_of(block)))
    assert any("mm from where the others put it though" in warning for warning in result.warnings)
    assert not any("left out of the adjustment, " in warning for warning in result.warnings)
