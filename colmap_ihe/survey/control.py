"""Hold what a survey knows of a building: surveyed points, camera positions, scale bars and where they are seen.

Coordinates are those of the user's system: x east, y north and z up in metres, or longitude, latitude and height where
that system is of degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

Role = Literal["control", "check"]
Xyz = tuple[float, float, float]

POINT_ACCURACY_M, POSITION_ACCURACY_M, LENGTH_ACCURACY_M = 0.01, 0.05, 0.001
"""Standard deviations where a file gives none: of a total station's point, of a camera's position, and of a bar."""
CLICKED_PX = 0.7
"""Standard deviation of a coordinate of a point that a person has marked in a photograph."""


@dataclass(frozen=True)
class SurveyedPoint:
    """Describe a surveyed point; a `check` point takes part in nothing, and tells how good the model is.
    `accuracy_m`: the standard deviation of each coordinate."""

    name: str
    xyz: Xyz
    accuracy_m: float = POINT_ACCURACY_M
    role: Role = "control"


@dataclass(frozen=True)
class CameraPosition:
    """Say where the camera stood when it took `image`; `accuracy_m`: the standard deviation of each coordinate."""

    image: str
    xyz: Xyz
    accuracy_m: float = POSITION_ACCURACY_M


@dataclass(frozen=True)
class ScaleBar:
    """Hold the measured distance of two named points."""

    first: str
    second: str
    length_m: float
    accuracy_m: float = LENGTH_ACCURACY_M

    @property
    def name(self) -> str:
        return f"{self.first} to {self.second}"


@dataclass(frozen=True)
class Sight:
    """Say where the photograph `image` shows the point `name`, in pixels of the photograph as it is stored, the centre
    of the top left one (0.5, 0.5); `line` of `file` says it."""

    image: str
    name: str
    x_px: float
    y_px: float
    file: str = ""
    line: int = 0


@dataclass(frozen=True)
class Control:
    """Hold all of the folder `control/`. `crs`: what the files themselves say of their system, empty for nothing;
    `unused`: names of files there that are read as nothing."""

    points: Mapping[str, SurveyedPoint] = field(default_factory=dict)
    positions: Sequence[CameraPosition] = ()
    scale_bars: Sequence[ScaleBar] = ()
    sights: Sequence[Sight] = ()
    crs: str = ""
    unused: Sequence[str] = ()

    @property
    def names(self) -> set[str]:
        """Return the names of all points that are surveyed, or end a scale bar."""
        return {*self.points, *(end for bar in self.scale_bars for end in (bar.first, bar.second))}

    def coordinates(self) -> list[Xyz]:
        """Return all coordinates, of points and of positions."""
        return [*(point.xyz for point in self.points.values()), *(each.xyz for each in self.positions)]
