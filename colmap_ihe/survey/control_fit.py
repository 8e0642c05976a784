"""Tell which control points do not fit an adjustment in which they took part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from colmap_ihe.survey.observations import F64
from colmap_ihe.survey.similarity import USUAL_LENGTH

_TIMES = 4.0  # deviations by which a point may be off, as the others are
_DOUBTFUL = 3.0  # deviations that all points are off on average
_FEWEST = 4  # of three each may be the wrong one
_LEAST_LEFT = 0.1  # of a point's variance: what nothing else tells cannot be wrong
_COORDINATES = 3


@dataclass(frozen=True)
class ControlFit:
    """Hold control points that took part in an adjustment: names, `deltas_m` (N, 3) from where they were surveyed to
    where they are now, the accuracy of the survey (N,), and the covariances (N, 3, 3) of where they are."""

    names: Sequence[str]
    deltas_m: F64
    accuracy_m: F64
    covariances: F64

    def wrong(self) -> tuple[str, str] | None:
        """Return the point that is off by most deviations, if by too many, and how far it is. The others tell what is
        usual: by their mean without the point, or by their median, since several may be wrong."""
        if len(self.names) < _FEWEST:
            return None
        off = self.in_deviations()
        free = max(1.0, self._freedom() - _COORDINATES)
        rest = np.sqrt(np.maximum(self._squares() - off**2, 0) / free) * (1 + 2 / free)
        usual = np.maximum(1, np.minimum(rest, np.median(off) / USUAL_LENGTH))
        worst = int(np.argmax(off / usual))
        if off[worst] <= _TIMES * usual[worst]:
            return None
        return self.names[worst], self._away(worst)

    def doubt(self) -> str:
        """Return a sentence where the points are off by far more than their accuracies say, and none alone; else an
        empty one."""
        if len(self.names) < _FEWEST:
            return ""
        times = float(np.sqrt(self._squares() / self._freedom()))
        if times <= _DOUBTFUL:
            return ""
        worst = int(np.argmax(self.in_deviations()))
        return (
            f"control points are off by {times:.0f} times of what their accuracies say, and it cannot be told which of"
            f" them is wrong; {self.names[worst]}, {self._away(worst)}, is the first to look at"
        )

    def in_deviations(self) -> F64:
        """Return (N,): what is left of each point by what is expected of that: they pull the model towards themselves,
        so that less is left than they were off (Baarda 1968, "A testing procedure for use in geodetic networks")."""
        variances, axes = np.linalg.eigh(self.covariances)
        own = self.accuracy_m[:, None] ** 2
        along = np.einsum("nij,ni->nj", axes, self.deltas_m)
        return np.asarray(np.sqrt((along**2 / np.maximum(own - variances, _LEAST_LEFT * own)).sum(axis=1)))

    def _squares(self) -> float:
        return float(((self.deltas_m / self.accuracy_m[:, None]) ** 2).sum())

    def _freedom(self) -> float:
        """Return how many coordinates of the points are not needed to place the model."""
        needed = np.trace(self.covariances, axis1=1, axis2=2) / self.accuracy_m**2
        return max(1.0, float((_COORDINATES - needed).sum()))

    def _away(self, number: int) -> str:
        return f"{1000 * np.linalg.norm(self.deltas_m[number]):.0f} mm from where the others put it"
