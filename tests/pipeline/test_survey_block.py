"""The block of a whole project, and its residuals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from colmap_ihe.pipeline.model_view import ModelView
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.pipeline.summary import summarise
from colmap_ihe.pipeline.survey_block import _residuals, residuals_of, survey_block
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options


def test_a_project_has_verdict_dates_map_plan_and_residuals(finished: Path) -> None:
    project = Project.at(finished)
    records = {stage.name: read_record(project, stage.name) for stage in STAGES}
    found = {name: record for name, record in records.items() if record is not None}
    summary = summarise(found, Options())
    photographs = {grey: name for name, grey in found["convert"]["grey"].items()}
    block = survey_block(project.database, found, summary, ModelView(project.sparse / "0"), photographs)
    facts = dict(block.facts)
    assert facts["photographs"] == "8 registered of 8"
    assert facts["taken"].startswith("2016-06-21")
    assert float(facts["memory"].split()[2]) > 0.05
    assert block.verdict.paragraph and block.verdict.level in ("good", "fair", "poor")
    [shown] = block.maps
    assert shown.view == "from the front" and len(shown.cells) > 50 and shown.photographs.max() == 8
    assert block.plan is not None
    assert list(block.plan.names) == sorted(found["convert"]["grey"])
    assert (block.plan.directions[:, 1] > 0.5).all()  # cameras stand below in the plan and look up in it
    [residuals] = block.residuals
    assert sum(residuals.counts) > 1000 and 0 < residuals.median_px < residuals.most_px < 4


def test_sights_of_named_points_have_a_count_of_their_own() -> None:
    survey = {
        "points": [{"residuals_px": [0.3, 0.5]}, {"residuals_px": [0.4]}, {}]
    }  # the last of an earlier version
    points, sights = _residuals(np.array([1.0, 2.0]), survey)
    assert (points.of, sum(points.counts)) == ("points of the model", 2)
    assert (sights.of, sum(sights.counts), sights.median_px) == ("named points of the survey", 3, 0.4)
    assert len(_residuals(np.array([1.0]), {})) == 1


def test_residuals_are_counted_by_steps_and_long_ones_in_the_last() -> None:
    errors = np.array([0.11] * 50 + [0.31] * 45 + [0.91] * 4 + [50.0, np.nan])
    found = residuals_of("points", errors)
    assert found is not None
    assert (found.step_px, found.counts[2], found.counts[6], found.counts[18], found.counts[-1]) == (
        0.05, 50, 45, 4, 1,
    )  # fmt: skip
    assert found.median_px == pytest.approx(0.21, abs=0.11)
    assert residuals_of("points", np.array([np.nan])) is None
