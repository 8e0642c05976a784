"""Parsers of what we wrote ourselves, and somebody may have changed; and what is built on names of files."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_mutations import BYTES, JSON, TEXT, Target

import colmap_ihe  # noqa: F401  before pycolmap
from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.batch.state import BatchState, project_state, publish
from colmap_ihe.dense.ply import read_mesh
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.input_digests import digests_of
from colmap_ihe.pipeline.output_folder import RECORD, Ledger
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.run_context import RunContext
from colmap_ihe.pipeline.stages import STAGE_NAMES, STAGES
from colmap_ihe.pipeline.stages.fit import fit_of
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.report.contents import Contents, PhotographEntry
from colmap_ihe.report.page import render_page
from colmap_ihe.report.summary import summarise, summary_rows


def records() -> dict[str, dict[str, Any]]:
    """Of a small project, as a run leaves them."""
    whole: dict[str, Any] = {
        "fingerprint": "0",
        "seconds": 1.5,
        "options": {},
        "versions": {},
        "warnings": [],
    }
    weights = {
        "method": "ihe",
        "weights": [0.2, 0.3, 0.5],
        "score": 0.1,
        "tones": 200,
        "images": 2,
        "encoding": "coded",
    }
    tried = {
        "chosen": "ihe",
        "in_words": "3 % more",
        "pairs": [["a.jpg", "b.jpg"]],
        "candidates": {},
        "reason": "",
    }
    model = {"registered_images": 2, "points3d": 9, "points_over_3_views": 3, "mean_track_length": 2.5}
    return {
        "captures": whole
        | {"images": 2, "raw": 0, "paired": {}, "with_gps": 0, "shared_by": 2, "pixels": 99, "largest": 50}
        | {"development": {}, "recipes": {"a.jpg": {"denoise": 1.0, "dark": "d.npy"}}, "ignored": [], "left_out": {}},
        "fit": whole | {"weights": {"coded": weights}, "colour_white": 1.0, "tried": {"coded": tried}, "left_out": {}},
        "convert": whole | {"grey": {"a.jpg": "a.png", "b/c.jpg": "b/c.png"}, "left_out": {}},
        "features": whole | {"images": 2, "cameras": 1, "with_focal_prior": 2, "features": 99, "missing": []},
        "matches": whole | {"strategy": "exhaustive", "pairs_verified": 1, "inliers": 20, "pairs_matched": 1},
        "sparse": whole
        | {"models": [model | {"mean_reprojection_error_px": 0.5, "image_names": ["a.png"]}], "unregistered": []},
        "dense": whole | {"points": 99, "backend": "sgm", "pixels": 100, "pixels_with_depth": 60},
        "mesh": whole | {"files": ["mesh.ply"], "faces": 9, "texture": {"width": 9, "height": 9}},
    }  # fmt: skip


def _record_samples() -> list[bytes]:
    return [json.dumps({"stage": name, **record}).encode() for name, record in records().items()]


def _record(data: bytes, folder: Path) -> object:
    """The record of one stage, spoilt, among sound ones: what a run would build on them."""
    (folder / "images").mkdir()
    (folder / "records").mkdir()
    place = Project(folder, folder / "images")
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
    json.dumps(summary).encode("utf-8", "surrogatepass")
    RunContext(place, Options(), _DISCOVERY, None, found).captures()  # type: ignore[arg-type]
    return fit_of(found["fit"]) if "fit" in found else summary


def _digests(data: bytes, folder: Path) -> object:
    for name in ("images", "records"):
        (folder / name).mkdir()
    (folder / "images/a.jpg").write_bytes(b"x")
    (folder / "records/digests.json").write_bytes(data)
    project = Project(folder, folder / "images")
    with local_executor() as executor:
        found = digests_of(project, discover(project.images), executor, SILENT)
    assert len(found["a.jpg"]) == 6 and isinstance(found["a.jpg"][-1], str)
    return found


def _summary_samples() -> list[bytes]:
    found = summarise(records(), Options())
    return [
        json.dumps(found | {"state": "done", "seconds": 3.0, "reason": "", "hint": "", "set": []}).encode()
    ]


def _batched(data: bytes, folder: Path) -> object:
    for name in ("images", "records", "report"):
        (folder / "a" / name).mkdir(parents=True)
    (folder / "a/report/summary.json").write_bytes(data)
    (folder / "a/records/batch.json").write_bytes(data)
    place = BatchFolder.at(folder)
    row = project_state(place, Project(folder / "a", folder / "a/images"), "done")
    publish(place, BatchState(str(folder), "finished", [row], "now"), {})
    return row


def _ledger_samples() -> list[bytes]:
    file = {"photograph": "a.jpg", "fingerprint": "0", "digest": ""}
    fit = {"fingerprint": "0", "weights": [{"weights": [0.2, 0.3, 0.5]}], "colour_white": 1.0, "left_out": {}}
    return [json.dumps({"files": {"a.png": file, "b/c.png": file}, "notes": {"fit": fit}}).encode()]


def _ledger(data: bytes, folder: Path) -> object:
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


def _ply_samples() -> list[bytes]:
    from colmap_ihe.dense.ply import write_mesh
    from colmap_ihe.dense.texture.mesh import Mesh

    path = Path(f"sample-{os.getpid()}.ply")
    try:
        write_mesh(
            path,
            Mesh(
                np.eye(4, 3, dtype=np.float32),
                np.array([[0, 1, 2], [1, 2, 3]], np.int32),
                np.zeros((4, 3), np.uint8),
            ),
        )
        return [path.read_bytes()]
    finally:
        path.unlink()


def _ply(data: bytes, folder: Path) -> object:
    (folder / "a.ply").write_bytes(data)
    mesh = read_mesh(folder / "a.ply")
    assert not len(mesh.faces) or 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
    return mesh


def _name_samples() -> list[bytes]:
    return [
        b"IMG 1.JPG",
        "façade nord/Été 01.jpg".encode(),
        b"a.nef\na.jpg\na.tif",
        b"x/.hidden.jpg",
        b"- rf.png",
    ]


def _page(title: str, photographs: Sequence[PhotographEntry]) -> str:
    return render_page(Contents(title=title, result="", rows=[], grey=None, photographs=photographs))


def _names(data: bytes, folder: Path) -> object:
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


TARGETS = (
    Target("records", _record_samples, JSON, _record),
    Target(
        "digests.json",
        lambda: [json.dumps({"a.jpg": [1, 1, 1, 1, 1, "00"]}).encode()],
        JSON,
        _digests,
        share=0.5,
    ),
    Target("summary.json, batch.json", _summary_samples, JSON, _batched, share=0.3),
    Target("record of grey images", _ledger_samples, JSON, _ledger, share=0.5),
    Target("PLY", _ply_samples, (*BYTES, *TEXT), _ply),
    Target("file names", _name_samples, TEXT, _names, share=0.3),
)
