"""Counts and lists of names, as sentences have them."""

from __future__ import annotations

from colmap_ihe.machine.words import counted, listed


def test_a_list_that_is_cut_says_how_many_more() -> None:
    assert listed([]) == ""
    assert listed(["a"]) == "a"
    assert listed(list("abcde")) == "a, b, c, d, e"
    assert listed(list("abcdefg")) == "a, b, c, d, e and 2 more"
    assert listed(["a b", "c d", "e f"], 2, "; ") == "a b; c d; and 1 more"


def test_one_is_no_plural() -> None:
    assert counted(1, "photograph") == "1 photograph"
    assert counted(0, "photograph") == "0 photographs"
    assert counted(2, "copy", "copies") == "2 copies"
