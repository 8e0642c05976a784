"""The arguments of `draw`."""

from __future__ import annotations

import pytest

from colmap_ihe.commandline.arguments import parser_of
from colmap_ihe.commandline.commands import COMMANDS
from colmap_ihe.commandline.draw_arguments import asked_view, draw_assignments
from colmap_ihe.errors import OptionError
from colmap_ihe.project.option_sections import DrawingView


def parsed(*words: str) -> tuple[list[str], str, DrawingView | None]:
    arguments = parser_of(COMMANDS).parse_args(["draw", "church", *words])
    return draw_assignments(arguments), *asked_view(arguments)


def test_a_view_is_one_of_the_project_or_a_new_one() -> None:
    assert parsed() == ([], "", None)
    assert parsed("--view", "front", "--plane", "auto")[1:] == ("front", None)
    name, view = parsed("--view", "north", "--plane=1,2,0,0,-1,0")[1:]
    assert (name, view) == ("north", DrawingView(plane=[1, 2, 0, 0, -1, 0]))
    assert parsed("--cylinder", "1, 2, 3, 0.5", "--inside")[1:] == (
        "drawing", DrawingView(cylinder=[1, 2, 3, 0.5], inside=True),
    )  # fmt: skip
    assert parsed("--scale", "1:20", "--mm-per-pixel", "2.5")[0] == [
        "drawings.mm_per_pixel=2.5",
        "drawings.scale=20",
    ]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--view", "../x", "--height", "1"), "'../x' is no name of a drawing"),
        (("--view", "a/b", "--height", "1"), "'a/b' is no name of a drawing"),
        (("--view", ".git", "--height", "1"), "'.git' is no name of a drawing"),
        (("--plane", "1,2,3"), "expected 6 numbers"),
        (("--section", "1,2,1,2"), "two points that are not the same"),
        (("--cylinder", "1,2"), "expected 4 numbers"),
        (("--mm-per-pixel", "-1"), "greater than 0"),
    ],
)
def test_what_makes_no_view_is_refused(words: tuple[str, ...], said: str) -> None:
    from colmap_ihe.project.options_file import load_options

    with pytest.raises(OptionError, match=said):
        load_options(None, parsed(*words)[0])


@pytest.mark.parametrize(
    "words", [("--scale", "50:1"), ("--scale", "1:0"), ("--plane", "a,b"), ("--height", "x")]
)
def test_what_is_no_number_is_wrong_usage(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        parsed(*words)
    assert caught.value.code == 2 and "argument --" in capsys.readouterr().err
