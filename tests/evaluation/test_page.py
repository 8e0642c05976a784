"""What the page of a comparison says of itself."""

from __future__ import annotations

import shlex
from pathlib import Path

from colmap_ihe.evaluation.page import command_of
from colmap_ihe.evaluation.tables import MethodResult
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import load_options


def test_the_command_is_short_with_the_defaults() -> None:
    results = [
        MethodResult(name, None, {}, {key: {} for key in range(4)}, None) for name in ("ihe", "rec709")
    ]
    command = command_of(Path("a/church"), Options(), results, pairs=None)
    assert command == "colmap-ihe compare church --methods ihe,rec709 --seeds 3"


def test_the_command_gives_the_same_options_again() -> None:
    given = [
        "dense.max_image_size=640",
        "features.colmap.sift.num_octaves=3",
        "fit.method=green",
        "cameras.*.JPG.focal_length=24",
    ]
    options = load_options(None, given)
    results = [MethodResult("ihe", None, {}, {key: {} for key in range(3)}, None)]
    words = shlex.split(command_of(Path("church"), options, results, pairs="my pairs.txt"))
    assert words[:9] == [
        "colmap-ihe",
        "compare",
        "church",
        "--methods",
        "ihe",
        "--seeds",
        "2",
        "--pairs",
        "my pairs.txt",
    ]
    assert load_options(None, words[10::2]) == options
