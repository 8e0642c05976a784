"""Killed in the middle of a stage, the same command goes on: a model as good, nothing finished run again."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from pathlib import Path

import pytest
from command_line import LONG, started, wait_until_begun
from small_demo import Make

from colmap_ihe.pipeline.stages import STAGE_NAMES


def kill_in(project: Path, stage: str, delay: float, number: int = signal.SIGKILL) -> tuple[int, str]:
    """Exit status and stderr of a run that got the signal `delay` seconds into `stage`."""
    with started("reconstruct", project) as process:
        wait_until_begun(process, project, stage)
        time.sleep(delay)
        if number == signal.SIGINT:  # as Ctrl-C in a terminal, which all processes there get
            os.killpg(process.pid, number)
        else:
            process.send_signal(number)
        _, errors = process.communicate(timeout=LONG)
        return process.returncode, errors


def assert_goes_on(project: Path, stage: str) -> None:
    """The same command ends well; the stages before `stage` are those of the run that was interrupted."""
    before = STAGE_NAMES[: STAGE_NAMES.index(stage)]
    times = {name: (project / "records" / f"{name}.json").stat().st_mtime_ns for name in before}
    with started("reconstruct", project) as process:
        output, errors = process.communicate(timeout=LONG)
    assert process.returncode == 0, errors
    assert {name: (project / "records" / f"{name}.json").stat().st_mtime_ns for name in before} == times
    for name in before:
        assert f"{name}  up to date" in errors
    summary = json.loads(output)
    assert summary["registered_images"] == 8
    assert 0.05 < summary["mean_reprojection_error_px"] < 1
    assert summary["points3D"] > 300
    assert summary["dense_points"] > 15_000


@pytest.mark.parametrize(
    ("stage", "seed"),
    [
        ("matches", 0),  # it shares its database with the stage before it
        *(pytest.param(s, n, marks=pytest.mark.slow) for s in STAGE_NAMES for n in (1, 2)),
    ],
)
def test_killed_in_a_stage(new_project: Make, stage: str, seed: int) -> None:
    project = new_project()
    longest = {"fit": 0.3, "features": 0.6, "matches": 0.3, "sparse": 0.3, "dense": 1.5}.get(stage, 0.02)
    delay = random.Random(f"{stage}{seed}").uniform(0, longest)
    status, _ = kill_in(project, stage, delay)
    assert status == -signal.SIGKILL
    assert_goes_on(project, stage)


@pytest.mark.slow
def test_killed_again_and_again(new_project: Make) -> None:
    project = new_project()
    for stage in ("fit", "features", "matches", "sparse", "dense", "dense"):
        kill_in(project, stage, 0.15)
    assert_goes_on(project, "dense")


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_stopped_by_hand(new_project: Make, number: int) -> None:
    project = new_project()
    status, errors = kill_in(project, "features", 0.1, number)
    assert status == 130
    assert errors.splitlines()[-1] == "colmap-ihe: stopped; the same command goes on from here"
    assert "Traceback" not in errors
    assert (project / "records/convert.json").exists()
    assert not (project / "records/features.json").exists()
    with started("reconstruct", project, "--until", "features") as process:
        process.communicate(timeout=LONG)
    assert process.returncode == 0
