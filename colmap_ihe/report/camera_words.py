"""Say in words how the cameras of a model were calibrated: their parameters with standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from colmap_ihe.machine.words import counted

Camera = Mapping[str, Any]
"""A camera of report/summary.json: `model`, `width`, `height`, `photographs`, `by`, `parameters` and
`standard_deviations` by name, these None where they are not known, `exif`, and `doubtful` pairs."""

_ROWS = 3  # cameras that the summary for a terminal names
_NOT_CALIBRATED = {"colmap": ", not calibrated", "given": ", held as given"}


def camera_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the cameras as rows of a summary: name and value."""
    cameras: Sequence[Camera] = summary["cameras"] or ()
    rows = [("camera", _in_words(camera, len(cameras) > 1)) for camera in cameras[:_ROWS]]
    if len(cameras) > _ROWS:
        rows.append(("camera", f"and {len(cameras) - _ROWS} more, in report/summary.json"))
    if error := summary["held_out_error_px"]:
        rows.append(("held-out error", _error_in_words(**error)))
    return rows


def _error_in_words(calibrated: float, colmap: float, confirmed: bool) -> str:
    if calibrated == colmap:
        return f"{calibrated:.3f} px, which no richer camera model than COLMAP's betters"
    kept = "" if confirmed else ", which was kept"
    return f"{calibrated:.3f} px, with COLMAP's model {colmap:.3f} px{kept}"


def gain_in_words(summary: Mapping[str, Any]) -> str:
    """Return what points held out say of the calibration; nothing where there was none."""
    error = summary["held_out_error_px"]
    if not error:
        return ""
    calibrated, colmap = error["calibrated"], error["colmap"]
    if not error["confirmed"]:
        return (
            f"Points that the calibration did not see are off by {calibrated:.3f} px in the median with a richer camera"
            f" model, by {colmap:.3f} px with COLMAP's own. So COLMAP's is kept, with its parameters calibrated."
        )
    if calibrated == colmap:
        return (
            f"Points that the calibration did not see are off by {colmap:.3f} px in the median. These photographs call"
            " for no camera model that is richer than COLMAP's own."
        )
    less = 100 * (1 - calibrated / colmap) if colmap else 0.0
    share = f"{abs(less):.0f} % {'less' if less >= 0 else 'more'}"
    return (
        f"Points that the calibration did not see are off by {calibrated:.3f} px in the median, by {colmap:.3f} px with"
        f" the camera model as COLMAP begins with it ({share})."
    )


def _in_words(camera: Camera, named: bool) -> str:
    name = f"{name_of(camera)}: " if named and name_of(camera) else ""
    held = _NOT_CALIBRATED.get(camera["by"], "")
    lens = f"{camera['model']}, focal length {focal(camera)} px, principal point {centre(camera)}"
    return f"{name}{lens}, {counted(camera['photographs'], 'photograph')}{held}"


def name_of(camera: Camera) -> str:
    """Return what EXIF says of a camera, as "Canon EOS 5D at 35 mm"; nothing where it says nothing."""
    exif = camera["exif"] or {"make": "", "model": "", "focal_length_mm": 0}
    name = exif["model"] or exif["make"]
    return f"{name} at {exif['focal_length_mm']:g} mm" if name and exif["focal_length_mm"] else name


def focal(camera: Camera) -> str:
    """Return the focal length, or that across and that down, in pixels."""
    names = [name for name in ("f", "fx", "fy") if name in camera["parameters"]]
    values = list(dict.fromkeys(with_deviation(camera, name, 1) for name in names))
    return f"{values[0]} across, {values[1]} down" if len(values) == 2 else "".join(values) or "-"


def centre(camera: Camera) -> str:
    """Return the principal point in pixels."""
    if not {"cx", "cy"} <= camera["parameters"].keys():
        return "-"  # of a panorama
    spread = camera["standard_deviations"]
    if spread and not spread["cx"] and not spread["cy"]:
        return f"({camera['parameters']['cx']:.1f}, {camera['parameters']['cy']:.1f}) held"
    return f"({with_deviation(camera, 'cx', 1)}, {with_deviation(camera, 'cy', 1)})"


def coefficients(camera: Camera) -> list[str]:
    """Return the names of the coefficients of distortion that are not 0."""
    if not {"cx", "cy"} <= camera["parameters"].keys():
        return []
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
