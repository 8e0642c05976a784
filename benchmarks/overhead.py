"""Measure the time of `reconstruct` beside bare pycolmap calls on the same grey images with the same options.

    python benchmarks/overhead.py [PHOTOGRAPHS] [--rounds 2] [--no-calibration]

Both run in turn, each from nothing, as often as `--rounds` says; the ratio is of the least times. Bare is
features, exhaustive matching and incremental mapping. `--no-calibration` leaves out our own calibration after
mapping, which bare pycolmap has not either. The photographs are those of ../shared/data/sceaux if none are named.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

from colmap_ihe.colmap.native import logged_to, pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.options_file import load_options

SCEAUX = Path(__file__).resolve().parents[2] / "shared" / "data" / "sceaux"


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
    parser.add_argument("--no-calibration", action="store_true")
    parsed = parser.parse_args()
    calibration = ["sparse.calibration=colmap"] if parsed.no_calibration else []
    options = load_options(None, ["dense.enabled=false", *calibration])
    whole, to_the_model, colmap_part, bare_times = [], [], [], []
    with tempfile.TemporaryDirectory() as temporary:
        project = Path(temporary) / "project"
        for number in range(parsed.rounds):
            shutil.rmtree(project, ignore_errors=True)
            began = time.monotonic()
            done = reconstruct(project, options, images=parsed.photographs)
            whole.append(time.monotonic() - began)
            stages = done.summary["stages"]
            to_the_model.append(sum(stages.values()))
            colmap_part.append(sum(stages[name] for name in ("features", "matches", "sparse")))
            model = next(iter(pycolmap.Reconstruction(done.sparse_model).cameras.values())).model.name
            with logged_to(Path(temporary) / "bare.log"):
                began = time.monotonic()
                bare(done.project.grey, Path(temporary) / "bare", model)
                bare_times.append(time.monotonic() - began)
            print(
                f"round {number + 1}: reconstruct {whole[-1]:.1f} s, bare {bare_times[-1]:.1f} s", flush=True
            )
    least = min(bare_times)
    rows = [
        ("bare pycolmap", f"{least:.1f}", "1"),
        ("reconstruct --no-dense, all of it", f"{min(whole):.1f}", f"{min(whole) / least:.3f}"),
        (
            "all but its page",
            f"{min(to_the_model):.1f}",
            f"{min(to_the_model) / least:.3f}",
        ),
        (
            "its features, matches and sparse stages",
            f"{min(colmap_part):.1f}",
            f"{min(colmap_part) / least:.3f}",
        ),
    ]
    print_table("", rows, ("", "s", "ratio"))


if __name__ == "__main__":
    main()
