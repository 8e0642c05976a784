"""What the demo says of its own errors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from colmap_ihe.evaluation.demo.paintings import PANELS
from colmap_ihe.evaluation.demo.run import truth_summary
from colmap_ihe.evaluation.truth import read_truth
from colmap_ihe.pipeline.reconstruct import Reconstruction
from colmap_ihe.project.folder import Project
from colmap_ihe.report.tables import summary_rows


def test_the_error_against_the_truth_is_small_and_told(
    finished: Path, finished_summary: dict[str, Any], small_demo: Path
) -> None:
    done = Reconstruction(Project.at(finished), finished_summary, ())
    truth = truth_summary(done, read_truth(small_demo / "truth"), 240)
    assert 0 < truth["rotation_error_deg"] < 0.4
    assert 0 < truth["position_error_percent"] < 0.2
    assert 0 < truth["dense_median_error_percent"] < 0.6
    assert truth["depth_right_percent"] > 50
    assert truth["painted_depth_percent"].keys() == PANELS.keys()
    rows = dict(summary_rows({**finished_summary, "truth": truth}))
    assert f"rotations {truth['rotation_error_deg']:.4f} degrees off" in rows["cameras against the truth"]
