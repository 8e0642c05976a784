"""Kill a run in the middle of each stage in turn, and compare what the same command then ends with.

    python benchmarks/resume.py [PHOTOGRAPHS] [--set STAGE.OPTION=VALUE]

The command line runs as a process of its own, gets SIGKILL half-way through the stage (by the time it took
undisturbed), and runs again. A row says which stages the second run ran, and what it ended with beside the
undisturbed run. The photographs are those of ../shared/data/sceaux, at a third of their size, if none are named.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.pipeline.stages import STAGE_NAMES
from colmap_ihe.project.folder import Project

SCEAUX = Path(__file__).resolve().parents[2] / "shared" / "data" / "sceaux"
SMALL = ("features.max_image_size=944", "dense.max_image_size=944")


def command(project: Path, images: Path, assignments: list[str]) -> list[str]:
    sets = [word for assignment in assignments for word in ("--set", assignment)]
    arguments = ["reconstruct", str(project), "--images", str(images), "--json", "--quiet", *sets]
    return [sys.executable, "-m", "colmap_ihe.cli", *arguments]


def run(words: list[str]) -> dict[str, Any]:
    done = subprocess.run(words, stdout=subprocess.PIPE, check=True)
    summary: dict[str, Any] = json.loads(done.stdout)
    return summary


def kill_in(stage: str, words: list[str], place: Project, after_s: float) -> bool:
    """Start the command and kill it `after_s` into `stage`; False if it was over before."""
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL)
    while process.poll() is None and not place.begun_file(stage).exists():
        time.sleep(0.005)
    time.sleep(after_s)
    process.send_signal(signal.SIGKILL)
    process.wait()
    return not place.record_file(stage).exists()


def figures(summary: dict[str, Any]) -> tuple[str, str, str]:
    dense = summary["dense_points"]
    error = summary["mean_reprojection_error_px"]
    return (f"{summary['registered_images']}/{summary['images']}", f"{error:.3f}", f"{dense:,}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photographs", type=Path, nargs="?", default=SCEAUX)
    parser.add_argument("--set", action="append", default=None, dest="assignments")
    parsed = parser.parse_args()
    assignments = list(SMALL) if parsed.assignments is None else parsed.assignments
    with tempfile.TemporaryDirectory() as temporary:
        project = Path(temporary) / "project"
        words = command(project, parsed.photographs, assignments)
        undisturbed = run(words)
        rows = [("none", "-", "-", *figures(undisturbed), "all")]
        for stage in STAGE_NAMES:
            shutil.rmtree(project)
            place = Project.at(project, parsed.photographs)
            in_it = kill_in(stage, words, place, undisturbed["stages"][stage] / 2)
            finished = {
                name: place.record_file(name).read_bytes()
                for name in STAGE_NAMES
                if place.record_file(name).exists()
            }
            summary = run(words)
            again = [
                name for name, record in finished.items() if place.record_file(name).read_bytes() != record
            ]
            ran = ", ".join(name for name in STAGE_NAMES if name not in finished)
            rows.append((stage, "yes" if in_it else "no", ", ".join(again) or "none", *figures(summary), ran))
            print_table("", rows[-1:])
    columns = (
        "killed in",
        "in time",
        "finished, run again",
        "registered",
        "error px",
        "dense points",
        "run after it",
    )
    print_table("", rows, columns)


if __name__ == "__main__":
    main()
