"""What mapping leaves and says: a second try that helped or did not, and a model of too few photographs."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from command_line import Captured, json_of
from small_demo import QUICK, SETTINGS, MakeOptions
from street import FOCAL_PX, Street, name_of, write_blank_images, write_street

from colmap_ihe.batch.preview import preview_project
from colmap_ihe.cli import main
from colmap_ihe.colmap.second_try import EASIER
from colmap_ihe.errors import MappingError
from colmap_ihe.evaluation.compare import compare
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.pipeline.job import ProjectJob, run_job
from colmap_ihe.pipeline.reconstruct import EndedEarlyError, reconstruct
from colmap_ihe.pipeline.stage import RunContext
from colmap_ihe.pipeline.stages import sparse
from colmap_ihe.pipeline.stages.sparse import STAGE
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options, SparseOptions


def run_of(street: Street, root: Path, **options: Any) -> RunContext:
    """A run that has come to this stage, of photographs `00.jpg` and up."""
    project = Project(root, root / "images")
    project.workspace.mkdir(parents=True)
    write_street(street, project.database)
    for folder in (project.grey, project.colour):
        write_blank_images(street, folder)
    names = {f"{number:02}.jpg": name_of(number) for number in range(street.images)}
    records: dict[str, dict[str, Any]] = {
        "convert": {"grey": names},
        "features": {"images": street.images},
        "matches": {},
    }
    with ThreadPoolExecutor(1) as executor:
        chosen = Options(sparse=SparseOptions(**options))
        return RunContext(project, chosen, Discovery((), ()), executor, records=records)


def test_a_second_try_is_in_the_record_and_warned_of(tmp_path: Path) -> None:
    record = sparse.run(run_of(Street(points=1200, wander=0.05), tmp_path), SILENT)
    assert record.second_try == {"options": dict(EASIER), "images": 10, "first": 0, "second": 10}
    assert (record.models[0].registered_images, record.unregistered) == (10, [])
    assert "registered none of 10 photographs, and 10 in a second try" in record.warnings[0]


def test_without_a_second_try_the_record_is_as_ever(tmp_path: Path) -> None:
    record = sparse.run(run_of(Street(sideways=True), tmp_path), SILENT).model_dump(exclude_unset=True)
    assert set(record) == {"models", "unregistered", "cameras", "held_out", "warnings"}
    (camera,) = record["cameras"]
    assert (camera["photographs"], camera["by"], camera["names"][0]) == (10, "calibration", "f")
    assert camera["params"][0] == pytest.approx(FOCAL_PX, rel=0.02)
    assert camera["standard_deviations"][0] > 0


def test_what_was_tried_is_in_the_error(tmp_path: Path) -> None:
    run = run_of(
        Street(points=400, wander=0.05), tmp_path, colmap={"mapper": {"init_max_forward_motion": 0.95}}
    )
    with pytest.raises(MappingError) as caught:
        sparse.run(run, SILENT)
    said = str(caught.value)
    assert said.startswith("none of the 10 photographs could be registered: of the ")
    assert "which is little to begin a model with; a second try with what helps" in said
    assert "registered none either (`--set 'sparse.colmap.mapper={init_min_tri_angle: 4.0," in said
    assert "sparse.colmap" not in caught.value.hint


@pytest.mark.parametrize(
    ("registered", "images", "least", "too_few"),
    [
        (2, 10, 0.33, True),
        (3, 10, 0.33, True),
        (4, 10, 0.33, False),
        (3, 9, 0.33, False),
        (2, 3, 0.33, True),
        (2, 2, 0.33, False),
        (4, 10, 0.5, True),
        (9, 10, 1.0, True),
        (10, 10, 1.0, False),
        (2, 10, 0.0, False),
    ],
)
def test_less_than_a_third_or_two_of_more_are_too_few(
    registered: int, images: int, least: float, too_few: bool
) -> None:
    options = Options(sparse=SparseOptions(min_registered=least))
    unregistered = [f"{number}.jpg" for number in range(images - registered)]
    record = {"models": [{"registered_images": registered}], "unregistered": unregistered}
    assert sparse.are_too_few(registered, images, options) == too_few
    shortfall = STAGE.shortfall(options, record)
    assert (shortfall is not None) == too_few
    if shortfall is not None:
        assert f"only {registered} of {images} photographs" in shortfall.reason
        assert "--set sparse.min_registered=0" in shortfall.hint


def test_how_many_are_enough_makes_no_stage_stale() -> None:
    options = [Options(sparse=SparseOptions(min_registered=least)) for least in (0.33, 0)]
    assert STAGE.options_of(options[0]) == STAGE.options_of(options[1])
    assert STAGE.options_of(Options()) == {
        "sparse": {"mapper": "incremental", "calibration": "auto", "seed": 0, "colmap": {}},
    }


TWO = "sparse.colmap={image_names: [portico_04.png, portico_05.png], triangulation: {ignore_two_view_tracks: false}}"
"""COLMAP then maps these two of the demo's eight."""


def test_two_of_eight_are_no_success(capsys: Captured, finished: Path) -> None:
    """Of the command, whose results stay: model, summary and page are there, and nothing dense is made of it."""
    asked = ["reconstruct", str(finished), *SETTINGS, "--set", TWO]
    assert main([*asked, "--json"]) == 1
    captured = capsys.readouterr()
    summary, failure = json.loads(captured.out), captured.err.splitlines()[-1]
    assert failure.startswith(
        "colmap-ihe: the largest model holds only 2 of 8 photographs, too few to go on with"
    )
    assert "--set sparse.min_registered=0" in failure
    assert (summary["registered_images"], summary["too_few_registered"]) == (2, True)
    assert summary["dense_points"] is None and "dense" not in summary["stages"]
    assert any("only 2 of 8 photographs" in text for text in summary["warnings"])
    assert json.loads((finished / "report/summary.json").read_text()) == summary
    assert (finished / "workspace/sparse/0/points3D.bin").is_file()
    assert "only 2 of 8 photographs" in (finished / "report/index.html").read_text()

    states = {s["name"]: s for s in json_of(capsys, "status", finished, *SETTINGS, "--set", TWO)}
    assert states["sparse"]["state"] == "done" and "only 2 of 8" in states["sparse"]["why"]
    assert states["dense"]["state"] == states["mesh"]["state"] == "to do"

    assert main(asked) == 1  # again, with nothing to do
    captured = capsys.readouterr()
    assert "2 of 8" in captured.out and str(finished / "workspace/sparse/0") in captured.out
    assert "up to date" in captured.err and captured.err.splitlines()[-1] == failure


def test_it_goes_on_where_the_user_says_so(finished: Path, quick_options: MakeOptions) -> None:
    with pytest.raises(EndedEarlyError) as caught:
        reconstruct(finished, quick_options(TWO, "mesh.enabled=false"))
    assert (caught.value.done.stages_run, caught.value.done.page) == (
        ("sparse",),
        finished / "report/index.html",
    )
    done = reconstruct(finished, quick_options(TWO, "mesh.enabled=false", "sparse.min_registered=0"))
    assert (done.stages_run, done.summary["too_few_registered"]) == (("survey", "dense"), False)
    assert not any("too few" in text for text in done.summary["warnings"])


def test_without_dense_it_is_no_success_either(finished: Path, quick_options: MakeOptions) -> None:
    """Nor in a batch, where every stage of it is up to date: it fails again, and is not taken for done."""
    assignments = (*QUICK, TWO, "dense.enabled=false")
    for _ in range(2):
        outcome = run_job(ProjectJob(str(finished), assignments))
        assert (outcome.state, "only 2 of 8" in outcome.reason) == ("failed", True)
        assert "sparse.min_registered=0" in outcome.hint
        assert not preview_project(finished, assignments).up_to_date
    states = [s.state for s in status(finished, quick_options(TWO, "dense.enabled=false"))]
    assert states == [*["done"] * 6, "to do", "off", "off", "off"]
    assert run_job(ProjectJob(str(finished), (*assignments, "sparse.min_registered=0"))).state == "done"
    assert preview_project(finished, (*assignments, "sparse.min_registered=0")).up_to_date


def test_what_was_not_asked_to_be_mapped_is_no_failure(finished: Path, quick_options: MakeOptions) -> None:
    with pytest.raises(EndedEarlyError):
        reconstruct(finished, quick_options(TWO))
    done = reconstruct(finished, quick_options(TWO), until="matches")
    assert (done.stages_run, done.summary["too_few_registered"]) == ((), True)


def test_no_cameras_of_two_photographs_are_compared_with(finished: Path, quick_options: MakeOptions) -> None:
    options = quick_options("dense.enabled=false", TWO)
    with pytest.raises(MappingError, match="rec709: only 2 of 8 photographs are registered in its model"):
        compare(finished, options, methods=["rec709"], seeds=0)
    options = quick_options("dense.enabled=false", TWO, "sparse.min_registered=0")
    (result,) = compare(finished, options, methods=["rec709"], seeds=0)
    assert result.runs[0]["registered"] == 2
