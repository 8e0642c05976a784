"""Say what is assumed of cameras before they are calibrated, and what a given calibration is good for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from colmap_ihe.colmap.calibration.held_out import HeldOut
from colmap_ihe.colmap.known_calibration import CalibrationUse
from colmap_ihe.machine.words import counted, listed

_WEAK_FOCAL = 0.005  # standard deviation, of the focal length
_WEAK_CENTRE = (
    0.005  # of a principal point, in longer sides: half of what is known of it before any photograph
)
_FAR_OFF = 0.03  # of a principal point from the middle, in longer sides
_BETTER = (
    "Photographs that are turned by 90 degrees about the line of sight, or look from the sides, tell it; so does"
    " camera.calibration, from photographs by the same lens"
)


def focal_length_warnings(images: int, with_focal_length: int) -> list[str]:
    """Warn of photographs whose focal length COLMAP guesses."""
    if with_focal_length >= images:
        return []
    return [
        f"{images - with_focal_length} of {images} photographs do not say their focal length: COLMAP guesses it; if"
        " you know it, give it in `cameras:` or as camera.params"
    ]


def shared_camera_warnings(assumed: Sequence[int]) -> list[str]:
    """Warn of photographs that share a camera though EXIF does not say so. `assumed`: how many, of each camera."""
    if not assumed:
        return []
    several = f"{len(assumed)} cameras, one for each size and what else EXIF says"
    by = "one camera" if len(assumed) == 1 else several
    return [
        f"{sum(assumed)} photographs whose EXIF lacks make, model or focal length were taken as by {by}: if several"
        " cameras took them, or a zoom at several lengths, use --set camera.mode=per_image"
    ]


def apart_warnings(groups: Sequence[Sequence[str]]) -> list[str]:
    """Say that photographs that were taken as by one camera came out with several focal lengths. `groups`: photographs
    of one focal length each."""
    if not groups:
        return []
    listing = "; ".join(f"{counted(len(group), 'photograph')}: {listed(group)}" for group in groups)
    return [
        "photographs that were taken as by one camera clearly have different focal lengths, and were mapped again with"
        f" {len(groups)} cameras ({listing}). To say who took what, put each camera's photographs into a folder of"
        " their own and use --set camera.mode=per_folder"
    ]


def doubtful_calibrations(cameras: Sequence[Mapping[str, Any]]) -> list[str]:
    """Warn of cameras, as the record of `sparse` has them, whose photographs hardly tell their calibration, or that
    came out as cameras hardly are."""
    warnings = []
    for camera in (one for one in cameras if one["standard_deviations"]):
        who = f"the camera of {counted(camera['photographs'], 'photograph')} ({camera['model']})"
        if weak := _weak_parameters(camera):
            warnings.append(
                f"these photographs hardly tell the calibration of {who}: {listed(weak, separator='; ')}. {_BETTER}"
            )
        value, longer = _by_name(camera, "params"), max(camera["width"], camera["height"])
        off = max(abs(value["cx"] - camera["width"] / 2), abs(value["cy"] - camera["height"] / 2)) / longer
        if off > _FAR_OFF:
            warnings.append(
                f"the principal point of {who} came out {100 * off:.1f} % of the longer side off the middle, which is"
                f" rare: were the photographs cropped, or turned? If not, {_BETTER[0].lower()}{_BETTER[1:]}"
            )
    return warnings


def _weak_parameters(camera: Mapping[str, Any]) -> list[str]:
    """Name the parameters that are not sure, and pairs of which one may stand for the other."""
    value, spread = _by_name(camera, "params"), _by_name(camera, "standard_deviations")
    longer = max(camera["width"], camera["height"])
    one_focal_length = value.get("fx") == value.get("fy")
    names = [name for name in value if not (name == "fy" and one_focal_length)]
    weak = [
        f"{name} {value[name]:.0f} ± {spread[name]:.0f} px"
        for name in names
        if _is_weak(name, value, spread, longer)
    ]
    pairs = [(a, b, found) for a, b, found in camera["correlated"] if a in names and b in names]
    return weak + [f"{a} and {b} stand for each other ({found:.2f})" for a, b, found in pairs]


def _by_name(camera: Mapping[str, Any], numbers: str) -> dict[str, float]:
    return dict(zip(camera["names"], camera[numbers], strict=True))


def _is_weak(name: str, value: Mapping[str, float], spread: Mapping[str, float], longer: float) -> bool:
    if name in ("f", "fx", "fy"):
        return spread[name] > _WEAK_FOCAL * value[name]
    return name in ("cx", "cy") and spread[name] > _WEAK_CENTRE * longer


def refused_calibrations(gain: HeldOut | None) -> list[str]:
    """Say that COLMAP's camera model was kept, since points held out spoke against a richer one."""
    if gain is None or not gain.worse:
        return []
    return [
        f"a richer camera model fits these photographs better, but not the points that it did not see"
        f" ({gain.chosen_px:.3f} px off, by COLMAP's own model {gain.colmap_px:.3f} px): COLMAP's is kept. Were all"
        " photographs of a camera taken with one lens, zoom and focus?"
    ]


def calibration_warnings(use: CalibrationUse, by_grey: Mapping[str, str]) -> list[str]:
    """Warn of photographs whose camera is not in the calibration file, and of its cameras that took none. `by_grey`:
    the names of the photographs by those of their grey images."""
    warnings = []
    if use.without:
        names = sorted(by_grey[name] for name in use.without)
        warnings.append(
            f"camera.calibration has no camera of this make, model, focal length and size for"
            f" {counted(len(names), 'photograph')}, which start as without it: {listed(names)}"
        )
    if use.unused:
        warnings.append(
            f"camera.calibration has cameras that took none of the photographs: {listed(use.unused, separator='; ')}"
        )
    return warnings
