"""Run the command line in this process or in one of its own, and take what it prints."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from small_demo import ROOT, SETTINGS

from colmap_ihe.cli import main

Captured = pytest.CaptureFixture[str]
COMMAND = (sys.executable, "-m", "colmap_ihe.cli")
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}
LONG = 120  # seconds; nothing here takes a tenth of it


def output_of(capsys: Captured, *arguments: str | Path) -> str:
    """stdout of a command that ends well."""
    status = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    assert status == 0, captured.err
    return captured.out


def json_of(capsys: Captured, *arguments: str | Path) -> Any:
    return json.loads(output_of(capsys, *arguments, "--json"))


def failure_of(capsys: Captured, *arguments: str | Path) -> str:
    """The one line that a command which fails leaves on stderr besides its progress."""
    status = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    assert status == 1
    assert captured.out == ""
    assert "Traceback" not in captured.err
    last = captured.err.splitlines()[-1]
    assert last.startswith("colmap-ihe: ")
    assert sum(line.startswith("colmap-ihe: ") for line in captured.err.splitlines()) == 1
    return last


def run(
    *arguments: str | Path, stdout: Any = subprocess.PIPE, **environment: str
) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    command, pipe = [*COMMAND, *map(str, arguments)], subprocess.PIPE
    environment = ENVIRONMENT | environment
    return subprocess.run(
        command, stdout=stdout, stderr=pipe, text=True, env=environment, timeout=LONG, check=False
    )


@contextmanager
def started(
    command: str, *more: str | Path, environment: Mapping[str, str] | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A command with the options of the small demo, whose result is JSON; it does not outlive the test."""
    with subprocess.Popen(
        [*COMMAND, command, "--json", *SETTINGS, *map(str, more)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=ENVIRONMENT | dict(environment or {}),
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_until_begun(process: subprocess.Popen[str], project: Path, stage: str) -> None:
    begun, end = project / "records" / f"{stage}.begun.json", time.monotonic() + LONG
    while not begun.exists():
        assert process.poll() is None, f"it ended before {stage}: {process.communicate()}"
        assert time.monotonic() < end
        time.sleep(0.002)
