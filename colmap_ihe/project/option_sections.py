"""Define what all sections of the options share, the section of the survey, and those that affect no result."""

from __future__ import annotations

import re
from datetime import date
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator


class Section(BaseModel):
    """Refuse unknown names and wrong types; never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class SurveyOptions(Section):
    crs: str = ""
    """The coordinate system of what control/ holds: an EPSG code, as EPSG:25832, or WKT; empty for a local system in
    metres."""
    align: Literal["auto", "control_points", "scale_bars", "positions", "gps", "none"] = "auto"
    """By what the model becomes metric. `auto`: the first of these for which there is enough; `none`: nothing."""
    targets: str = "auto"
    """`auto`: AprilTag 36h11, looked for where control/ names some; `none`; or a dictionary of OpenCV's, whose targets
    are then looked for in any case."""
    gps_accuracy_m: Annotated[float, Field(gt=0, le=1000, allow_inf_nan=False)] = 5.0
    """Standard deviation of GPS in EXIF, which moves the model as a whole, and does not bend it."""


_DRAWING = re.compile(r"[^\W_](?:[\w .-]{0,62}[\w-])?")
_Scale = Annotated[int, Field(ge=1, le=100_000)]
_PixelMm = Annotated[float, Field(gt=0, le=100_000, allow_inf_nan=False)]
_Metres = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
_Number = Annotated[float, Field(allow_inf_nan=False)]


def require_drawing_name(name: str) -> str:
    """Return the name of a drawing, which becomes that of a folder. Raises ValueError."""
    if _DRAWING.fullmatch(name) is None:
        raise ValueError(
            f"{name!r:.80} is no name of a drawing: expected letters, numbers, spaces, - and _, at most 64"
        )
    return name


class DrawingView(Section):
    """Say what a drawing shows: one of the first five, else the façade or plan that is called like the drawing."""

    of: Literal["front", "back", "left", "right", "plan"] | None = None
    """A façade that is found, or the plan from above."""
    plane: list[_Number] | None = None
    """x, y, z of a point and of the direction that the plane looks to; or x, y, z of three points on it."""
    cylinder: list[_Number] | None = None
    """Unrolled: x, y, z of a point on its axis, and its radius, upright and fitted to the mesh; or a point, the
    direction of the axis and the radius, taken as they are."""
    section: list[_Number] | None = None
    """x, y of the two ends of a line: what an upright cut along it meets."""
    height: _Number | None = None
    """What a level cut at this height meets."""
    inside: bool = False
    """A cylinder as seen from its axis, as an apse."""
    mm_per_pixel: _PixelMm | None = None
    scale: _Scale | None = None
    behind: _Metres | None = None
    """How far behind the plane things are drawn, in metres; None is a quarter of the façade's larger side."""
    before: _Metres | None = None

    @field_validator("plane")
    @classmethod
    def _plane_has_numbers(cls, values: list[float] | None) -> list[float] | None:
        if values is not None and len(values) not in (6, 9):
            raise ValueError("expected 6 numbers, a point and a direction, or 9, three points")
        return values

    @field_validator("cylinder")
    @classmethod
    def _cylinder_has_numbers(cls, values: list[float] | None) -> list[float] | None:
        if values is not None and len(values) not in (4, 7):
            raise ValueError(
                "expected 4 numbers, a point and a radius, or 7, a point, a direction and a radius"
            )
        return values

    @field_validator("section")
    @classmethod
    def _section_has_numbers(cls, values: list[float] | None) -> list[float] | None:
        if values is not None and (len(values) != 4 or values[:2] == values[2:]):
            raise ValueError("expected 4 numbers, x and y of two points that are not the same")
        return values

    @model_validator(mode="after")
    def _one_of(self) -> DrawingView:
        given = [n for n in ("of", "plane", "cylinder", "section", "height") if getattr(self, n) is not None]
        if len(given) > 1:
            raise ValueError(f"expected one of {' and '.join(given)}")
        return self


class DrawingsOptions(Section):
    enabled: Literal["auto"] | bool = "auto"
    """`auto`: of models that are metric; of no account where there is no mesh."""
    mm_per_pixel: _PixelMm | None = None
    """Of orthophotos and reliefs; None is what the photographs show."""
    scale: _Scale = 50
    """Of the sheets, as 50 for 1:50."""
    title: dict[str, str] = Field(default_factory=dict)
    """Lines of the title block of the sheets, by name."""
    views: dict[str, DrawingView] = Field(default_factory=dict)
    """Drawings by name; none is every façade that is found, the plan, and two sections."""

    @field_validator("title", mode="before")
    @classmethod
    def _lines_are_text(cls, title: object) -> object:
        """Take numbers and dates too, as YAML reads them."""
        if not isinstance(title, dict):
            return title
        plain = (int, float, date)
        return {
            n: str(v) if isinstance(v, plain) and not isinstance(v, bool) else v for n, v in title.items()
        }

    @field_validator("views")
    @classmethod
    def _names_are_of_folders(cls, views: dict[str, DrawingView]) -> dict[str, DrawingView]:
        for name in views:
            require_drawing_name(name)
        folded = [name.casefold() for name in views]
        if len(set(folded)) < len(folded):
            raise ValueError("two drawings have names that differ only in capitals")
        return views


class ReportOptions(Section):
    """Say what the page is like, which affects no result."""

    max_mb: Annotated[float, Field(ge=1, le=2000)] = 25.0
    """The most megabytes of report/index.html; the mesh is drawn with fewer triangles where it needs more."""


class ClusterOptions(Section):
    """Say where work runs, which affects no result."""

    address: Annotated[str, Field(min_length=1)] | None = None
    """Of a Dask scheduler, as tcp://login1:8786, or its scheduler file; `local:N` starts N workers here."""
    patience: Annotated[float, Field(gt=0, le=1_000_000)] = 600.0
    """Seconds without any worker, or without the scheduler, after which a run gives up."""


class MachineOptions(Section):
    threads: Annotated[int, Field(ge=1, le=1024)] | None = None
    """The most threads that compute at a time; None is one a core. With 1 the same run gives the same model."""
