"""Say in words how the cameras of a model were calibrated: their parameters with standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from colmap_ihe.machine.words import counted

Camera = Mapping[str, Any]
"""A camera of report/summary.json: `model`, `width`, `height`, `photographs`, `by`, `parameters` and
`standard_deviations` by name, these None where they are not known, and `doubtful` pairs."""

_ROWS = 3  # cameras that the summary for a terminal names


def camera_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the cameras as rows of a summary: name and value."""
    cameras: Sequence[Camera] = summary["cameras"] or ()
    rows = [("camera", _in_words(camera)) for camera in cameras[:_ROWS]]
    if len(cameras) > _ROWS:
        rows.append(("camera", f"and {len(cameras) - _ROWS} more, in report/summary.json"))
    if held_out := summary["held_out_error_px"]:
        rows.append(
            (
                "held-out error",
                f"{held_out['calibrated']:.3f} px, with COLMAP's model {held_out['colmap']:.3f} px",
            )
        )
    return rows


def _in_words(camera: Camera) -> str:
    lens = f"{camera['model']}, focal length {focal(camera)} px, principal point {centre(camera)}"
    return f"{lens}, {counted(camera['photographs'], 'photograph')}"


def focal(camera: Camera) -> str:
    """Return the focal length or lengths in pixels."""
    names = [name for name in ("f", "fx", "fy") if name in camera["parameters"]]
    values = {with_deviation(camera, name, 1) for name in names}
    return " and ".join(sorted(values)) if names else "-"


def centre(camera: Camera) -> str:
    """Return the principal point in pixels."""
    return f"({with_deviation(camera, 'cx', 1)}, {with_deviation(camera, 'cy', 1)})"


def coefficients(camera: Camera) -> list[str]:
    """Return the names of the coefficients of distortion that are not 0."""
    return [name for name, value in camera["parameters"].items() if name[0] not in "fc" and value]


def with_deviation(camera: Camera, name: str, digits: int) -> str:
    """Return a parameter with its standard deviation, where it has one."""
    value, deviations = camera["parameters"][name], camera["standard_deviations"]
    if not deviations:
        return f"{value:.{digits}f}"
    return (
        f"{value:.{digits}f} ± {deviations[name]:.{digits}f}"
        if deviations[name]
        else f"{value:.{digits}f} (held)"
    )
