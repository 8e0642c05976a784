"""How right the remaining time is: `reconstruct` of each folder, its forecast noted twice a second, against what came.

    python benchmarks/remaining.py ../shared/data/sceaux ../shared/data/fountain-p11

For the run and for each stage of ten seconds and more: the forecast as a ratio to the truth after a fifth, a half and
four fifths of its time, and the share of the time after a fifth in which it is right within a factor of 1.5.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from pathlib import Path

from colmap_ihe.following import Follower, Piece
from colmap_ihe.pipeline import reconstruct
from colmap_ihe.project_yaml import load_options

_FACTOR = 1.5
_AT = (0.2, 0.5, 0.8)
_LEAST_SECONDS = 10.0


class _Noted(Follower):
    """Keeps what the forecast said, by stage, the run under ""."""

    def __init__(self) -> None:
        super().__init__()
        self.said: dict[str, list[tuple[float, float | None]]] = {"": []}
        self.over: dict[str, tuple[float, float]] = {}
        self.costs: list[tuple[str, str, float, int]] = []
        self.now = ""
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._note)

    def __enter__(self) -> _Noted:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _note(self) -> None:
        while not self._end.wait(0.5):
            for name in {"", self.now}:
                self.said.setdefault(name, []).append((time.monotonic(), self.forecast.remaining_s(name)))

    def warn(self, text: str) -> None:
        print(text)

    def result(self, text: str) -> None: ...

    def failed(self, message: str, hint: str) -> None: ...

    def _kept(self, name: str) -> None: ...

    def _piece(self, name: str) -> Piece:
        self.now = name
        return _Part(self, name)


class _Part(Piece):
    def __init__(self, noted: _Noted, name: str) -> None:
        super().__init__(noted, name)
        self._noted = noted
        self._began = self._part = time.monotonic()

    def _started(self) -> None:
        self._settle()
        self._part = time.monotonic()

    def _advanced(self) -> None: ...

    def over(self, seconds: float) -> None:
        self._settle()
        self._noted.over[self.name] = (self._began, self._began + seconds)

    def close(self) -> None: ...

    def _settle(self) -> None:
        """The last part of the stage is over."""
        costs = self._noted.costs
        if costs and costs[-1][0] == self.name and costs[-1][2] < 0:
            costs[-1] = (*costs[-1][:2], time.monotonic() - self._part, costs[-1][3])
        costs.append((self.name, self.unit, -1.0, self.total))


def _table(name: str, began: float, ended: float, said: list[tuple[float, float | None]]) -> str | None:
    seconds = ended - began
    if seconds < _LEAST_SECONDS:
        return None
    points = [((t - began) / seconds, left, ended - t) for t, left in said if began <= t < ended]
    late = [(left or 0.0, true) for at, left, true in points if at >= _AT[0] and true > 1.0]
    right = sum(true / _FACTOR <= left <= true * _FACTOR for left, true in late)
    cells = []
    for at in _AT:
        left, true = next(((left, true) for share, left, true in points if share >= at), (None, 1.0))
        cells.append("-" if left is None else f"{left / true:.2f}")
    return f"| {name} | {seconds:.0f} | {' | '.join(cells)} | {100 * right / max(1, len(late)):.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("images", type=Path, nargs="+")
    parser.add_argument("--set", action="append", default=[], dest="assignments")
    parsed = parser.parse_args()
    print(
        "| set, stage | s | at 1/5 | at 1/2 | at 4/5 | % of the time within 1.5 |\n|---|---|---|---|---|---|"
    )
    for images in parsed.images:
        with tempfile.TemporaryDirectory() as folder, _Noted() as noted:
            began = time.monotonic()
            reconstruct(folder, load_options(None, parsed.assignments), images=images, audience=noted)
            ended = time.monotonic()
        rows = [_table(f"{images.name}, in all", began, ended, noted.said[""])]
        rows += [
            _table(f"{images.name}, {name}", *noted.over[name], noted.said.get(name, []))
            for name in noted.over
        ]
        print("\n".join(row for row in rows if row), flush=True)
        for stage, unit, seconds, total in noted.costs:
            if seconds > 0:
                print(f"    {stage} {unit}: {seconds:.2f} s, {total}", flush=True)


if __name__ == "__main__":
    main()
