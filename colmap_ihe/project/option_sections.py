"""Define what all sections of the options share, the section of the survey, and those that affect no result."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field


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
