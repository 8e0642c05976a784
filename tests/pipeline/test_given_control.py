"""Control by the names of photographs, and what of it cannot be used."""

from __future__ import annotations

from pathlib import Path

import pytest

from colmap_ihe.errors import ControlFileError, OptionError
from colmap_ihe.pipeline.given_control import dictionary_for, given_control, named_control
from colmap_ihe.project.folder import Project
from colmap_ihe.project.option_sections import SurveyOptions
from colmap_ihe.project.options import Options
from colmap_ihe.survey.control import CameraPosition, Control, ScaleBar, Sight, SurveyedPoint

GREY_OF = {"a/DSC1.JPG": "a/DSC1.png", "b/DSC1.JPG": "b/DSC1.png", "b/DSC2.dng": "b/DSC2.png"}
SIZES = dict.fromkeys(GREY_OF.values(), (1000, 800))


def options(**survey: str) -> Options:
    return Options(survey=SurveyOptions(**survey))  # type: ignore[arg-type]


def test_photographs_may_be_named_without_folder_and_ending_where_that_is_clear() -> None:
    named = ["a/dsc1.jpg", "b\\DSC1.JPG", "DSC2.dng", "DSC2", "DSC1.JPG", "DSC9.JPG"]
    control = Control(
        points={"P": SurveyedPoint("P", (0, 0, 0))},
        positions=[CameraPosition("DSC2", (1, 2, 3)), CameraPosition("DSC1", (1, 2, 3))],
        sights=[Sight(name, "P", 10, 20, "observations.csv", n) for n, name in enumerate(named, 2)],
    )
    result = named_control(control, GREY_OF, SIZES)
    assert [o.image for o in result.observations] == ["a/DSC1.png", "b/DSC1.png", "b/DSC2.png", "b/DSC2.png"]
    assert [p.image for p in result.control.positions] == ["b/DSC2.png"]
    assert result.warnings == [
        "control/ names DSC1, DSC1.JPG, DSC9.JPG, which no photograph of the set is called"
    ]


def test_sights_outside_of_the_picture_or_of_unknown_points_and_unused_files_are_told() -> None:
    sights = [
        Sight("DSC2", "P", 1001, 5, "observations.csv", 2),
        Sight("DSC2", "Q", 5, 5, "observations.csv", 3),
    ]
    control = Control(points={"P": SurveyedPoint("P", (0, 0, 0))}, sights=sights, unused=["ponts.csv"])
    result = named_control(control, GREY_OF, SIZES)
    assert [o.name for o in result.observations] == ["Q"]
    assert result.warnings[0] == "observations.csv line 2: P is outside of DSC2 of 1000 x 800 pixels"
    assert result.warnings[1].startswith("Q of the observations are in no other file of control/")
    assert result.warnings[2] == "not used: control/ponts.csv"


def test_targets_are_looked_for_where_control_names_them() -> None:
    bar = Control(scale_bars=[ScaleBar("T1", "T2", 1.0)])
    clicked = Control(
        scale_bars=[ScaleBar("T1", "T2", 1.0)], sights=[Sight("a", n, 1, 1) for n in ("T1", "T2")]
    )
    assert dictionary_for(bar, options()) == "APRILTAG_36h11"
    assert dictionary_for(clicked, options()) == ""
    assert dictionary_for(Control(), options()) == ""
    assert dictionary_for(bar, options(targets="none")) == ""
    assert dictionary_for(Control(), options(targets="4X4_50")) == "4X4_50"


def test_what_cannot_be_used_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "control").mkdir()
    (tmp_path / "control/points.csv").write_text("name,x,y,z\nA,11.58,48.14,500\nB,11.5801,48.1401,505\n")
    project = Project.at(tmp_path)
    with pytest.raises(ControlFileError, match="look like degrees"):
        given_control(project, options())
    assert given_control(project, options(align="none")) == Control()
    assert given_control(project, options(crs="EPSG:4326")).crs == "EPSG:4326"
    with pytest.raises(OptionError, match="dictionary"):
        given_control(project, options(targets="apriltag"))
