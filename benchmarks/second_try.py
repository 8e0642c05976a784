"""Measure which options of COLMAP's mapper help where the camera walks forward down a street.

    python benchmarks/second_try.py [--walks 36]

Each walk is one of tests/scenes/street.py, of ten photographs: its length of step, width, number of points, noise of
path and direction, how far apart two photographs still match, and wrong matches are drawn anew. The camera starts from
COLMAP's guess of the focal length. For each choice of options: of how many walks all ten photographs are registered,
of how many only two, and how far the cameras then are from the truth, at the most, in percent of the walk.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/scenes"))

from street import Street, position_error, write_blank_images, write_street

from colmap_ihe.colmap.mapper_options import native_options
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.colmap.second_try import EASIER, with_changes
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.project.options import SparseOptions

_MOTION, _ANGLE, _REGISTRATION = ({name: value} for name, value in EASIER.items())
CHOICES: Mapping[str, Mapping[str, float]] = {
    "COLMAP's own": {},
    "angle, registration": _ANGLE | _REGISTRATION,
    "forward motion": _MOTION,
    "forward motion, angle": _MOTION | _ANGLE,
    "the three of EASIER": EASIER,
    "and fewer matches": {**EASIER, "init_min_num_inliers": 50},
}


@dataclass
class Outcome:
    """Hold the registered photographs, errors and seconds of each walk."""

    registered: list[int] = field(default_factory=list)
    errors_percent: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


def walk(draw: np.random.Generator, seed: int) -> Street:
    """Return a walk whose sizes are drawn."""

    def one_of(*values: float) -> float:
        return float(draw.choice(values))

    return Street(
        points=int(one_of(350, 600, 1000, 2500)),
        step=one_of(1, 1.5, 2.5),
        half_width=one_of(3, 4, 7),
        wander=one_of(0.03, 0.15),
        turn=one_of(1, 3),
        scale=one_of(1.5, 2),
        angle=one_of(10, 20),
        outliers=one_of(0.05, 0.3),
        seed=seed,
    )


def largest_model(folder: Path, changes: Mapping[str, float]) -> Any:
    options = native_options(with_changes(SparseOptions(), changes))
    options.num_threads = 1
    out = folder / "out"
    out.mkdir(exist_ok=True)
    models = pycolmap.incremental_mapping(folder / "database.db", folder / "grey", out, options=options)
    return max(models.values(), key=lambda model: int(model.num_reg_images()), default=None)


def measure(street: Street, outcomes: Mapping[str, Outcome]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        centres = write_street(street, folder / "database.db")
        write_blank_images(street, folder / "grey")
        length = float(np.linalg.norm(centres[-1] - centres[0]))
        for choice, changes in CHOICES.items():
            began = time.process_time()
            model = largest_model(folder, changes)
            outcome = outcomes[choice]
            outcome.seconds.append(time.process_time() - began)
            outcome.registered.append(model.num_reg_images() if model else 0)
            if outcome.registered[-1] > 2:
                outcome.errors_percent.append(100 * position_error(model, centres) / length)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--walks", type=int, default=36)
    walks, draw = parser.parse_args().walks, np.random.default_rng(5)
    outcomes = {choice: Outcome() for choice in CHOICES}
    with quiet(pycolmap.logging.FATAL):
        for seed in range(walks):
            measure(walk(draw, seed), outcomes)
    rows = []
    for choice, outcome in outcomes.items():
        registered, errors = np.array(outcome.registered), outcome.errors_percent
        rows.append(
            (
                choice,
                f"{(registered == 10).sum()} of {walks}",
                f"{(registered == 2).sum()}",
                f"{np.median(errors):.2f} %" if errors else "-",
                f"{max(errors):.2f} %" if errors else "-",
                f"{np.mean(outcome.seconds):.1f}",
            )
        )
    print_table("", rows, ("options", "all ten", "two", "error, median", "largest", "core s"))


if __name__ == "__main__":
    main()
