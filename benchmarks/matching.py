"""Compare matching by COLMAP's own threads and by ours: are the matches the same every time, and how long it takes.

    python benchmarks/matching.py [PROJECT] [--rounds 3] [--strategy exhaustive]

Matches the features of PROJECT, else of eight small JPEGs of the demo scene, again and again, by turns: by COLMAP with
one thread, by COLMAP with as many threads as it takes, and as `reconstruct` does. Prints seconds and core seconds of a
round (median), and in how many rounds a pair had other matches or other inliers than in the first. The race in COLMAP
shows on small sets of few features, in one round of a hundred or so.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from statistics import median

from colmap_ihe.colmap.matching import forget_matches, match_features, native_options
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import MatchesOptions
from colmap_ihe.project.options_file import load_options

Matched = dict[int, tuple[bytes, bytes]]
"""By pair its putative matches and its inliers."""


def small_demo(project: Path) -> Path:
    render_demo(project, views=8, size=(480, 320))
    for raw in (project / "images").glob("*.dng"):
        raw.unlink()
    reconstruct(project, load_options(None, ["features.colmap.sift.first_octave=0"]), until="features")
    return project


def by_colmap(database: Path, options: MatchesOptions, threads: int) -> None:
    matching, pairing, verification = native_options(options, options.strategy)
    matching.num_threads = threads
    getattr(pycolmap, f"match_{options.strategy}")(
        database, matching_options=matching, pairing_options=pairing, verification_options=verification
    )


def by_ours(database: Path, options: MatchesOptions) -> None:
    with pycolmap.Database.open(database) as opened:
        images = opened.num_images()
    with local_executor() as executor, tempfile.TemporaryDirectory() as scratch:
        match_features(database, Path(scratch), options, images, executor, SILENT)


def matched(database: Path) -> Matched:
    with pycolmap.Database.open(database) as opened:
        return {
            pair: (
                opened.read_matches(*pycolmap.pair_id_to_image_pair(pair)).tobytes(),
                geometry.inlier_matches.tobytes(),
            )
            for pair, geometry in zip(*opened.read_two_view_geometries(), strict=True)
        }


def core_seconds() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("project", type=Path, nargs="?")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--strategy", choices=("exhaustive", "sequential", "spatial"), default="exhaustive")
    parsed = parser.parse_args()
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    options = MatchesOptions(strategy=parsed.strategy)
    ways: dict[str, Callable[[Path], None]] = {
        "COLMAP, one thread": lambda file: by_colmap(file, options, 1),
        "COLMAP, its threads": lambda file: by_colmap(file, options, -1),
        "ours": lambda file: by_ours(file, options),
    }
    seconds, cores, other = (defaultdict[str, list[float]](list) for _ in range(3))
    first: Matched | None = None
    with tempfile.TemporaryDirectory() as folder:
        database = Path(folder) / "database.db"
        source = Project.at(parsed.project or small_demo(Path(folder) / "demo")).database
        for _ in range(parsed.rounds):
            for name, match in ways.items():
                shutil.copy(source, database)
                forget_matches(database)
                began, core = time.monotonic(), core_seconds()
                match(database)
                seconds[name].append(time.monotonic() - began)
                cores[name].append(core_seconds() - core)
                found = matched(database)
                first = first or found
                other[name].append(found != first)
    rows = [
        (
            name,
            f"{median(seconds[name]):.2f}",
            f"{median(cores[name]):.2f}",
            f"{sum(other[name])} of {parsed.rounds}",
        )
        for name in ways
    ]
    print(f"{len(first or {})} pairs with matches")
    print_table("", rows, ("matched by", "seconds", "core s", "rounds with others"))


if __name__ == "__main__":
    main()
