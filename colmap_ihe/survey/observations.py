"""Hold where a named point is seen in a photograph, and where it lies in the model.

Pixels are COLMAP's: x to the right, y down, the centre of the top left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Observation:
    """Describe one sight of the point `name` in the photograph `image`, named as in the model; `accuracy_px` is the
    standard deviation of each coordinate."""

    image: str
    name: str
    x_px: float
    y_px: float
    accuracy_px: float


@dataclass(frozen=True)
class LocatedPoint:
    """Describe a point in the frame of the model.

    `xyz` is (3,). `covariance` is (3, 3), of the observations alone, the cameras taken as known. `residuals_px` has by
    image name the (dx, dy) from the point's projection to its observation, also of those left out. `used` names the
    photographs that agree, `left_out` the others, each with the reason.
    """

    xyz: F64
    covariance: F64
    residuals_px: Mapping[str, tuple[float, float]]
    pixels: Mapping[str, tuple[float, float]]
    accuracies: Mapping[str, float]
    used: tuple[str, ...]
    left_out: Mapping[str, str]
