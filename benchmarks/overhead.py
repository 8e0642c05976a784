"""Measure the time of `reconstruct` beside bare pycolmap calls on the same grey images with the same options.

    python benchmarks/overhead.py [PHOTOGRAPHS] [--rounds 2] [--dense] [--no-calibration]

Both run in turn, each from nothing, as often as `--rounds` says: the least times and the medians, each with its ratio
to that of bare pycolmap, which is features, exhaustive matching and incremental mapping. `--dense` goes on to the
cloud, the mesh and its texture. `--no-calibration` leaves out our own calibration after mapping, which bare pycolmap
has not either. The photographs are those of ../shared/data/sceaux if none are named.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from statistics import median

from colmap_ihe.colmap.native import logged_to, pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.options_file import load_options

SCEAUX = Path(__file__).resolve().parents[2] / "shared" / "data" / "sceaux"
COLMAP_STAGES = ("features", "matches", "sparse")


def bare(grey: Path, work: Path, model: str) -> None:
    """Run pycolmap as its own tutorial does."""
    shutil.rmtree(work, ignore_errors=True)
    (work / "sparse").mkdir(parents=True)
    names = sorted(p.name for p in grey.iterdir())
    reader = pycolmap.ImageReaderOptions(camera_model=model)
    database = work / "database.db"
    pycolmap.extract_features(database, grey, image_names=names, reader_options=reader)
    pycolmap.match_exhaustive(database)
    pycolmap.incremental_mapping(database, grey, work / "sparse")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photographs", type=Path, nargs="?", default=SCEAUX)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--dense", action="store_true")
    parser.add_argument("--no-calibration", action="store_true")
    parsed = parser.parse_args()
    changes = ["sparse.calibration=colmap"] * parsed.no_calibration + ["dense.enabled=false"] * (
        not parsed.dense
    )
    options = load_options(None, changes)
    seconds: dict[str, list[float]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as temporary:
        project = Path(temporary) / "project"
        for number in range(parsed.rounds):
            shutil.rmtree(project, ignore_errors=True)
            began = time.monotonic()
            done = reconstruct(project, options, images=parsed.photographs)
            whole = time.monotonic() - began
            stages: dict[str, float] = done.summary["stages"]
            model = next(iter(pycolmap.Reconstruction(done.sparse_model).cameras.values())).model.name
            with logged_to(Path(temporary) / "bare.log"):
                began = time.monotonic()
                bare(done.project.grey, Path(temporary) / "bare", model)
                seconds["bare pycolmap"].append(time.monotonic() - began)
            seconds["reconstruct"].append(whole)
            seconds["all but its page"].append(sum(stages.values()))
            seconds["features, matches and sparse"].append(sum(stages[name] for name in COLMAP_STAGES))
            for name, one in stages.items():
                seconds[name].append(one)
            print(
                f"round {number + 1}: " + ", ".join(f"{k} {v[-1]:.1f}" for k, v in seconds.items()),
                flush=True,
            )
    bases = min(seconds["bare pycolmap"]), median(seconds["bare pycolmap"])
    rows = []
    for name, took in seconds.items():
        row = [name]
        for value, base in zip((min(took), median(took)), bases, strict=True):
            row += [f"{value:.1f}", f"{value / base:.2f}"]
        rows.append(row)
    print_table("", rows, ("", "least s", "ratio", "median s", "ratio"))


if __name__ == "__main__":
    main()
