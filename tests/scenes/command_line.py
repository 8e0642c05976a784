"""Run the command line in this process or in one of its own, and take what it prints."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from small_demo import QUICK, ROOT

from colmap_ihe.cli import main

Captured = pytest.CaptureFixture[str]
SETTINGS = [part for assignment in QUICK for part in ("--set", assignment)]
"""Options with which the small demo is reconstructed quickly, as arguments."""


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


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "colmap_ihe.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        timeout=120,
        check=False,
    )
