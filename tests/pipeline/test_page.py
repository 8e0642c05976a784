"""The page of a project: what is gathered for it, when it is written, and when not."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from synthetic import coded

from colmap_ihe.cli import main
from colmap_ihe.errors import NativeError
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import discover
from colmap_ihe.pipeline import page as pages
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.stage import RunContext
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.pipeline.summary import summarise
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.report.contents import Contents
from colmap_ihe.report.pictures import rec709

Make = Callable[..., Path]
MakeOptions = Callable[..., Options]


def contents_of(project: Path, options: Options) -> Contents:
    place = Project.at(project)
    found = {stage.name: read_record(place, stage.name) for stage in STAGES}
    records = {name: record for name, record in found.items() if record is not None}
    with local_executor() as executor:
        run = RunContext(place, options, discover(place.images), executor, records=records)
        return pages.gather(run, summarise(records, options), SILENT)


def test_a_page_shows_the_whole_project(finished: Path, quick_options: MakeOptions) -> None:
    html = (finished / "report/index.html").read_text()
    assert "portico_01" in html
    assert "All photographs are registered." in html and "8 registered of 8" in html
    assert '<h2 id="cameras-heading">Cameras</h2>' in html and '<a href="calibration.yaml">' in html
    found = contents_of(finished, quick_options())
    assert found.calibration.startswith("Points that the calibration did not see are off by 0.")
    assert len(found.photographs) == len(found.cameras) == 8
    assert all(p.points > 30 and p.error_px and p.coverage and p.thumbnail for p in found.photographs)
    assert found.cloud is not None
    assert found.cloud.kind == "dense"
    assert len(found.cloud.positions) == len(found.cloud.colours) == len(found.cloud.grey)
    # Upright, as the photographs were held: the cameras stand on one side, about level, and look at the middle.
    centres = np.array([camera.centre for camera in found.cameras])
    assert (centres[:, 2] > 0).all()
    assert np.ptp(centres[:, 1]) < 0.5 * np.ptp(centres[:, 0])
    middles = np.array([camera.corners.mean(axis=0) for camera in found.cameras])
    assert (np.linalg.norm(middles, axis=1) < np.linalg.norm(centres, axis=1)).all()
    assert found.matches is not None
    assert (found.matches == found.matches.T).all()
    assert found.matches[0, 1] > 15
    assert sum(found.points_by_images.values()) > 300
    assert found.pairs
    assert found.grey is not None
    assert sum(found.grey.tones_chosen) == pytest.approx(1)
    assert len(found.grey.tones_chosen) == 256


def test_a_grey_is_compared_with_the_default_and_measured_once(
    new_project: Make, quick_options: MakeOptions
) -> None:
    options = quick_options("dense.enabled=false", "fit.method=blue")
    project = new_project(4)
    reconstruct(project, options)
    found = contents_of(project, options)
    assert 1 <= len(found.sliders) <= 4
    assert found.grey is not None
    assert len(found.grey.tones_rec709) == 256
    assert all(pair.default is not None for pair in found.pairs)
    assert found.lost_colour is not None and "default grey in" in found.lost_colour.in_words
    figures = re.findall(r"[\d,]+ verified matches", (project / "report/index.html").read_text())
    measured = json.loads((project / "report/summary.json").read_text())["tried"]["candidates"]["blue"]
    assert set(figures) == {f"{measured['inliers']:,} verified matches"}


def look(grey: NDArray[np.uint8], colour: NDArray[np.uint8]) -> pages._Look:
    none = np.zeros(256, np.int64)
    return pages._Look("one", coded(colour, "a photograph"), None, colour, grey, none, none)


def test_greys_that_no_eye_can_tell_from_the_default_do_not_differ() -> None:
    colour = np.full((20, 30, 3), 100, np.uint8)
    default = rec709(colour)
    assert not pages._differs([])
    assert not pages._differs([look(default, colour)])
    half = default.copy()
    half[::2] += 1
    assert not pages._differs([look(half, colour)])
    assert pages._differs([look(half + np.uint8(1), colour)])


def test_the_default_is_not_compared_with_itself(new_project: Make, quick_options: MakeOptions) -> None:
    options = quick_options("dense.enabled=false", "fit.method=rec709")
    project = new_project(4)
    reconstruct(project, options)
    found = contents_of(project, options)
    assert found.grey is not None
    assert (len(found.grey.tones_chosen), len(found.grey.tones_rec709), found.sliders) == (256, 0, [])
    assert found.pairs and all(pair.default is None for pair in found.pairs)
    assert "minus Rec.709" not in (project / "report/index.html").read_text()
    assert found.lost_colour is not None and "Rec.709" not in found.lost_colour.in_words
    assert found.lost_colour.by_default is None
    assert found.citation == ""


def test_it_is_written_again_only_with_the_model(finished: Path, quick_options: MakeOptions) -> None:
    page = finished / "report/index.html"
    written = page.stat().st_mtime_ns
    reconstruct(finished, quick_options())
    assert page.stat().st_mtime_ns == written
    page.unlink()
    reconstruct(finished, quick_options())
    assert page.exists()


def test_report_writes_it_again(finished: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (finished / "report/index.html").unlink()
    file = finished / "report/summary.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"truth": {"rotation_error_deg": 0.0625}}))
    assert main(["report", str(finished), "--json"]) == 0
    page = Path(json.loads(capsys.readouterr().out)["page"])
    assert page == finished / "report/index.html"
    html = page.read_text()
    assert html.lower().startswith("<!doctype html>")
    assert "rotations 0.0625 degrees off" in html


def test_report_of_nothing_is_refused(new_project: Make, capsys: pytest.CaptureFixture[str]) -> None:
    project = new_project(2)
    assert main(["report", str(project)]) == 1
    assert "no photograph is converted yet" in capsys.readouterr().err
    assert not (project / "report").exists()


def test_what_was_left_out_is_told_with_its_reason(new_project: Make, quick_options: MakeOptions) -> None:
    project = new_project(5)
    (project / "images" / "torn & <b>.jpg").write_bytes(b"\xff\xd8\xff" + bytes(100))
    reconstruct(project, quick_options("dense.enabled=false"))
    html = (project / "report/index.html").read_text()
    assert "torn &amp; &lt;b&gt;.jpg" in html
    assert "torn & <b>" not in html
    found = contents_of(project, quick_options("dense.enabled=false"))
    (torn,) = [p for p in found.photographs if p.name.startswith("torn")]
    assert torn.left_out.startswith("cannot be read (")  # its name stands before it on the page
    assert torn.thumbnail is None
    assert found.cloud is not None
    assert found.cloud.kind == "sparse"


def test_a_page_that_fails_is_a_warning(
    finished: Path, quick_options: MakeOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise NativeError("no features today")

    (finished / "report/index.html").unlink()
    monkeypatch.setattr(pages, "write_page", fail)
    said: list[str] = []
    monkeypatch.setattr(type(SILENT), "warn", lambda _, text: said.append(text), raising=False)
    assert reconstruct(finished, quick_options()).summary["registered_images"] == 8
    assert said == ["no page was written: no features today"]
