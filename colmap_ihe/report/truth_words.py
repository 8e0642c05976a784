"""Say in words how far a model is from a truth that is known, as that of the rendered demo."""

from __future__ import annotations

import re
from collections.abc import Mapping

Row = tuple[str, str]
Truth = Mapping[str, float | Mapping[str, float]]
"""The section `truth` of report/summary.json: figures, and shares in percent by the name of a painted panel."""

_BESIDE = re.compile(r"painted_depth_in_(.+)_by_two_greys_percent")
_CAMERAS = {
    "rotation_error_deg": "rotations {:.4f} degrees off",
    "position_error_percent": "positions {:.4f} % of the model's extent",
}
_DEPTH = {
    "dense_median_error_percent": "{:.3f} % off in the median",
    "depth_right_percent": "right within 2 % in {:.1f} % of the pixels",
    "depth_wrong_percent": "wrong in {:.2f} % of the depths",
}
_EDGES = {
    "depth_right_near_edges_percent": "right in {:.1f} % of the pixels",
    "depth_wrong_near_edges_percent": "wrong in {:.1f} % of the depths",
}


def truth_rows(truth: Truth) -> list[Row]:
    """Return the section as rows of a summary, name and value, each figure that is there in words."""
    rows = [
        ("cameras against the truth", _joined(truth, _CAMERAS)),
        ("depth against the truth", _joined(truth, _DEPTH)),
        ("depth near edges", _joined(truth, _EDGES)),
        ("depth on painted panels", _shares(truth.get("painted_depth_percent"))),
    ]
    for photograph in (match[1] for match in map(_BESIDE.fullmatch, truth) if match):
        two, one = (
            _shares(truth.get(f"painted_depth_in_{photograph}_by_{greys}_percent"))
            for greys in ("two_greys", "one_grey")
        )
        rows.append((f"the same in {photograph}", f"{two}; with the first grey alone {one}"))
    return [(name, value) for name, value in rows if value]


def _joined(truth: Truth, words: Mapping[str, str]) -> str:
    return ", ".join(text.format(truth[name]) for name, text in words.items() if name in truth)


def _shares(of_panels: float | Mapping[str, float] | None) -> str:
    """Write shares by name, as "rosette 99.9, scroll 99.9 %"; nothing where there are none."""
    if not isinstance(of_panels, Mapping) or not of_panels:
        return ""
    return ", ".join(f"{name} {share:.1f}" for name, share in of_panels.items()) + " %"
