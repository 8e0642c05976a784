"""The figures that a survey gives of a model of a comparison."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from survey_block import SurveyBlock, survey_block

from colmap_ihe.evaluation.metric import given_survey
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options


@pytest.fixture(scope="module")
def block() -> SurveyBlock:
    return survey_block(12, 12)


def written(folder: Path, block: SurveyBlock) -> tuple[Project, Path]:
    """A project with the block's control, and the folder of a model."""
    (folder / "images").mkdir(parents=True)
    (folder / "control").mkdir()
    project = Project.at(folder)
    rows = ["name,x,y,z,accuracy_m,role"]
    for number, (name, place) in enumerate(block.named.items()):
        x, y, z = place.tolist()
        rows.append(f"P{name},{x},{y},{z},0.005,{'check' if number % 3 == 1 else 'control'}")
    (folder / "control" / "points.csv").write_text("\n".join(rows), encoding="utf-8")
    sights = [f"{sight.image},P{sight.name},{sight.x_px},{sight.y_px}" for sight in block.sights]
    (folder / "control" / "observations.csv").write_text(
        "\n".join(["image,name,x_px,y_px", *sights]), encoding="utf-8"
    )
    model = folder / "model"
    model.mkdir()
    block.model.write(model)
    return project, model


def test_a_model_is_measured_by_the_control_and_check_points_of_its_project(
    tmp_path: Path, block: SurveyBlock
) -> None:
    project, model = written(tmp_path / "a", block)
    with ThreadPoolExecutor(1) as executor:
        survey = given_survey(project, Options(), executor)
        figures = survey.figures_of(project.grey, {f"{n}.png": f"{n}.png" for n in range(12)}, model)
    assert figures.keys() == {"check_rms_mm", "control_rms_mm", "extent_m"}
    assert 0 < figures["control_rms_mm"] < 3
    assert 0 < figures["check_rms_mm"] < 6
    assert figures["extent_m"] == pytest.approx(21.4, abs=0.5)
    assert [name for name, _ in survey.inputs()[0]] == ["observations.csv", "points.csv"]


def test_without_control_there_is_nothing_to_measure_by(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    with ThreadPoolExecutor(1) as executor:
        survey = given_survey(Project.at(tmp_path), Options(), executor)
    assert (survey.inputs(), survey.figures_of(tmp_path, {}, tmp_path)) == ((), {})
