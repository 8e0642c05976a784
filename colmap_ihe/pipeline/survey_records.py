"""Describe what a survey brought: for the record of its stage, the summary, and report/georeference.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, Strict

from colmap_ihe.pipeline.stage import Count, StageRecord, StrictModel
from colmap_ihe.survey.accuracy import PointAccuracy, point_rms, rms
from colmap_ihe.survey.georeference import Georeferenced

_Three = Annotated[tuple[float, float, float], Strict(False)]  # JSON has lists


class FrameRecord(StrictModel):
    """Describe the frame of the model: what `Frame` holds."""

    crs: str
    offset: _Three
    origin: _Three | None


class PointRecord(StrictModel):
    """Describe a named point: what `PointAccuracy` holds."""

    name: str
    role: str
    surveyed: _Three | None
    delta_m: _Three | None
    deviation_m: _Three | None
    sights: Count
    error_px: float | None
    used: bool
    reason: str
    residuals_px: list[float] = Field(default_factory=list)


class BarRecord(StrictModel):
    """Describe a scale bar: what `BarAccuracy` holds."""

    name: str
    length_m: float
    delta_m: float | None
    used: bool
    reason: str


class PositionRecord(StrictModel):
    """Describe a camera position: what `PositionAccuracy` holds; `image` is the photograph's name."""

    image: str
    delta_m: _Three | None
    used: bool
    reason: str


class SurveyRecord(StageRecord):
    """Describe how the model became metric. `method`: empty where it did not; `similarity` (3, 4) from the model in
    workspace/sparse/0 into the frame, before it was adjusted; `camera_params` and `camera_deviations` by camera id,
    after that."""

    method: str = ""
    frame: FrameRecord | None = None
    similarity: list[list[float]] | None = None
    adjusted: bool = False
    points: list[PointRecord] = Field(default_factory=list)
    bars: list[BarRecord] = Field(default_factory=list)
    positions: list[PositionRecord] = Field(default_factory=list)
    camera_params: dict[str, list[float]] = Field(default_factory=dict)
    camera_deviations: dict[str, list[float]] = Field(default_factory=dict)
    targets: Count = 0


def survey_record(result: Georeferenced, photographs: Mapping[str, str]) -> SurveyRecord:
    """Return the record of a result; `photographs`: their names by those of their grey images."""
    frame = result.frame
    return SurveyRecord(
        method=result.method,
        frame=FrameRecord(crs=frame.crs, offset=frame.offset, origin=frame.origin) if result.method else None,
        similarity=None if result.similarity is None else result.similarity.tolist(),
        adjusted=result.adjusted,
        points=[
            PointRecord(**{**vars(point), "residuals_px": list(point.residuals_px)})
            for point in result.points
        ],
        bars=[BarRecord(**vars(bar)) for bar in result.bars],
        positions=[
            PositionRecord(**{**vars(each), "image": photographs[each.image]}) for each in result.positions
        ],
        camera_deviations={str(i): list(values) for i, values in result.camera_deviations.items()},
        warnings=list(result.warnings),
    )


def survey_summary(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the summary says of a survey, from the record of its stage, empty if it has not run: `metric`, `crs`
    (null where the model has no scale, empty for a local system), and root mean squares, null of nothing."""
    method = record.get("method", "")
    points = [_point(values) for values in record.get("points", ())]
    control, check = point_rms(points, "control"), point_rms(points, "check")
    bars = rms(
        [bar["delta_m"] for bar in record.get("bars", ()) if bar["used"] and bar["delta_m"] is not None]
    )
    positions = rms([p["delta_m"] for p in record.get("positions", ()) if p["used"] and p["delta_m"]])
    return {
        "metric": bool(method) if record else None,
        "metric_by": method or None,
        "crs": record["frame"]["crs"] if method else None,
        "control_rms_mm": _millimetres(control) if method else None,
        "check_rms_mm": _millimetres(check) if method else None,
        "scale_bar_rms_mm": _millimetres(bars) if method else None,
        "position_rms_m": positions if method else None,
        "control_points": sum(point.used for point in points),
        "check_points": sum(point.role == "check" and point.delta_m is not None for point in points),
    }


def _point(values: Mapping[str, Any]) -> PointAccuracy:
    names = ("name", "role", "surveyed", "delta_m", "deviation_m", "sights", "error_px", "used", "reason")
    return PointAccuracy(**{name: values[name] for name in names})


def _millimetres(metres: float | None) -> float | None:
    return None if metres is None else 1000 * metres


def georeference_json(record: SurveyRecord) -> dict[str, Any]:
    """Return what report/georeference.json holds: how to take the model's coordinates into the user's system, and how
    well it agrees with the survey."""
    assert record.frame is not None
    frame = record.frame
    degrees = "x east, y north, z up, in metres, on the plane that touches the earth at origin"
    values = record.model_dump(mode="json")
    return {
        "metric": True,
        "method": record.method,
        "crs": frame.crs or None,
        "frame": degrees if frame.origin else "metres, z up; add offset to have coordinates of crs",
        "offset": list(frame.offset),
        "origin_latitude_longitude_height": frame.origin,
        "frame_from_sparse_model": record.similarity,
        "adjusted_with_control": record.adjusted,
        **{name: values[name] for name in ("points", "bars", "positions")},
        **{name: value for name, value in survey_summary(values).items() if name.endswith(("_mm", "_rms_m"))},
    }
