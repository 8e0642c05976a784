"""The page of a batch: what needs its reader comes first, names stay text, and it fits a phone."""

from __future__ import annotations

import base64
import dataclasses
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from batch_contents import contents, thumbnail
from html_elements import HOSTILE, Elements

from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.batch.state import BatchState, Phase, ProjectState, facts_of, project_state, publish
from colmap_ihe.machine.files import write_json
from colmap_ihe.project.folder import Project
from colmap_ihe.report.page import render_batch

if TYPE_CHECKING:
    from playwright.sync_api import Browser

FIGURES = {
    "images": 9, "registered_images": 8, "mean_reprojection_error_px": 0.4567,
    "points3D": 12345, "dense_points": 2345678, "mesh_faces": None,
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> BatchFolder:
    for name in ("arch", "b%20c?d#e"):
        (tmp_path / "root" / name / "images").mkdir(parents=True)
        (tmp_path / "root" / name / "report").mkdir()
        (tmp_path / "root" / name / "report/index.html").write_text("<title>its own</title>")
    folder = BatchFolder.at(tmp_path / "root")
    folder.make()
    return folder


def state(folder: BatchFolder, phase: Phase = "finished") -> BatchState:
    shown = [project_state(folder, Project.at(root), "done") for root in folder.projects(pytest.fail)]
    began = "2026-01-01T00:00:00+00:00"
    return BatchState(str(folder.root), phase, shown, began, 90.0, "colmap-ihe batch root")


def test_what_needs_its_reader_comes_first() -> None:
    html = render_batch(contents())
    assert [re.sub("<.*?>", "", h) for h in re.findall("<h[123].*?</h[123]>", html)] == [
        "campaign: 4 projects",
        "What needs you",
        "chapel crashed",
        "The others",
        "arch done",
        "bridge running: dense 3 of 14",
        "dome waiting",
    ]
    elements = Elements(html)
    assert [a["href"] for t, a in elements.tags if t == "a"][-2:] == ["../c/batch.log", "../a/index.html"]
    assert all(a.get("alt") for t, a in elements.tags if t == "img")


def test_it_is_shown_anew_while_it_changes() -> None:
    for again_s in (None, 10):
        tags = Elements(render_batch(contents(again_s=again_s))).tags
        refresh = [a["content"] for t, a in tags if t == "meta" and a.get("http-equiv") == "refresh"]
        assert refresh == ([] if again_s is None else ["10"])


def test_a_batch_of_nothing_says_so() -> None:
    html = render_batch(dataclasses.replace(contents(), rows=[]))
    assert "There is no project yet" in html and "What needs you" not in html


def test_figures_are_as_a_person_reads_them() -> None:
    one = ProjectState("a", "done", figures=FIGURES, left_out=1, stages={"fit": 60.0, "dense": 90.0})
    assert facts_of(one) == [
        ("registered images", "8 of 9"),
        ("mean reprojection error", "0.46 px"),
        ("points", "12,345"),
        ("dense points", "2,345,678"),
        ("left out", "1"),
        ("time", "2 min 30 s"),
    ]
    metric = dataclasses.replace(one, figures=FIGURES | {"check_rms_mm": 2.59}, metric_by="control_points")
    assert facts_of(metric)[2:4] == [("metres by", "control points"), ("check points", "2.6 mm RMS")]
    assert facts_of(dataclasses.replace(one, metric_by="magic")) == facts_of(one)
    assert facts_of(ProjectState("a", "waiting", photographs=7)) == [("photographs", "7")]
    assert facts_of(ProjectState("a", "waiting")) == []


def test_json_has_what_the_records_say(folder: BatchFolder) -> None:
    project = Project.at(folder.root / "arch")
    more = {"stages": {"fit": 2.0}, "warnings": ["w"], "left_out": {"a": "why"}}
    write_json(project.summary_file, FIGURES | more)
    write_json(project.batch_record, {"seconds": 3.5, "peak_memory_gb": 1.25, "began": "b", "ended": "e"})
    found = state(folder).as_dict()
    assert (found["state"], found["counts"], found["remaining_s"]) == ("finished", {"done": 2}, 90)
    arch, other = found["projects"]
    assert {name: arch[name] for name in FIGURES} == FIGURES
    assert (arch["seconds"], arch["peak_memory_gb"], arch["stages"]) == (3.5, 1.25, {"fit": 2.0})
    assert (arch["left_out"], arch["warnings"], arch["page"]) == (1, 1, "../arch/report/index.html")
    assert (other["registered_images"], other["seconds"], other["stages"]) == (None, None, {})
    assert "about 90 s left" in state(folder, "running").in_words()
    assert "watching for more" in dataclasses.replace(state(folder, "watching"), remaining_s=None).in_words()


def test_a_finished_project_is_shown_by_its_model(folder: BatchFolder) -> None:
    project = Project.at(folder.root / "arch")
    jpeg = thumbnail().jpeg
    project.picture_file.write_bytes(jpeg)
    Project.at(folder.root / "b%20c?d#e").picture_file.write_bytes(b"no picture")
    publish(folder, state(folder), {"b%20c?d#e": thumbnail("a photograph")})
    shown = {a["alt"]: a["src"] for tag, a in Elements(folder.page_file.read_text()).tags if tag == "img"}
    assert set(shown) == {"the model of arch", "a photograph"}
    assert (shown["the model of arch"] or "").endswith(base64.b64encode(jpeg).decode())


def test_a_name_that_is_not_utf8_can_be_written(folder: BatchFolder) -> None:
    (folder.root / "caf\udce9/images").mkdir(parents=True)
    publish(folder, state(folder), {})
    assert "caf?" in folder.json_file.read_text(encoding="utf-8")
    assert "caf\\udce9" in folder.page_file.read_text(encoding="utf-8")


def test_in_a_browser(browser: Browser, folder: BatchFolder, tmp_path: Path) -> None:
    file = tmp_path / "page.html"
    file.write_text(render_batch(contents(HOSTILE)), encoding="utf-8")
    page = browser.new_page(viewport={"width": 360, "height": 740})
    said: list[str] = []
    page.on("dialog", lambda dialog: said.append(dialog.message))
    page.on("console", lambda m: said.append(m.text) if m.type == "error" else None)
    page.goto(file.as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    assert page.locator("h3").count() == 4 and not said
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        ink, paper = page.evaluate("(s => [s.color, s.backgroundColor])(getComputedStyle(document.body))")
        assert (sum(map(int, re.findall(r"\d+", ink))) < 300) == (scheme == "light")
        assert (sum(map(int, re.findall(r"\d+", paper))) > 600) == (scheme == "light")
    page.emulate_media(media="print")
    assert not page.locator("nav").is_visible() and page.locator(".why").is_visible()

    publish(folder, state(folder), {})
    page.emulate_media(media="screen")
    page.goto(folder.page_file.as_uri())
    page.locator("h3 a", has_text="b%20c?d#e").click()
    assert page.title() == "its own"
    page.close()
