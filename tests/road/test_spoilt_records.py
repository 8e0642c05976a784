"""What we wrote ourselves, spoilt, and what is built on names of files."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from spoilt import BYTES, JSON, TEXT, parser
from stage_records import records

from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.batch.state import BatchState, project_state, publish
from colmap_ihe.dense.ply import read_mesh, write_mesh
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.input_digests import digests_of
from colmap_ihe.pipeline.output_folder import RECORD, Ledger
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.stage import RunContext
from colmap_ihe.pipeline.stages import STAGE_NAMES, STAGES
from colmap_ihe.pipeline.stages.fit import fit_of
from colmap_ihe.pipeline.summary import summarise
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.report.cameras import cameras_table, lens_charts
from colmap_ihe.report.contents import Contents, PhotographEntry
from colmap_ihe.report.page import render_page
from colmap_ihe.report.tables import summary_rows


def _project(folder: Path) -> Project:
    for name in ("images", "records", "report"):
        (folder / name).mkdir(parents=True)
    return Project(folder, folder / "images")


def stage_records(_: Path) -> list[bytes]:
    return [json.dumps({"stage": name, **record}).encode() for name, record in records().items()]


@parser(stage_records, JSON)
def test_stage_records(data: bytes, folder: Path) -> object:
    """The record of one stage, spoilt, among sound ones: what a run would build on them."""
    place = _project(folder)
    spoilt = next(
        (name for name in STAGE_NAMES if f'"stage": "{name}"'.encode() in data[:400]),
        STAGE_NAMES[len(data) % len(STAGE_NAMES)],
    )
    found: dict[str, dict[str, Any]] = {}
    for name, sound in records().items():
        place.record_file(name).write_bytes(data if name == spoilt else json.dumps(sound).encode())
        record = read_record(place, name)
        if record is None:
            break
        stage = STAGES[STAGE_NAMES.index(name)]
        for gone in outputs.missing(stage, place, record):
            assert gone.is_relative_to(folder) and ".." not in gone.parts, f"{gone} lies elsewhere"
        found[name] = record
    if "captures" not in found:
        return None
    summary = summarise(found, Options())
    summary_rows(summary)
    cameras_table(summary["cameras"] or ())
    lens_charts(summary["cameras"] or ())
    json.dumps(summary).encode("utf-8", "surrogatepass")
    RunContext(place, Options(), _DISCOVERY, None, records=found).captures()  # type: ignore[arg-type]
    return fit_of(found["fit"]) if "fit" in found else summary


@parser(lambda _: [json.dumps({"a.jpg": [1, 1, 1, 1, 1, "00"]}).encode()], JSON, share=0.5)
def test_digests(data: bytes, folder: Path) -> object:
    project = _project(folder)
    (folder / "images/a.jpg").write_bytes(b"x")
    (folder / "records/digests.json").write_bytes(data)
    with local_executor() as executor:
        found = digests_of(project, discover(project.images), executor, SILENT)
    assert len(found["a.jpg"]) == 6 and isinstance(found["a.jpg"][-1], str)
    return found


def summaries(_: Path) -> list[bytes]:
    ended = {"state": "done", "seconds": 3.0, "reason": "", "hint": "", "set": []}
    sound = summarise(records(), Options()) | ended
    words = {"mean_reprojection_error_px": "small", "points3D": [1], "stages": {"fit": "long"}, "left_out": 3}
    return [
        json.dumps(values).encode() for values in (sound, sound | words | {"seconds": "many", "began": 5})
    ]


@parser(summaries, JSON, share=0.3)
def test_summary_and_batch_json(data: bytes, folder: Path) -> object:
    project = _project(folder / "a")
    (folder / "a/report/summary.json").write_bytes(data)
    (folder / "a/records/batch.json").write_bytes(data)
    place = BatchFolder.at(folder)
    row = project_state(place, project, "done")
    publish(place, BatchState(str(folder), "finished", [row], "now"), {})
    numbers = [*row.figures.values(), *row.stages.values()]
    assert all(value is None or isinstance(value, int | float) for value in numbers)
    return row


def folder_records(_: Path) -> list[bytes]:
    file = {"photograph": "a.jpg", "fingerprint": "0", "digest": ""}
    fit = {"fingerprint": "0", "weights": [{"weights": [0.2, 0.3, 0.5]}], "colour_white": 1.0, "left_out": {}}
    return [json.dumps({"files": {"a.png": file, "b/c.png": file}, "notes": {"fit": fit}}).encode()]


@parser(folder_records, JSON, share=0.5)
def test_record_of_a_folder(data: bytes, folder: Path) -> object:
    out, outside = folder / "out", folder / "mine"
    out.mkdir()
    outside.mkdir()
    (outside / "up").write_text("mine")
    (folder / "up").write_text("mine")
    (out / "link").symlink_to(outside)
    (out / RECORD).write_bytes(data)
    ledger = Ledger(out)
    ledger.refuse({"z.png": "z.jpg"})
    ledger.begin({"z.png": "z.jpg"}, {"z.png": "1"})
    assert (outside / "up").exists() and (folder / "up").exists()
    return ledger


_DISCOVERY = type("None", (), {"captures": (Capture("a.jpg", Path("a.jpg"), "coded", "a"),)})()


def meshes(folder: Path) -> list[bytes]:
    faces, grey = np.array([[0, 1, 2], [1, 2, 3]], np.int32), np.zeros((4, 3), np.uint8)
    write_mesh(folder / "a.ply", Mesh(np.eye(4, 3, dtype=np.float32), faces, grey))
    whole = (folder / "a.ply").read_bytes()
    no_such_corner = whole[:-4] + (99).to_bytes(4, "little")
    four_corners = whole[:-13] + b"\4" + whole[-12:]
    return [whole, no_such_corner, four_corners]


@parser(meshes, (*BYTES, *TEXT))
def test_ply(data: bytes, folder: Path) -> object:
    (folder / "a.ply").write_bytes(data)
    mesh = read_mesh(folder / "a.ply")
    assert not len(mesh.faces) or 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
    return mesh


def file_names(_: Path) -> list[bytes]:
    names = ("IMG 1.JPG", "façade nord/Été 01.jpg", "a.nef\na.jpg\na.tif", "x/.hidden.jpg", "- rf.png")
    return [name.encode() for name in names]


def _page(title: str, photographs: Sequence[PhotographEntry]) -> str:
    return render_page(Contents(title=title, result="", rows=[], grey=None, photographs=photographs))


@parser(file_names, TEXT, share=0.3)
def test_file_names(data: bytes, folder: Path) -> object:
    """A name a line, each of a file; discovered, and shown on a page."""
    images = folder / "images"
    images.mkdir()
    for line in data.split(b"\n")[:20]:
        path = Path(os.fsdecode(bytes(images) + b"/" + line.replace(b"\0", b"_").lstrip(b"/")))
        if ".." in path.parts:
            continue
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
        except OSError:
            continue
    found = discover(images)
    for capture in found.captures:
        assert ".." not in Path(capture.grey_stem).parts and not Path(capture.grey_stem).is_absolute()
    shown = [PhotographEntry(capture.name, None, left_out="why") for capture in found.captures]
    html = _page(str(data[:80]), shown)
    assert html.count("<script") == _SCRIPTS
    return found


_SCRIPTS = _page("a", ()).count("<script")
