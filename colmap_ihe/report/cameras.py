"""Show how the cameras of a model were calibrated: a table of their parameters, and a drawing of each lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.report.camera_words import Camera, centre, coefficients, focal, with_deviation
from colmap_ihe.report.tables import Table

CHART_WIDTH = 640
DRAWN = 4  # lenses
_COLUMNS = 8  # cameras of the table
_BY = {"calibration": "calibrated", "colmap": "COLMAP's", "given": "given, held"}
_GRID = (13, 9)
_LONGEST = 0.9  # of the distance between arrows


@dataclass(frozen=True)
class LensChart:
    """Hold the drawing of a lens, `height` for the chart's width: `arrows` as an SVG path, from where a lens without
    distortion shows a place to where this one does, `times` as long as they are; the longest in pixels; the `middle` of
    the picture and the `principal` point, and the half axes of its two standard deviations, None where it was held."""

    title: str
    height: float
    arrows: str
    times: float
    longest_px: float
    middle: tuple[float, float]
    principal: tuple[float, float]
    deviation: tuple[float, float] | None
    off_px: float


def cameras_table(cameras: Sequence[Camera]) -> Table | None:
    """Return the first cameras as a table, a column for each; None without any."""
    shown = cameras[:_COLUMNS]
    if not shown:
        return None
    names = list(dict.fromkeys(name for camera in shown for name in coefficients(camera)))
    rows = [
        ("model", *(camera["model"] for camera in shown)),
        ("photographs", *(f"{camera['photographs']:,}" for camera in shown)),
        ("size", *(f"{camera['width']}x{camera['height']}" for camera in shown)),
        ("focal length, px", *map(focal, shown)),
        ("principal point, px", *map(centre, shown)),
        *((name, *(_coefficient(camera, name) for camera in shown)) for name in names),
        ("from", *(_BY[camera["by"]] for camera in shown)),
    ]
    columns = ("camera", *(str(number) for number in range(1, len(shown) + 1)))
    more = f", the first {len(shown)} of {len(cameras)}" if len(cameras) > len(shown) else ""
    return Table("cameras", f"Cameras{more}", columns, rows)


def _coefficient(camera: Camera, name: str) -> str:
    return with_deviation(camera, name, 5) if camera["parameters"].get(name) else ""


def lens_charts(cameras: Sequence[Camera]) -> list[LensChart]:
    """Return a drawing of the first lenses that were calibrated."""
    return [_chart(camera) for camera in cameras if camera["by"] == "calibration"][:DRAWN]


def _chart(camera: Camera) -> LensChart:
    real = pycolmap.Camera(
        model=camera["model"],
        width=camera["width"],
        height=camera["height"],
        params=list(camera["parameters"].values()),
    )
    scale = CHART_WIDTH / camera["width"]
    ideal = pycolmap.Camera(real.todict())
    params = np.array(real.params)
    params[list(real.extra_params_idxs())] = 0.0
    ideal.params = params.tolist()
    across, down = (
        (np.arange(count) + 0.5) / count * side
        for count, side in zip(_GRID, (camera["width"], camera["height"]), strict=True)
    )
    places = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    rays = np.column_stack([ideal.cam_from_img(places), np.ones(len(places))])
    moved = np.asarray(real.img_from_cam(rays)) - places
    seen = np.isfinite(moved).all(axis=1)
    places, moved = places[seen], moved[seen]
    longest = float(np.hypot(*moved.T).max(initial=0.0))
    times = _LONGEST * camera["width"] / _GRID[0] / longest if longest > 0.01 else 0.0
    ends = places + moved * times
    arrows = "".join(
        f"M{x * scale:.1f} {y * scale:.1f}L{u * scale:.1f} {v * scale:.1f}"
        for (x, y), (u, v) in zip(places, ends, strict=True)
    )
    middle = np.array([camera["width"], camera["height"]]) / 2
    principal = np.array([camera["parameters"]["cx"], camera["parameters"]["cy"]])
    deviations = camera["standard_deviations"] or {}
    spread = [2 * deviations.get(name, 0.0) * scale for name in ("cx", "cy")]
    off = float(np.hypot(*(principal - middle)))
    title = (
        f"{camera['model']}, {camera['width']}x{camera['height']}: distortion up to {longest:.1f} px;"
        f" principal point {off:.1f} px off the middle"
    )
    return LensChart(
        title,
        camera["height"] * scale,
        arrows,
        times,
        longest,
        (float(middle[0] * scale), float(middle[1] * scale)),
        (float(principal[0] * scale), float(principal[1] * scale)),
        (spread[0], spread[1]) if all(spread) else None,
        off,
    )
