"""Targets of a whole set: where they are in the model, and what is told of those that do not fit."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from target_wall import SIZE, TARGETS, true_point, wall_model, write_photograph, write_photographs

from colmap_ihe.errors import Cancelled, ProjectError
from colmap_ihe.machine.progress import Silent
from colmap_ihe.survey.observations import Observation
from colmap_ihe.survey.target_observations import SetTargets, left_out_in_words, targets_of_set
from colmap_ihe.survey.triangulate import triangulation


@pytest.fixture(scope="module")
def greys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("greys")
    write_photographs(folder)
    return folder


def found_in(folder: Path, progress: Silent | None = None) -> SetTargets:
    with ThreadPoolExecutor(2) as executor:
        return targets_of_set(wall_model(), folder, executor, progress=progress or Silent())


def test_targets_of_a_set_have_their_places_in_the_model(greys: Path) -> None:
    found = found_in(greys)
    assert len(found.observations) == 4 * len(TARGETS)
    assert found.twice == {}
    triangulated = triangulation(wall_model(), found.observations)
    assert sorted(triangulated.points) == ["T21", "T3", "T8"]
    for number in TARGETS:
        point = triangulated.points[f"T{number}"]
        assert np.abs(point.xyz - true_point(number)).max() < 0.0005  # a pixel is 7 mm
        assert np.abs(list(point.residuals_px.values())).max() < 0.1
        deviations = np.sqrt(np.diag(point.covariance))
        assert (np.abs(point.xyz - true_point(number)) < 3.5 * deviations).all()
    assert left_out_in_words(found, triangulated) == []


def test_a_target_seen_twice_or_elsewhere_is_told_and_left_out_there(greys: Path, tmp_path: Path) -> None:
    folder = copytree(greys, tmp_path / "greys")
    write_photograph(
        folder, "b.png", [(3, TARGETS[3]), (8, (0.55, 0.35)), (21, TARGETS[21])]
    )  # it has been moved
    write_photograph(folder, "c.png", [*TARGETS.items(), (3, (0.6, 0.4))])
    found = found_in(folder)
    assert found.twice == {"c.png": ("T3",)}
    assert ("c.png", "T3") not in {(one.image, one.name) for one in found.observations}
    triangulated = triangulation(wall_model(), found.observations)
    moved = triangulated.points["T8"]
    assert np.abs(moved.xyz - true_point(8)).max() < 0.0005
    assert moved.used == ("a.png", "c.png", "north side/d.png")
    twice, elsewhere = left_out_in_words(found, triangulated)
    assert (
        twice
        == "target T3 is seen more than once in c.png and left out there: each target must be there only once"
    )
    assert elsewhere.startswith("target T8 disagrees in b.png (")
    assert elsewhere.endswith(" px is the limit) and is left out there")


def test_a_target_that_one_photograph_shows_has_no_place() -> None:
    found = SetTargets((Observation("a.png", "T40", 100, 200, 0.1),), {})
    assert left_out_in_words(found, triangulation(wall_model(), found.observations)) == [
        "target T40 has no place in the model: only a.png sees it; a point needs two photographs"
    ]


def test_a_grey_that_is_not_the_camera_s_is_refused(greys: Path, tmp_path: Path) -> None:
    with pytest.raises(ProjectError, match=r"a\.png cannot be read as an image"):
        found_in(tmp_path)
    model = wall_model()
    model.cameras[1].width = 500
    with (
        ThreadPoolExecutor(2) as executor,
        pytest.raises(ProjectError, match=f"has {SIZE[0]} x {SIZE[1]} pixels"),
    ):
        targets_of_set(model, greys, executor)


def test_the_search_ends_when_the_user_asks(greys: Path) -> None:
    progress = Silent()
    progress.cancelled = True
    with pytest.raises(Cancelled):
        found_in(greys, progress)
