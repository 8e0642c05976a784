"""Usage, help and arguments of the command line."""

from __future__ import annotations

import pytest
from command_line import Captured

from colmap_ihe.cli import main
from colmap_ihe.commandline.arguments import parser_of
from colmap_ihe.commandline.commands import COMMANDS
from colmap_ihe.machine.libraries import __version__


@pytest.mark.parametrize(
    "arguments",
    [
        "", "nonsense", "reconstruct", "fit", "convert a", "reconstruct . --until nowhere", "fit . --method best",
        "reconstruct . --from sparce", "convert a b --format gif", "fit . --step fine",
        "convert a b --method red --weights w.yaml",
    ],
)  # fmt: skip
def test_wrong_usage_exits_with_2(capsys: Captured, arguments: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments.split())
    assert caught.value.code == 2
    assert "usage: colmap-ihe" in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(capsys: Captured, command: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert f"usage: colmap-ihe {command}" in text
    assert "--json" in text
    assert len(text.splitlines()) > 7


def test_the_version_is_printed(capsys: Captured) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"colmap-ihe {__version__}\n"


@pytest.mark.parametrize("words", ["--jobs 0", "--time-limit soon", "--time-limit 0h", "--settle 30"])
def test_other_lengths_and_counts_are_wrong_usage(words: str, capsys: Captured) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["batch", ".", *words.split()])
    assert caught.value.code == 2
    assert "expected a" in capsys.readouterr().err


def test_lengths_of_time_have_units() -> None:
    parser = parser_of(COMMANDS)
    for text, seconds in (("45s", 45), ("1.5m", 90), ("2h", 7200)):
        assert parser.parse_args(["batch", ".", "--time-limit", text]).time_limit == seconds
