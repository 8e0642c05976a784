"""What a run and a batch show: bars, lines, JSON, and nothing that steers the terminal."""

from __future__ import annotations

import json
import re

import pytest
from command_line import Captured, run
from small_demo import SETTINGS, Make

from colmap_ihe.batch.state import BatchState, Phase, ProjectState, State
from colmap_ihe.cli import main
from colmap_ihe.commandline.bars import Terminal, batch_picture, left_in_words, print_table
from colmap_ihe.commandline.display import Display, printable
from colmap_ihe.commandline.json_lines import JsonLines
from colmap_ihe.errors import Cancelled
from colmap_ihe.pipeline.stages import STAGE_NAMES


def work(display: Display) -> None:
    with display.stage("matches") as progress:
        progress.start(4, "pairs")
        for _ in range(4):
            progress.advance()
    display.kept("sparse")


def batch_of(state: State, phase: Phase = "running") -> BatchState:
    project = ProjectState("arch", state, reason="crashed in dense" if state == "crashed" else "")
    return BatchState("root", phase, [project], "2026-01-01T00:00:00+00:00")


def test_names_show_as_they_are_and_steer_nothing() -> None:
    name = "10.00\u202fAM 写真\u30001 می\u200cخواهم.jpg"
    assert printable(name) == name
    assert printable("a\x1b[31m\u202eb\udcff\n") == "a\\x1b[31m\\u202eb\\udcff "


def test_a_terminal_has_bars(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    display = Display(Terminal())
    work(display)
    Terminal().console.print(batch_picture(batch_of("running")))
    display.show(batch_of("crashed", "finished"))
    text = re.sub("\x1b\\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().err)
    assert re.search("matches.*4/4.*pairs", text) and "━" in text
    assert "sparse  up to date" in text
    assert "arch  starts" in text and "0 of 1 projects done, 1 running" in text
    assert "0 of 1 projects done, 1 failed" in text
    assert "arch  crashed: crashed in dense" in text


@pytest.mark.parametrize(
    ("quiet", "lines"),
    [
        (False, ["matches  ...", *(f"matches  {n} of 4 pairs" for n in (1, 2, 3, 4)), "sparse  up to date"]),
        (True, []),
    ],
)
def test_a_pipe_has_lines(capsys: Captured, quiet: bool, lines: list[str]) -> None:
    display = Display(Terminal(quiet=quiet))
    work(display)
    display.show(batch_of("running"))
    display.show(batch_of("crashed", "finished"))
    text = [line.split(", ")[0].strip() for line in capsys.readouterr().err.splitlines()]
    assert text == [*lines, *([] if quiet else ["arch  begun"]), "arch  crashed: crashed in dense"]


def only_unit(display: Display) -> None:
    with display.stage("fit") as progress:
        progress.start(1, "triplets")
        progress.advance()


def test_an_only_unit_is_not_counted(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    only_unit(Display(Terminal()))
    assert capsys.readouterr().err.split() == ["fit", "..."]
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    only_unit(Display(Terminal()))
    last = re.sub("\x1b\\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().err).rpartition("fit ")[2]
    assert "0:00:00" in last
    assert "1/1" not in last and "triplets" not in last


def test_a_program_has_events(capsys: Captured) -> None:
    display = Display(JsonLines())
    work(display)
    display.show(batch_of("running"))
    display.show(batch_of("running"))
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    names = ["stage", "progress", "progress", "done", "kept", "project", "batch"]
    assert [event["event"] for event in events] == names
    assert (events[2]["done"], events[2]["total"], events[2]["unit"]) == (4, 4, "pairs")


def test_stopped_the_work_ends() -> None:
    display = Display(JsonLines())
    with pytest.raises(Cancelled), display.stage("matches") as progress:
        display.stop()
        progress.advance()
    with pytest.raises(Cancelled), display.stage("sparse"):
        pytest.fail("it began")


def test_a_run_as_lines_of_json(capsys: Captured, new_project: Make) -> None:
    project = new_project(2)
    (project / "images/broken.jpg").write_bytes(b"no photograph")
    assert main(["reconstruct", str(project), "--until", "convert", "--json-lines", *SETTINGS]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    events = [json.loads(line) for line in captured.out.splitlines()]
    assert [e["stage"] for e in events if e["event"] == "done"] == ["content", *STAGE_NAMES[:3]]
    converted = [e for e in events if e["event"] == "progress" and e["stage"] == "convert"]
    last = [e for e in converted if e["unit"] == "images"][-1]
    assert (last["done"], last["total"]) == (2, 2)
    assert (converted[-1]["done"], converted[-1]["unit"]) == (2, "photographs judged")
    assert last["run_seconds_left"] >= last["stage_seconds_left"] >= 0
    assert any("broken.jpg" in e["text"] for e in events if e["event"] == "warning")
    assert (events[-1]["event"], events[-1]["result"]["images"]) == ("result", 3)
    assert main(["reconstruct", str(project / "gone"), "--json-lines"]) == 1
    event = json.loads(capsys.readouterr().out)
    assert (event["event"], bool(event["message"]), bool(event["hint"])) == ("failed", True, True)


def test_what_is_said_aloud(new_project: Make) -> None:
    project = new_project(2)
    loud = run("reconstruct", project, "--until", "features", "-v", *SETTINGS)
    assert loud.returncode == 0
    assert "features  took" in loud.stderr
    assert "feature_extraction.cc" in loud.stderr  # COLMAP's own words
    plain = run("reconstruct", project, "--until", "features", "--from", "features", *SETTINGS)
    assert ".cc" not in plain.stderr
    assert "\x1b" not in loud.stdout + loud.stderr + plain.stdout + plain.stderr


def test_what_remains_in_words() -> None:
    assert left_in_words(None, None) == ""
    assert left_in_words(None, 65.2) == "1:05 left"
    assert left_in_words(20.0, 20.4) == "0:20 left"
    assert left_in_words(20.0, 7321.0) == "0:20 left, 2:02:01 in all"


def test_nothing_that_a_file_says_steers_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    terminal = Terminal(quiet=True)
    odd = "a\x1b]0;title\x07\x1b[2Jb\u202ec\nd\ud800 [red]x[/] é"
    terminal.warn(odd)
    terminal.failed(odd, odd)
    print_table("", [(odd, odd)])
    out, err = capsys.readouterr()
    for text in (out, err):
        assert "\\x1b]0;title\\x07" in text and "\\u202e" in text and "[red]x[/] é" in text
        assert not {"\x1b", "\x07", "\u202e"} & set(text)
