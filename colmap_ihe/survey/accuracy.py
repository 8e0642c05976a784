"""Hold how well a model agrees with its survey, point by point, as surveyors tell it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Metres3 = tuple[float, float, float]


@dataclass(frozen=True)
class PointAccuracy:
    """Describe one named point. `role`: control, check, or `seen` for one without coordinates. `delta_m`: where the
    photographs show it less where it was surveyed, x y z; `deviation_m`: the standard deviations expected of that;
    `sights` photographs show it, `error_px` the root mean square of their residuals. `used`: whether it took part;
    `reason`: why not, or why there is no delta."""

    name: str
    role: str
    surveyed: Metres3 | None
    delta_m: Metres3 | None
    deviation_m: Metres3 | None
    sights: int
    error_px: float | None
    used: bool
    reason: str = ""


@dataclass(frozen=True)
class BarAccuracy:
    """Describe a scale bar: its measured length, and how much longer it is in the model (`delta_m`)."""

    name: str
    length_m: float
    delta_m: float | None
    used: bool
    reason: str = ""


@dataclass(frozen=True)
class PositionAccuracy:
    """Describe a camera position: where the model has the camera less where it was measured to stand."""

    image: str
    delta_m: Metres3 | None
    used: bool
    reason: str = ""


def rms(values: Sequence[Metres3 | float]) -> float | None:
    """Return the root mean square of lengths, or of numbers; None of none."""
    if not values:
        return None
    squares = [float(np.sum(np.square(value))) for value in values]
    return float(np.sqrt(np.mean(squares)))


def point_rms(points: Sequence[PointAccuracy], role: str) -> float | None:
    """Return the root mean square of the distances of all points of a role, in metres; of control points those that
    took part."""
    return rms([p.delta_m for p in points if p.role == role and p.delta_m and (p.used or role == "check")])
