"""Commands and options that there are not, and help by name."""

from __future__ import annotations

import argparse
import subprocess

import pytest
from command_line import Captured, failure_of, output_of

from colmap_ihe.cli import main
from colmap_ihe.commandline.arguments import parser_of
from colmap_ihe.commandline.commands import COMMANDS
from colmap_ihe.commandline.misspelt import commands_of
from colmap_ihe.machine.libraries import __version__


def exit_of(capsys: Captured, *arguments: str) -> tuple[int | str | None, str]:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    captured = capsys.readouterr()
    return caught.value.code, captured.out + captured.err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("recontruct church", "no command 'recontruct': did you mean reconstruct?"),
        ("xyzzy", "no command 'xyzzy': expected one of demo, reconstruct, "),
        ("fit . --methd ihe", "no option --methd: did you mean --method?"),
        ("fit . --methd=ihe", "no option --methd: did you mean --method?"),
        ("status . --xyzzy", "no option --xyzzy: see colmap-ihe help status"),
        ("help recontruct", "no command 'recontruct': did you mean reconstruct?"),
    ],
)
def test_the_nearest_is_named(capsys: Captured, arguments: str, words: str) -> None:
    code, text = exit_of(capsys, *arguments.split())
    assert code == 2
    assert text.splitlines()[-1].endswith(words) or words in text.splitlines()[-1]


def test_a_part_of_an_option_is_still_taken(capsys: Captured) -> None:
    assert exit_of(capsys, "fit", "--hel")[0] == 0


def test_options_of_a_project_name_the_nearest(capsys: Captured, tmp_path: object) -> None:
    folder = str(tmp_path)
    assert "did you mean enabled?" in failure_of(capsys, "status", folder, "--set", "dense.enable=true")
    assert "did you mean dense?" in failure_of(capsys, "status", folder, "--set", "desne.enabled=true")
    assert "did you mean" not in failure_of(capsys, "status", folder, "--set", "dense.xyzzy=true")


def test_help_by_name_and_the_version(capsys: Captured) -> None:
    assert exit_of(capsys, "help", "fit") == exit_of(capsys, "fit", "--help")
    assert exit_of(capsys, "help") == exit_of(capsys, "help", "help") == exit_of(capsys, "--help")
    assert exit_of(capsys, "-V") == (0, f"colmap-ihe {__version__}\n")


def said_default(action: argparse.Action) -> str:
    if action.default in (None, []):
        return ")"
    if isinstance(action, argparse.BooleanOptionalAction):
        return "(on)" if action.default else "(off)"
    return f"({action.default})" if "%(default)s" in str(action.help) else "("


def test_every_option_has_a_meaning_and_a_default() -> None:
    for name, command in commands_of(parser_of(COMMANDS)).items():
        for action in command._actions:
            assert action.help, f"{name} {action.option_strings or action.dest}"
            if action.option_strings and action.nargs != 0 and action.default != argparse.SUPPRESS:
                text = command._get_formatter()._expand_help(action)
                assert text.endswith(")") and said_default(action) in text, f"{name} {action.option_strings}"


def test_bash_completes_commands_and_options(capsys: Captured) -> None:
    script = output_of(capsys, "completion", "bash")
    function = next(word for word in script.split("complete -")[-1].split() if word.startswith("_shtab"))

    def completed(*words: str) -> list[str]:
        typed = " ".join(f"'{word}'" for word in words)
        ask = (
            f"COMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; {function}; printf '%s\\n' ${{COMPREPLY[@]}}"
        )
        done = subprocess.run(["bash", "-c", f"{script}\n{ask}"], capture_output=True, text=True, check=True)
        return done.stdout.split()

    assert completed("colmap-ihe", "rec") == ["reconstruct"]
    assert completed("colmap-ihe", "fit", "--wei") == ["--weights", "--weighting"]
    assert completed("colmap-ihe", "convert", "--tone", "s") == ["sqrt"]
