"""Hold what the page says of a model to a surveyor, in plain values and arrays: `pipeline` gathers it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Verdict:
    """Say how good a model is: in a sentence, the `headline`, why in a `paragraph`, and what would make it better, each
    of `advice` to follow a colon."""

    level: Literal["good", "fair", "poor"]
    headline: str
    paragraph: str
    advice: Sequence[str] = ()


@dataclass(frozen=True)
class OverlapMap:
    """Show how many `photographs` (K,) see each place of a model, looked at as `view` says: `cells` (K, 2) by steps to
    the right and upwards from (0, 0); `narrow` (K,) bool: those that all of them see from about one side."""

    view: str
    cells: NDArray[np.int64]
    photographs: NDArray[np.intp]
    narrow: NDArray[np.bool_]


@dataclass(frozen=True)
class CameraPlan:
    """Place the cameras about their model, looked at as `view` says, to the right and upwards, in units of the model:
    `ground` (K, 2), middles of squares of `side` in which the model lies; `centres` (N, 2) of the cameras, and where
    they look, `directions` (N, 2), shorter the more they look along the line of sight; their `names`."""

    view: str
    ground: NDArray[np.float64]
    side: float
    centres: NDArray[np.float64]
    directions: NDArray[np.float64]
    names: Sequence[str]


@dataclass(frozen=True)
class Residuals:
    """Count distances between where something was found in a photograph and where the model has it: `counts` by steps
    of `step_px`, the last of all that are longer; `median_px`, and `most_px`, which 95 % are below. `of`: what."""

    of: str
    counts: Sequence[int]
    step_px: float
    median_px: float
    most_px: float


@dataclass(frozen=True)
class SurveyBlock:
    """Hold what a model is, as figures with their names, and how good it is. `square`: in words, what a square of the
    maps is."""

    verdict: Verdict
    facts: Sequence[tuple[str, str]]
    maps: Sequence[OverlapMap] = ()
    square: str = ""
    plan: CameraPlan | None = None
    residuals: Sequence[Residuals] = ()
