"""Batches of real projects, in processes that crash, are stopped and are killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest
from command_line import started, wait_until_begun
from small_demo import QUICK, ROOT, Make

from colmap_ihe.batch.preview import preview_project
from colmap_ihe.project.folder import Project


def make_root(new_project: Make, *names: str) -> Path:
    for name in names:
        root = new_project(name=f"root/{name}").parent
    return root


def crash_in(tmp_path: Path, stage: str, project: str) -> dict[str, str]:
    """An environment in which the run of one project has a real segmentation fault soon after `stage` began."""
    (tmp_path / "hook").mkdir()
    (tmp_path / "hook/sitecustomize.py").write_text(
        "import ctypes, os, sys, threading, time\n"
        "def wait(file):\n"
        "    while not os.path.exists(file): time.sleep(0.002)\n"
        "    time.sleep(0.1)\n"  # it is told just after the file is there
        "    ctypes.string_at(0)\n"
        "said = ' '.join(sys.orig_argv)\n"
        f"if 'job_main' in said and '/{project}\"' in said:\n"
        f"    file = said.split('\"root\": \"')[1].split('\"')[0] + '/records/{stage}.begun.json'\n"
        "    threading.Thread(target=wait, args=(file,), daemon=True).start()\n"
    )
    return {"PYTHONPATH": f"{tmp_path / 'hook'}{os.pathsep}{ROOT}"}


def assert_nothing_half_written(root: Path) -> None:
    endings = (".tmp", ".part.ply", "unfinished.db")
    assert not [p for p in root.rglob("*") if p.name.endswith(endings)]


def ended(process: subprocess.Popen[str]) -> tuple[int, dict[str, Any], str]:
    output, errors = process.communicate(timeout=400)
    return process.returncode, json.loads(output) if output else {}, errors


def test_one_good_one_broken_one_crashing(new_project: Make, tmp_path: Path) -> None:
    """The same command then runs what is missing, and nothing else."""
    root = make_root(new_project, "broken", "crashing", "good")
    (root / "broken/project.yaml").write_text("fit:\n  steps: 1\n")
    crashing = crash_in(tmp_path, "features", "crashing")
    with started("batch", root, "--no-dense", environment=crashing) as process:
        status, result, errors = ended(process)
    assert status == 1
    by_name = {p["name"]: p for p in result["projects"]}
    states = {name: p["state"] for name, p in by_name.items()}
    assert states == {"broken": "failed", "crashing": "crashed", "good": "done"}
    assert by_name["crashing"]["reason"] == "crashed in features (SIGSEGV)"
    assert "unknown option 'fit.steps'" in by_name["broken"]["reason"]
    assert by_name["crashing"]["hint"] and by_name["broken"]["hint"]
    assert by_name["good"]["registered_images"] == 8
    assert (root / "batch" / by_name["good"]["page"]).resolve() == root / "good/report/index.html"
    assert "good  begun" in errors and "Traceback" not in errors
    assert preview_project(root / "good", [*QUICK, "dense.enabled=false"]).up_to_date
    assert not preview_project(root / "good", QUICK).up_to_date

    (root / "broken/project.yaml").unlink()
    kept = {p: p.stat().st_mtime_ns for p in (root / "good/records").glob("*.json")}
    kept |= {p: p.stat().st_mtime_ns for p in [root / "crashing/records/convert.json"]}
    with started("batch", root, "--no-dense") as process:
        status, result, errors = ended(process)
    assert status == 0 and result["counts"] == {"done": 3} and "good  begun" not in errors
    assert kept == {p: p.stat().st_mtime_ns for p in kept}
    assert_nothing_half_written(root)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_stopped_or_killed_the_same_command_goes_on(new_project: Make, number: int) -> None:
    root = make_root(new_project, "a", "b", "c")
    with started("batch", root, "--no-dense") as process:
        wait_until_begun(process, root / "a", "features")
        process.send_signal(number)
        status, _, errors = ended(process)
    if number == signal.SIGKILL:
        assert status == -signal.SIGKILL
    else:
        assert status == 130
        assert errors.splitlines()[-1] == "colmap-ihe: stopped; the same command goes on from here"
        assert json.loads((root / "batch/batch.json").read_text())["state"] == "stopped"
        assert not list((root / "batch").glob("stop-*"))
        with Project.at(root / "a").locked():  # its run has ended with it
            pass
    before = (root / "a/records/convert.json").stat().st_mtime_ns
    with started("batch", root, "--no-dense") as process:
        status, result, errors = ended(process)
    assert status == 0, errors
    assert result["counts"] == {"done": 3}
    assert (root / "a/records/convert.json").stat().st_mtime_ns == before
    assert_nothing_half_written(root)


@pytest.mark.slow
def test_two_batches_in_one_folder_do_not_mix(new_project: Make) -> None:
    root = make_root(new_project, "a", "b", "c")
    words = ("batch", root, "--no-dense", "--jobs", "1")
    with started(*words) as first, started(*words) as second:
        results = [ended(first), ended(second)]
    for _, result, errors in results:
        assert {p["state"] for p in result["projects"]} <= {"done", "busy"}, errors
    with started("batch", root, "--no-dense") as process:
        status, result, errors = ended(process)
    assert (status, result["counts"]) == (0, {"done": 3})
    assert " begun" not in errors
    assert_nothing_half_written(root)
