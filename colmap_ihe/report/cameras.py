"""Show how the cameras of a model were calibrated: a table of their parameters, and a drawing of each lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.report.camera_words import Camera, centre, coefficients, focal, name_of, with_deviation
from colmap_ihe.report.tables import Table

CHART_WIDTH = 640
DRAWN = 4  # lenses
_COLUMNS = 8  # cameras of the table
_BY = {"calibration": "calibrated", "colmap": "COLMAP's", "given": "given, held"}
_GRID = (13, 9)
_LONGEST = 0.9  # of the distance between lines
_MOST_TIMES = 100.0  # as long as they are: half a pixel looks like little
_SEEN_PX = 0.01  # a shorter line, or a smaller distance, is none
_DOT = 3.0  # units of the drawing: the radius of the principal point, where its ellipse is smaller
Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class LensChart:
    """Hold the drawing of a lens, `height` for the chart's width: `dots` as an SVG path, where a lens without
    distortion shows places; `arrows` to where this one shows them, `times` as long as they are, and the longest in
    pixels; the `middle` of the picture and the `principal` point, and its `radii`: of the ellipse of two standard
    deviations, or of a dot where that is small. `title` and `caption` say it."""

    title: str
    caption: str
    height: float
    dots: str
    arrows: str
    times: float
    longest_px: float
    middle: tuple[float, float]
    principal: tuple[float, float]
    radii: tuple[float, float]
    off_px: float


def cameras_table(cameras: Sequence[Camera]) -> Table | None:
    """Return the first cameras as a table, a column for each; None without any."""
    shown = cameras[:_COLUMNS]
    if not shown:
        return None
    names = list(dict.fromkeys(name for camera in shown for name in coefficients(camera)))
    taken_by = [("EXIF", *map(name_of, shown))] if any(map(name_of, shown)) else []
    rows = [
        *taken_by,
        ("model", *(camera["model"] for camera in shown)),
        ("photographs", *(f"{camera['photographs']:,}" for camera in shown)),
        ("size", *(f"{camera['width']}x{camera['height']}" for camera in shown)),
        ("focal length, px", *map(focal, shown)),
        ("principal point, px", *map(centre, shown)),
        *((name, *(_coefficient(camera, name) for camera in shown)) for name in names),
        ("from", *(_BY.get(camera["by"], camera["by"]) for camera in shown)),
    ]
    columns = ("camera", *(str(number) for number in range(1, len(shown) + 1)))
    more = f", the first {len(shown)} of {len(cameras)}" if len(cameras) > len(shown) else ""
    return Table("cameras", f"Cameras{more}", columns, rows)


def _coefficient(camera: Camera, name: str) -> str:
    return with_deviation(camera, name, 5) if camera["parameters"].get(name) else ""


def lens_charts(cameras: Sequence[Camera]) -> list[LensChart]:
    """Return a drawing of the first lenses that were calibrated."""
    names = [f"Camera {number}. " if len(cameras) > 1 else "" for number in range(1, len(cameras) + 1)]
    calibrated = [(c, name) for c, name in zip(cameras, names, strict=True) if c["by"] == "calibration"]
    return [_chart(camera, name) for camera, name in calibrated[:DRAWN]]


def _chart(camera: Camera, name: str) -> LensChart:
    scale = CHART_WIDTH / camera["width"]
    places, moved = _distortion(camera)
    longest = float(np.hypot(*moved.T).max(initial=0.0))
    times = _times(places, moved, camera["width"], camera["height"]) if longest > _SEEN_PX else 0.0
    middle = np.array([camera["width"], camera["height"]]) / 2
    principal = np.array([camera["parameters"]["cx"], camera["parameters"]["cy"]])
    radii = (
        2 * scale * np.array([(camera["standard_deviations"] or {}).get(name, 0.0) for name in ("cx", "cy")])
    )
    off = float(np.hypot(*(principal - middle)))
    return LensChart(
        title=f"{name}{camera['model']}, {camera['width']}x{camera['height']}: distortion up to {longest:.3g} px,"
        f" principal point {off:.1f} px off the middle",
        caption=f"{name}{_arrows_in_words(camera, longest, times)} {_centre_in_words(radii, off)}",
        height=camera["height"] * scale,
        dots="".join(f"M{x:.1f} {y:.1f}h0" for x, y in places * scale),
        arrows=_arrows(places * scale, (places + moved * times) * scale) if times else "",
        times=times,
        longest_px=longest,
        middle=(float(middle[0] * scale), float(middle[1] * scale)),
        principal=(float(principal[0] * scale), float(principal[1] * scale)),
        radii=(float(radii[0]), float(radii[1])) if radii.max() > _DOT else (_DOT, _DOT),
        off_px=off,
    )


def _distortion(camera: Camera) -> tuple[Float64, Float64]:
    """Return where a lens without distortion shows places, (n, 2), and how far from there this one does, (n, 2)."""
    real = pycolmap.Camera(
        model=camera["model"],
        width=camera["width"],
        height=camera["height"],
        params=list(camera["parameters"].values()),
    )
    ideal = pycolmap.Camera(real.todict())
    params = np.array(real.params)
    params[list(real.extra_params_idxs())] = 0.0
    ideal.params = params.tolist()
    places = _grid(camera["width"], camera["height"])
    rays = np.column_stack([np.asarray(ideal.cam_from_img(places), np.float64), np.ones(len(places))])
    there, back = np.asarray(real.img_from_cam(rays)), np.asarray(ideal.img_from_cam(rays))
    seen = np.isfinite(there).all(axis=1) & (np.abs(back - places) < _SEEN_PX).all(
        axis=1
    )  # not behind a fisheye
    return places[seen], (there - places)[seen]


def _times(places: Float64, moved: Float64, width: int, height: int) -> float:
    """Return how many times as long lines can be drawn, without one that leaves the picture."""
    room = np.where(moved > 0, np.array([width, height]) - places, places)
    inside = (room / np.maximum(np.abs(moved), 1e-9)).min()
    longest = np.hypot(*moved.T).max()
    return float(min(_LONGEST * width / _GRID[0] / longest, inside, _MOST_TIMES))


def _grid(width: int, height: int) -> Float64:
    """Return the middles (n, 2) of the fields of a picture."""
    across, down = ((np.arange(n) + 0.5) / n * side for n, side in zip(_GRID, (width, height), strict=True))
    return np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)


def _arrows(starts: Float64, ends: Float64) -> str:
    return "".join(f"M{x:.1f} {y:.1f}L{u:.1f} {v:.1f}" for (x, y), (u, v) in zip(starts, ends, strict=True))


def _arrows_in_words(camera: Camera, longest: float, times: float) -> str:
    ideal = "a fisheye" if "FISHEYE" in camera["model"] else "a lens"
    if not times:
        return f"The dots are where {ideal} without distortion shows places, and so does this one."
    return (
        f"The dots are where {ideal} without distortion shows places; lines lead to where this one does, up to"
        f" {longest:.3g} px off, drawn {times:.3g} times as long."
    )


def _centre_in_words(radii: Float64, off: float) -> str:
    cross = "The cross is the middle of the picture"
    if not radii.any() and off < _SEEN_PX:
        return f"{cross}, where the principal point was held."
    if not radii.any():
        return f"{cross}, the blue dot the principal point, held {off:.1f} px off it."
    form = "ellipse is two standard deviations of" if radii.max() > _DOT else "dot is"
    return f"{cross}; the blue {form} the principal point, {off:.1f} px off it."
