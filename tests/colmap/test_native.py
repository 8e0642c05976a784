"""Options of COLMAP's own: refused by name and value, in one line and without COLMAP's log."""

from __future__ import annotations

from typing import Any

import pytest

from colmap_ihe.colmap.native import apply_options, pycolmap
from colmap_ihe.errors import OptionError


@pytest.mark.parametrize(
    ("values", "message", "hint"),
    [
        ({"sift": {"max_num_featurs": 9}}, "features.colmap.sift: COLMAP has no option 'max_num_featurs' there",
         "did you mean max_num_features?"),
        ({"sfit": {}}, "features.colmap: COLMAP has no option 'sfit' there", "did you mean sift?"),
        ({"zzz": 1}, "features.colmap: COLMAP has no option 'zzz' there", "known there: "),
        ({"sift": {"max_num_features": "many"}},
         "features.colmap.sift: max_num_features is 'many'; expected a value such as 8192", "pycolmap.FeatureExtr"),
        ({"sift": {"normalization": "L9"}}, "normalization is 'L9'; expected one of L1_ROOT, L2", "pycolmap."),
        ({"sift": 3}, "features.colmap: sift is 3; expected options of its own: ", "pycolmap."),
    ],
)  # fmt: skip
def test_what_colmap_does_not_take_is_one_line(
    values: dict[str, Any], message: str, hint: str, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(OptionError) as caught:
        apply_options(pycolmap.FeatureExtractionOptions(), values, "features.colmap")
    assert message in str(caught.value)
    assert hint in caught.value.hint
    assert "\n" not in str(caught.value)
    captured = capfd.readouterr()
    assert captured.err == captured.out == ""


def test_what_it_takes_is_set() -> None:
    options = apply_options(pycolmap.FeatureExtractionOptions(), {"sift": {"max_num_features": 77}}, "here")
    assert options.sift.max_num_features == 77
