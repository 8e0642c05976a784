"""Compare the remaining time with the true one: `reconstruct` of each folder, its forecast read twice a second.

    python benchmarks/remaining.py ../shared/data/sceaux ../shared/data/fountain-p11 [--keep FOLDER]
    python benchmarks/remaining.py --again FOLDER/sceaux.json

For the run and for each stage of ten seconds and more: the forecast as a ratio to the truth after a fifth, a half and
four fifths of its time, and the share of the time after a fifth in which it is right within a factor of 1.5. Of what
was kept of a run, `--again` tells what the forecast would say now, with the costs that were foreseen then.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from typing import Any

from colmap_ihe.commandline.bars import Terminal
from colmap_ihe.commandline.display import Display
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Forecast, Part
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.options_file import load_options

_FACTOR = 1.5
_AT = (0.2, 0.5, 0.8)
_LEAST_SECONDS = 10.0
_TICK_S = 0.5

Event = tuple[float, str, list[Any]]


class _Recorder(Forecast):
    """Keep what was reported, and when."""

    def __init__(self) -> None:
        super().__init__()
        self.events: list[Event] = []

    def expect(self, parts: Sequence[Part]) -> None:
        self.events.append((time.monotonic(), "foresee", [astuple(part) for part in parts]))

    def begin(self, stage: str, unit: str) -> None:
        self.events.append((time.monotonic(), "begin", [stage, unit]))

    def reach(self, share: float) -> None:
        self.events.append((time.monotonic(), "reach", [share]))

    def end(self, stage: str) -> None:
        self.events.append((time.monotonic(), "end", [stage]))


class _Noted(Display):
    """Show only warnings, and note what the forecast is told."""

    def __init__(self) -> None:
        super().__init__(Terminal(quiet=True))
        self.forecast: _Recorder = _Recorder()

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        self.forecast.begin(name, "")
        with super().stage(name) as progress:
            yield progress


def tell(name: str, events: Sequence[Event]) -> None:
    """Return the rows of a run, and below them what each part took."""
    now = began = events[0][0]
    forecast = Forecast(lambda: now)
    said: dict[str, list[tuple[float, float | None]]] = {"": []}
    spans = {"": (began, events[-1][0])}
    stage, tick = "", began
    parts: list[list[Any]] = []
    for when, what, values in events:
        while tick < when:
            now = tick
            for one in {"", stage}:
                said.setdefault(one, []).append((tick, forecast.remaining_s(one)))
            tick += _TICK_S
        now = when
        if what == "foresee":
            forecast.expect([Part(*part) for part in values])
        elif what == "begin":
            stage = values[0]
            forecast.begin(*values)
        else:
            getattr(forecast, what)(*values)
        if what != "foresee" and stage:
            spans[stage] = (spans.get(stage, (when, when))[0], when)
        if what in ("begin", "end") and parts:
            parts[-1][3] = min(parts[-1][3], when)
        if what == "begin":
            parts.append([*values, when, events[-1][0]])
        if what == "end":
            stage = ""
    rows = [_row(f"{name}, {one}" if one else f"{name}, in all", *spans[one], said[one]) for one in said]
    print("\n".join(row for row in rows if row), flush=True)
    for stage, unit, began, ended in parts:
        if unit:
            print(f"    {stage} {unit}: {ended - began:.2f} s")


def _row(name: str, began: float, ended: float, said: list[tuple[float, float | None]]) -> str | None:
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
    parser.add_argument("images", type=Path, nargs="*")
    parser.add_argument("--set", action="append", default=[], dest="assignments")
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--again", type=Path, nargs="*", default=[])
    parsed = parser.parse_args()
    print(
        "| set, stage | s | at 1/5 | at 1/2 | at 4/5 | % of the time within 1.5 |\n|---|---|---|---|---|---|"
    )
    for file in parsed.again:
        tell(file.stem, json.loads(file.read_text()))
    for images in parsed.images:
        noted = _Noted()
        with tempfile.TemporaryDirectory() as folder:
            reconstruct(folder, load_options(None, parsed.assignments), images=images, progress=noted)
        events = noted.forecast.events
        if parsed.keep:
            parsed.keep.mkdir(parents=True, exist_ok=True)
            (parsed.keep / f"{images.name}.json").write_text(json.dumps(events))
        tell(images.name, events)


if __name__ == "__main__":
    main()
