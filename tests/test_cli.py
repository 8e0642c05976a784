"""The command as a process: exit statuses, signals, and pipes that close."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Captured, run
from PIL import Image

from colmap_ihe.cli import main
from colmap_ihe.commandline import commands


def fail_with(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(*_: object) -> dict[str, Any]:
        raise error

    monkeypatch.setattr(commands, "doctor", fail)


def test_an_unforeseen_error_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bug is a bug: hiding it in one line would help nobody."""
    fail_with(monkeypatch, RuntimeError("a bug"))
    with pytest.raises(RuntimeError, match="a bug"):
        main(["doctor"])


def test_ctrl_c_exits_with_130(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    fail_with(monkeypatch, KeyboardInterrupt())
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "colmap-ihe: stopped; the same command goes on from here\n"


def test_the_command_as_a_process(small_demo: Path, tmp_path: Path) -> None:
    done = run("fit", small_demo / "images/portico_01.jpg", "--step", "0.1", "--json")
    assert done.returncode == 0
    assert len(json.loads(done.stdout)["weights"]) == 3
    failed = run("fit", tmp_path / "missing")
    assert failed.returncode == 1
    assert (failed.stdout, len(failed.stderr.splitlines())) == ("", 1)
    assert run("fit").returncode == 2


def test_a_broken_tiff_leaves_no_warnings_of_libraries(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (80, 80, 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "whole.png")
    Image.fromarray(noise).save(tmp_path / "half.tif", compression="tiff_lzw")
    whole = (tmp_path / "half.tif").read_bytes()
    (tmp_path / "half.tif").write_bytes(whole[: len(whole) // 2])
    done = run("fit", tmp_path, "--step", "0.1", "--json", "-q")
    assert done.returncode == 0
    assert list(json.loads(done.stdout)["left_out"]) == ["half.tif"]
    assert "Warning:" not in done.stderr
    assert "site-packages" not in done.stderr


def test_a_terminal_without_a_character_shows_its_code(tmp_path: Path) -> None:
    """The summary has plus-minus signs, and names of files may have any."""
    images, out = tmp_path / "images", tmp_path / "caf\u00e9"
    images.mkdir()
    Image.fromarray(np.random.default_rng(1).integers(0, 256, (80, 80, 3), np.uint8)).save(
        images / "whole.png"
    )
    done = run("convert", images, out, "--method", "green", "-q", PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("1 grey images in ") and "caf\\xe9 (green" in done.stdout


@pytest.mark.parametrize("unbuffered", ["1", ""])
def test_a_pipe_that_closes_early_is_no_error(unbuffered: str) -> None:
    """As `colmap-ihe doctor | head`. Python writes at once where it is told to, else as it ends."""
    reader = subprocess.Popen(["true"], stdin=subprocess.PIPE)
    assert reader.stdin is not None
    try:
        reader.wait(60)
        done = run("doctor", "--json", stdout=reader.stdin, PYTHONUNBUFFERED=unbuffered)
    finally:
        reader.stdin.close()
    assert done.stderr == ""
    assert done.returncode == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full to write to")
def test_results_that_find_no_room_are_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = run("doctor", "--json", stdout=full)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
