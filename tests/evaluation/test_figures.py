"""A user's list of pairs."""

from __future__ import annotations

from pathlib import Path

import pytest

from colmap_ihe.errors import OptionError
from colmap_ihe.evaluation.figures import read_pairs

NAMES = ["a.jpg", "north wall/b 1.jpg", "b", "c d", "d"]


def test_names_may_hold_spaces(tmp_path: Path) -> None:
    file = tmp_path / "pairs.txt"
    file.write_text("# of the nave\n\na.jpg north wall/b 1.jpg\n  d\tc d\nnorth wall/b 1.jpg a.jpg\n")
    assert read_pairs(file, NAMES) == {frozenset(("a.jpg", "north wall/b 1.jpg")), frozenset(("c d", "d"))}


def test_names_may_hold_spaces_of_other_scripts(tmp_path: Path) -> None:
    names = ["x\u2028y.jpg", "10.00\u202fAM.png"]
    (tmp_path / "pairs.txt").write_text(f"{names[0]} {names[1]}\r\n", encoding="utf-8", newline="")
    assert read_pairs(tmp_path / "pairs.txt", names) == {frozenset(names)}


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"a.jpg gone.jpg", "line 1, 'a.jpg gone.jpg'"),
        (b"# none\n", "names no pair"),
        (b"a.jpg a.jpg", "is not two photographs"),
        (b"\xff\xfe", "not UTF-8 text"),
        (None, "No such file"),
    ],
)
def test_what_is_no_list_of_pairs_is_refused(tmp_path: Path, content: bytes | None, reason: str) -> None:
    if content is not None:
        (tmp_path / "pairs.txt").write_bytes(content)
    with pytest.raises(OptionError, match=reason):
        read_pairs(tmp_path / "pairs.txt", NAMES)
