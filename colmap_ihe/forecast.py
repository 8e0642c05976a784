"""How long a run still takes: what each of its parts costs elsewhere, in proportion to what this run has cost so far.

A part is what has a unit of its own, as depth maps in the stage `dense`. Costs are seconds on two cores, and only their
proportions count: they are corrected by how fast this machine is, and those of the part at work by how it goes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

_SURE_AFTER = 0.5  # foreseen seconds that the foreseen pace itself is worth
_LEAST_LEFT = 0.1  # of its cost, that a part takes which is late and says nothing of how far it is


@dataclass(frozen=True)
class Part:
    """What a stage does in units of one kind, and the seconds it takes on two cores."""

    stage: str
    unit: str
    seconds: float


class Forecast:
    """Follows a run part by part. Parts that were not foreseen count once they are at work."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._left: list[Part] = []
        self._foreseen = self._took = 0.0
        self._now: Part | None = None
        self._began, self._share = clock(), 0.0

    def foresee(self, parts: Sequence[Part]) -> None:
        """What is to come, in order, instead of what was foreseen before."""
        self._left = list(parts)

    def begin(self, stage: str, unit: str) -> None:
        """A part begins; those foreseen before it are not coming any more."""
        self._settle()
        at = next((n for n, part in enumerate(self._left) if (part.stage, part.unit) == (stage, unit)), None)
        if at is None:
            self._now = Part(stage, unit, 0.0)
        else:
            self._now, self._left = self._left[at], self._left[at + 1 :]
        self._began, self._share = self._clock(), 0.0

    def reach(self, share: float) -> None:
        """So much of the part is done, 0 to 1."""
        self._share = min(1.0, max(self._share, share))

    def end(self, stage: str) -> None:
        """The stage is over, or needs not run; one of the same name that comes later stays."""
        self._settle()
        while self._left and self._left[0].stage == stage:
            self._left.pop(0)

    def remaining_s(self, stage: str = "") -> float | None:
        """Seconds that the run still takes, or only `stage`; None where nothing is known yet."""
        coming = sum(part.seconds for part in self._left if stage in ("", part.stage))
        now = self._now
        if now is None:
            return coming * self._pace(0.0, 0.0) if coming else None
        spent = self._clock() - self._began
        by_pace: float | None = None
        pace = self._pace(spent, self._share * now.seconds)
        if now.seconds:
            by_pace = max(
                now.seconds * (1 - self._share) * pace - (0.0 if self._share else spent),
                _LEAST_LEFT * now.seconds * (1 - self._share) * pace,
            )
        by_rate = spent * (1 - self._share) / self._share if self._share else None
        if by_rate is None and by_pace is None:
            return None
        if by_rate is None or by_pace is None:
            own = by_rate if by_pace is None else by_pace
        else:
            own = by_rate * self._share + by_pace * (1 - self._share)
        return (own or 0.0) + coming * pace

    def _pace(self, spent: float, worth: float) -> float:
        """Seconds that a foreseen second takes here."""
        took, foreseen = self._took, self._foreseen
        if worth:
            took, foreseen = took + spent, foreseen + worth
        return (took + _SURE_AFTER) / (foreseen + _SURE_AFTER)

    def _settle(self) -> None:
        if self._now is not None and self._now.seconds:
            self._took += self._clock() - self._began
            self._foreseen += self._now.seconds
        self._now = None
