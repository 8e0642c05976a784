"""Run the same photographs and options several times, in processes and folders of their own, and compare the files.

    python benchmarks/reproducible.py [PHOTOGRAPHS] [--threads N ...] [--runs N] [--set STAGE.OPTION=VALUE]

For each number of threads (1, then one a core, if none are named) it reconstructs twice; with one thread the last run
is `--from-record` of the first. The table says of each kind of file how many of how many are the same in all runs, byte
for byte. The photographs are the demo's, small and as RAW and JPEG in turn, if none are named.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.project.folder import Project

VIEWS, SIZE = 8, (480, 320)
QUICK = ("fit.step=0.1", "features.colmap.sift.first_octave=0", "dense.max_image_size=240", "mesh.faces=2000")
KINDS = {
    "weights": ("report/weights.yaml",),
    "grey images": ("workspace/images/**/*.png",),
    "colour twins": ("colour/**/*.*",),
    "database": ("workspace/database.db",),
    "cameras, images, points": ("workspace/sparse/*/*.bin",),
    "undistorted images": ("workspace/dense/0/images/**/*.*", "workspace/dense/0/grey/images/**/*.*"),
    "depth and normal maps": ("workspace/dense/0/stereo/*_maps/**/*.bin",),
    "cloud, and what sees it": ("workspace/dense/0/fused.ply*",),
    "mesh": ("workspace/dense/0/mesh.ply",),
    "textured mesh": (
        "workspace/dense/0/mesh.glb",
        "workspace/dense/0/mesh.obj",
        "workspace/dense/0/mesh.jpeg",
    ),
}


def demo_photographs(folder: Path) -> Path:
    """Write the small demo, of each view either the RAW or the JPEG."""
    render_demo(folder, views=VIEWS, size=SIZE)
    for file in (folder / "images").iterdir():
        if (file.suffix == ".dng") != (int(file.stem[-2:]) % 2 == 0):
            file.unlink()
    return folder / "images"


def run(project: Path, images: Path, arguments: Sequence[str]) -> tuple[float, float]:
    """Return seconds, and how many cores were busy."""
    command = [sys.executable, "-m", "colmap_ihe", "reconstruct", str(project), "--images", str(images), "-q"]
    began, before = time.monotonic(), os.times()
    subprocess.run([*command, "--json", *arguments], check=True, stdout=subprocess.DEVNULL)
    seconds, after = time.monotonic() - began, os.times()
    busy = after.children_user + after.children_system - before.children_user - before.children_system
    return seconds, busy / seconds


def digests(project: Path) -> dict[str, dict[str, str]]:
    return {
        kind: {
            file.relative_to(project).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
            for pattern in patterns
            for file in sorted(project.glob(pattern))
            if file.is_file()
        }
        for kind, patterns in KINDS.items()
    }


def same(found: Sequence[Mapping[str, str]]) -> str:
    names = sorted(set().union(*found))
    alike = [name for name in names if len({one.get(name) for one in found}) == 1]
    return f"{len(alike)} of {len(names)}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photographs", type=Path, nargs="?")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, local_workers()])
    parser.add_argument("--runs", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], dest="assignments")
    parser.add_argument("--keep", type=Path, help="a folder for the projects, which are else removed")
    parsed = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        work = parsed.keep or Path(temporary)
        images = parsed.photographs or demo_photographs(work / "demo")
        settings = [*(QUICK if parsed.photographs is None else ()), *parsed.assignments]
        options = [word for assignment in settings for word in ("--set", assignment)]
        columns: dict[str, list[dict[str, dict[str, str]]]] = {}
        for count in parsed.threads:
            words = f"{count} thread" + "s" * (count > 1)
            columns[words] = []
            projects = [
                work / f"{count}-threads" / f"{'in/' * turn}run-{turn}" for turn in range(parsed.runs)
            ]
            for turn, project in enumerate(projects):
                shutil.rmtree(project, ignore_errors=True)
                again = count == 1 and turn and turn == parsed.runs - 1
                asked = ["--from-record", str(projects[0])] if again else ["--threads", str(count), *options]
                seconds, busy = run(project.absolute(), images.absolute(), asked)
                summary = json.loads(Project.at(project, images).summary_file.read_text())
                print(
                    f"{words}{', from the record' * bool(again)}: {summary['registered_images']} of"
                    f" {summary['images']} images, {summary['points3D']} points, {summary['dense_points']} dense,"
                    f" {seconds:.0f} s, {busy:.2f} cores busy",
                    flush=True,
                )
                columns[words].append(digests(project))
        rows = [(kind, *(same([one[kind] for one in found]) for found in columns.values())) for kind in KINDS]
        print_table("files that are the same, byte for byte", rows, ("", *columns))


if __name__ == "__main__":
    main()
