"""Add a stage to a copy of the package: it takes one new file and lines in two others."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from small_demo import QUICK

import colmap_ihe

STAGE = '''
"""Write how many images the model has."""

from pathlib import Path

from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, StageNeeds
from colmap_ihe.pipeline.stage import Count, Stage, StageRecord


class OutlineRecord(StageRecord):
    lines: Count


def run(run, progress):
    images = run.records["sparse"]["models"][0]["registered_images"]
    progress.start(images)
    file(run.project).write_text(run.options.outline.word * images)
    return OutlineRecord(lines=images, warnings=["outlines are drawn by hand"])


def file(project) -> Path:
    return project.workspace / "outline.txt"


STAGE = Stage(
    "outline",
    run,
    OutlineRecord,
    sections=("outline",),
    switched_off=lambda options: "" if options.outline.enabled else "outline",
    files=lambda project, record: [file(project)],
    made=lambda project: [file(project)],
    needs=lambda options, size: StageNeeds("outline", BASE_BYTES, 0, 1000),
    parts=lambda options, known: [Part("outline", "images", 0.1)],
)
'''
SECTION = """class OutlineOptions(Section):
    enabled: bool = True
    word: str = "line"


class Options("""


def insert(file: Path, *changes: tuple[str, str]) -> None:
    text = file.read_text(encoding="utf-8")
    for before, after in changes:
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    file.write_text(text, encoding="utf-8")


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package with the new stage: one file more, two files changed."""
    copy = tmp_path / "package/colmap_ihe"
    shutil.copytree(Path(colmap_ihe.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__"))
    (copy / "pipeline/stages/outline.py").write_text(STAGE, encoding="utf-8")
    insert(
        copy / "pipeline/stages/__init__.py",
        ("    mesh,\n", "    mesh,\n    outline,\n"),
        ("    mesh.STAGE,\n", "    mesh.STAGE,\n    outline.STAGE,\n"),
    )
    insert(
        copy / "project/options.py",
        ("class Options(", SECTION),
        (
            "    mesh: MeshOptions = MeshOptions()\n",
            "    mesh: MeshOptions = MeshOptions()\n    outline: OutlineOptions = OutlineOptions()\n",
        ),
    )
    return copy.parent


def test_a_stage_more_is_run_resumed_and_told(package: Path, finished: Path) -> None:
    def told(command: str, *more: str) -> Any:
        settings = [word for assignment in (*QUICK, *more) for word in ("--set", assignment)]
        done = subprocess.run(
            [sys.executable, "-m", "colmap_ihe.cli", command, str(finished), "--json", *settings],
            cwd=package,
            env=os.environ | {"PYTHONPATH": str(package)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def states(*more: str) -> dict[str, tuple[str, str]]:
        return {stage["name"]: (stage["state"], stage["why"]) for stage in told("status", *more)}

    outline = finished / "workspace/outline.txt"
    assert states()["outline"] == ("to do", "")
    summary = told("reconstruct")
    assert (outline.read_text(), "outline" in summary["stages"]) == ("line" * 8, True)
    assert "outlines are drawn by hand" in summary["warnings"]
    assert states() == dict.fromkeys(states(), ("done", ""))
    assert "outline.word from line to dot" in states("outline.word=dot")["outline"][1]
    assert states("outline.enabled=false")["outline"] == ("off", "outline.enabled is false")
    outline.unlink()
    assert states()["outline"] == ("stale", "outline.txt is gone")
    outline.write_text("drawn by somebody")
    assert told("doctor")["outline_will_take"]
    told("reconstruct")
    assert outline.read_text() == "line" * 8
