"""Say in a line whether a model is metric, and how well it agrees with its survey."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from colmap_ihe.machine.words import counted

_BY = {
    "control_points": "control points",
    "scale_bars": "scale bars",
    "positions": "camera positions",
    "gps": "GPS of the photographs",
}
_NO_SCALE = (
    "the model has no scale; a measured distance in control/scalebars.csv gives it one: see docs/survey.md"
)


def survey_in_words(summary: Mapping[str, Any]) -> str:
    """Return the line of a summary on scale and accuracy, empty where the survey has not run."""
    if summary["metric"] is None:
        return ""
    if not summary["metric"]:
        return _NO_SCALE
    where = f" in {summary['crs']}" if summary["crs"] else ""
    parts = [f"metres by {_BY[summary['metric_by']]}{where}"]
    for name, what in (("control", "control point"), ("check", "check point")):
        if summary[f"{name}_rms_mm"] is not None:
            count = counted(summary[f"{name}_points"], what)
            parts.append(f"{count} {summary[f'{name}_rms_mm']:.1f} mm RMS")
    if summary["scale_bar_rms_mm"] is not None:
        parts.append(f"scale bars {summary['scale_bar_rms_mm']:.1f} mm RMS")
    if summary["position_rms_m"] is not None:
        parts.append(f"camera positions {summary['position_rms_m']:.3g} m RMS")
    return "; ".join(parts)
