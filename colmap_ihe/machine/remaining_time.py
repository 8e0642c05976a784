"""Estimate how long a run still takes, from the expected costs of its parts and from its pace so far.

A part has a unit of its own, as depth maps in the stage `dense`. Costs are seconds on two cores, and only their
proportions count: they are corrected by how fast this machine is, and the part at work by how fast it goes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

_SURE_AFTER = 0.5  # expected seconds that the expected pace itself is worth
_LEAST_LEFT = 0.1  # of what is left, where it is late
_TRUSTED_AFTER = 2.0  # units: then the rate of a part counts as much as its expected cost
_AT_WORK = 2.0  # units at a time, roughly


@dataclass(frozen=True)
class Part:
    """Hold the work of a stage in units of one kind, and the seconds it takes on two cores."""

    stage: str
    unit: str
    seconds: float


class Forecast:
    """Follow a run part by part. Parts that were not expected count once they are at work."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._left: list[Part] = []
        self._expected = self._took = 0.0
        self._now: Part | None = None
        self._began, self._reached, self._share, self._unit = clock(), 0.0, 0.0, 1.0

    def expect(self, parts: Sequence[Part]) -> None:
        """Expect these parts, in order, instead of those expected before."""
        self._left = list(parts)

    def begin(self, stage: str, unit: str) -> None:
        """Begin a part; those expected before it are dropped."""
        self._settle()
        self._now = Part(stage, unit, 0.0)
        for number, part in enumerate(self._left):
            if (part.stage, part.unit) == (stage, unit):
                self._now, self._left = part, self._left[number + 1 :]
                break
        self._began, self._reached, self._share, self._unit = self._clock(), 0.0, 0.0, 1.0

    def reach(self, share: float) -> None:
        """Note the share of the part that is done, 0 to 1."""
        if share > self._share:
            self._unit = min(self._unit, share - self._share)
            self._reached, self._share = self._clock() - self._began, min(1.0, share)

    def end(self, stage: str) -> None:
        """End a stage, or leave it out; one of the same name that comes later stays."""
        self._settle()
        while self._left and self._left[0].stage == stage:
            self._left.pop(0)

    def remaining_s(self, stage: str = "") -> float | None:
        """Return the seconds that the run still takes, or only `stage`; None where nothing is known yet."""
        coming = sum(part.seconds for part in self._left if stage in ("", part.stage))
        now = self._now
        if now is None:
            return coming * self._pace(0.0, 0.0) if coming else None
        spent, share = self._so_far()
        pace = self._pace(spent, share * now.seconds)
        by_rate = spent / share if share else None
        by_pace = now.seconds * pace if now.seconds else None
        if by_rate is None or by_pace is None:
            total = by_rate or by_pace
        else:
            trust = share / (share + _TRUSTED_AFTER * self._unit)
            total = by_rate * trust + by_pace * (1 - trust)
        if total is None:
            return None
        elapsed = self._clock() - self._began - spent
        return max(total * (1 - share) - elapsed, _LEAST_LEFT * total * (1 - share)) + coming * pace

    def _so_far(self) -> tuple[float, float]:
        """Return seconds and the share of the part that was done in them: when its last unit was done, as the next is
        under way; where that one is late, as if it and another one were done now."""
        spent = self._clock() - self._began
        if not self._share or (spent - self._reached) * self._share <= _AT_WORK * self._unit * self._reached:
            return self._reached, self._share
        return spent, min(1.0, self._share + _AT_WORK * self._unit)

    def _pace(self, spent: float, worth: float) -> float:
        """Return the seconds that an expected second takes here."""
        took, expected = self._took, self._expected
        if worth:
            took, expected = took + spent, expected + worth
        return (took + _SURE_AFTER) / (expected + _SURE_AFTER)

    def _settle(self) -> None:
        if self._now is not None and self._now.seconds:
            self._took += self._clock() - self._began
            self._expected += self._now.seconds
        self._now = None
