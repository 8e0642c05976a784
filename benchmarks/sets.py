"""Reconstruct real photographs: one row a set, side by side.

    python benchmarks/sets.py [--work DIR] [--set STAGE.OPTION=VALUE] [SET ...]

Sets are `sceaux`, `fountain-p11` and `sacre-coeur` in ../shared/data, and `demo`. Each is reconstructed
from nothing with the defaults, but fountain-p11 at half resolution, which its marks in the literature are
for, in a process of its own; its memory is that of all its processes together, looked at twice a second. Position
errors of fountain-p11 are in millimetres after a similarity alignment to `gt/`.
"""

from __future__ import annotations

import argparse
import os
import shutil
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, wait
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from limits import descendants, held

import colmap_ihe  # noqa: F401  before pycolmap
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import Terminal, print_table
from colmap_ihe.commandline.display import Display
from colmap_ihe.evaluation.demo.run import demo
from colmap_ihe.evaluation.truth import pose_errors, read_truth
from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
from colmap_ihe.project.options_file import load_options
from colmap_ihe.report.truth_words import truth_rows

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
HALF = ("features.max_image_size=1536", "dense.max_image_size=1536")
SETS = {"demo": (), "sceaux": (), "fountain-p11": HALF, "sacre-coeur": ()}
COLUMNS = (
    "set",
    "registered",
    "models",
    "error px",
    "focal prior",
    "points",
    "dense points",
    "truth",
    "s",
    "peak GB",
)


def run_set(name: str, work: Path, assignments: list[str]) -> tuple[str, ...]:
    """Return one row of the table, but for the memory."""
    project = work / name
    shutil.rmtree(project, ignore_errors=True)
    began = time.monotonic()
    if name == "demo":
        done = demo(project, assignments, Display(Terminal()))
        error = "; ".join(words for _, words in truth_rows(done.summary["truth"])[:2])  # of cameras and depth
    else:
        options = load_options(None, [*SETS[name], *assignments])
        done = reconstruct(project, options, images=DATA / name, progress=Display(Terminal()))
        error = _fountain_error(done) if name == "fountain-p11" else ""
    seconds = time.monotonic() - began
    return _row(name, done.summary, error, seconds)


def _row(name: str, summary: Any, error: str, seconds: float) -> tuple[str, ...]:
    dense = summary["dense_points"]
    return (
        name,
        f"{summary['registered_images']}/{summary['images']}",
        "+".join(map(str, summary["models"])),
        f"{summary['mean_reprojection_error_px']:.3f}",
        str(summary["with_focal_prior"]),
        f"{summary['points3D']:,}",
        f"{dense:,}" if dense is not None else "-",
        error,
        f"{seconds:.0f}",
    )


def row_of(name: str, work: Path, assignments: list[str]) -> tuple[str, ...]:
    """Run `run_set` in a process of its own, and return its memory too."""
    most = 0
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        row = pool.submit(run_set, name, work, assignments)
        while not wait([row], 0.5).done:
            _, *theirs = descendants(os.getpid())
            most = max(most, sum(held(process)[0] for process in theirs))
        return (*row.result(), f"{most / 1e9:.1f}")


def _fountain_error(done: Reconstruction) -> str:
    model = pycolmap.Reconstruction(done.sparse_model)
    poses = {model.images[i].name: model.images[i].cam_from_world().matrix() for i in model.reg_image_ids()}
    errors = pose_errors(poses, read_truth(DATA / "fountain-p11" / "gt"))
    millimetres = [1000 * e for e in errors.position_m.values()]
    mean = sum(millimetres) / len(millimetres)
    return (
        f"position {mean:.2f} mm (max {max(millimetres):.2f}), rotation {errors.rotation_error_deg:.3f} deg"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="*", choices=[*SETS, []], help="all if none is named")
    parser.add_argument(
        "--work", type=Path, help="where the projects go, kept; a temporary folder if not given"
    )
    parser.add_argument("--set", action="append", default=[], dest="assignments")
    parsed = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = parsed.work or Path(temporary)
        rows = []
        for name in parsed.sets or SETS:
            if name != "demo" and not (DATA / name).is_dir():
                print(f"{name}: left out, {DATA / name} is not there")
                continue
            rows.append(row_of(name, work, parsed.assignments))
            print_table("", [rows[-1]], COLUMNS)
    print_table("\nall", rows, COLUMNS)


if __name__ == "__main__":
    main()
