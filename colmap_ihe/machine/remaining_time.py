"""How long a run still takes: what each of its parts costs elsewhere, in proportion to what this run has cost so far.

A part is what has a unit of its own, as depth maps in the stage `dense`. Costs are seconds on two cores, and only their
proportions count: they are corrected by how fast this machine is, and those of the part at work by how it goes.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

_SURE_AFTER = 0.5  # foreseen seconds that the foreseen pace itself is worth
_LEAST_LEFT = 0.1  # of what is left, where it is late
_TRUSTED_AFTER = 2.0  # units, the rate of a part counts as much as what was foreseen
_AT_WORK = 2.0  # units at a time, by and large


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
        self._began, self._reached, self._share, self._unit = clock(), 0.0, 0.0, 1.0

    def expect(self, parts: Sequence[Part]) -> None:
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
        self._began, self._reached, self._share, self._unit = self._clock(), 0.0, 0.0, 1.0

    def reach(self, share: float) -> None:
        """So much of the part is done, 0 to 1."""
        if share > self._share:
            self._unit = min(self._unit, share - self._share)
            self._reached, self._share = self._clock() - self._began, min(1.0, share)

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
        spent, share = self._so_far()
        pace = self._pace(spent, share * now.seconds)
        by_rate = spent / share if share else None
        by_pace = now.seconds * pace if now.seconds else None
        if by_rate is None and by_pace is None:
            return None
        if by_rate is None or by_pace is None:
            total = by_rate or by_pace or 0.0
        else:
            trust = share / (share + _TRUSTED_AFTER * self._unit)
            total = by_rate * trust + by_pace * (1 - trust)
        elapsed = self._clock() - self._began - spent
        return max(total * (1 - share) - elapsed, _LEAST_LEFT * total * (1 - share)) + coming * pace

    def _so_far(self) -> tuple[float, float]:
        """Seconds and the share of the part that was done in them. When its last unit was done, since the next is
        under way; later, where that one is late, as if it were done now, and another one."""
        spent = self._clock() - self._began
        if not self._share or (spent - self._reached) * self._share <= _AT_WORK * self._unit * self._reached:
            return self._reached, self._share
        return spent, min(1.0, self._share + _AT_WORK * self._unit)

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
