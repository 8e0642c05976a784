"""Disturb a run at random moments: the same command must end with the same result, and no file be half-written.

    python benchmarks/survive.py --times 100 --seed 1

Every time the demo scene, small, runs anew, and gets SIGKILL, SIGTERM or SIGINT at a moment drawn over the time that
one of its stages took undisturbed, or before all of them, or stands on a disk that is full before it is done. Then
every file under its final name is read
to its end, the disk gets room, and the same command runs again. It survived if that ends well, with the weights, grey
images and colour twins of the undisturbed run to the byte, as many images registered, and cameras as near to the truth.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from PIL import Image

from colmap_ihe.colmap.measures import poses_of
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.dense.ply import read_ply
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.evaluation.truth import Truth, pose_errors, read_truth
from colmap_ihe.pipeline.stages import STAGE_NAMES

QUICK = (
    "fit.step=0.1",
    "features.colmap.sift.first_octave=0",
    "dense.max_image_size=240",
    "mesh.faces=2000",
    "mesh.texture_size=512",
)
LONG = 600.0
KINDS = ("SIGKILL", "SIGTERM", "SIGINT", "full disk")
_BOUND = 3.0  # times the undisturbed run's position error, which itself varies from run to run
_LEAST_M = 0.01
_START = 1.5  # seconds before the first stage
_DISK = 60_000_000  # bytes; the project takes about half


@dataclass(frozen=True)
class Came:
    """Return what a finished project holds: digests of what has to be the same, and what has to be as good."""

    digests: dict[str, str]
    registered: int
    position_m: float


def command(project: Path) -> list[str]:
    settings = [part for assignment in QUICK for part in ("--set", assignment)]
    return [sys.executable, "-m", "colmap_ihe.cli", "reconstruct", str(project), "-q", "--json", *settings]


def finish(project: Path) -> tuple[int, str]:
    """Return exit status and the last line of stderr of an undisturbed run."""
    done = subprocess.run(command(project), capture_output=True, text=True, timeout=LONG, check=False)
    return done.returncode, (done.stderr.strip().splitlines() or [""])[-1]


def came_of(project: Path, truth: Truth) -> Came:
    same = [project / "report/weights.yaml"]
    same += sorted((project / "workspace/images").rglob("*.png")) + sorted(
        (project / "colour").rglob("*.png")
    )
    poses = poses_of(project / "workspace/sparse/0")
    errors = pose_errors(poses, truth)
    return Came(
        {p.relative_to(project).as_posix(): sha256(p.read_bytes()).hexdigest() for p in same},
        len(poses),
        errors.position_error_m,
    )


def partial_files(project: Path) -> list[str]:
    """Return files under their final names in workspace/, colour/, report/ and records/ that are not whole."""
    broken = []
    for folder in ("workspace", "colour", "report", "records"):
        for file in sorted((project / folder).rglob("*")):
            if file.is_file() and not file.name.startswith(".") and file.suffix != ".tmp":
                try:
                    _read(file)
                except Exception as error:  # noqa: BLE001  whatever a half-written file brings a reader to raise
                    broken.append(f"{file.relative_to(project)}: {type(error).__name__}: {error}"[:200])
    return broken


def _read(file: Path) -> None:
    if file.suffix == ".png":
        with Image.open(file) as image:
            image.load()
    elif file.suffix == ".json":
        json.loads(file.read_text(encoding="utf-8"))
    elif file.suffix == ".ply":
        read_ply(file)
    elif file.name == "index.html":
        assert file.read_text(encoding="utf-8").rstrip().endswith("</html>"), "no end"
    elif file.suffix == ".glb":
        assert int.from_bytes(file.read_bytes()[8:12], "little") == file.stat().st_size, "another length"
    elif file.name == "points3D.bin":
        pycolmap.Reconstruction(file.parent)
    elif file.parent.name in ("depth_maps", "normal_maps") and file.suffix == ".bin":
        width, height, planes = (int(n) for n in file.read_bytes().split(b"&", 3)[:3])
        head = len(f"{width}&{height}&{planes}&")
        assert file.stat().st_size == head + 4 * width * height * planes, "another length"


def disturb(project: Path, kind: str, stage: str, after_s: float) -> str:
    """Disturb a run so long after `stage` began, or after the start if it is empty. The stage in which that came."""
    with subprocess.Popen(
        command(project), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    ) as process:
        if kind == "full disk":
            process.wait(LONG)
        else:
            sign = project / f"records/{stage}.begun.json"
            while stage and not sign.exists() and process.poll() is None:
                time.sleep(0.01)
            try:
                process.wait(after_s)
            except subprocess.TimeoutExpired:
                number = signal.Signals[kind]
                if number == signal.SIGINT:  # as Ctrl-C, which the whole group gets
                    os.killpg(process.pid, number)
                else:
                    process.send_signal(number)
            process.wait(LONG)
    begun = [name for name in STAGE_NAMES if (project / f"records/{name}.begun.json").exists()]
    return begun[-1] if begun else "between stages"


@contextmanager
def place(where: Path, size: int | None) -> Iterator[Path]:
    """Make a folder for the project; with `size` on a disk of its own."""
    where.mkdir()
    if size is not None:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(where)], check=True)
    try:
        yield where
    finally:
        if size is not None:
            subprocess.run(["umount", "-l", str(where)], check=True)
        shutil.rmtree(where)


@dataclass(frozen=True)
class Moment:
    """Describe a disturbance: seconds after `stage` began, or after the start if it is empty; of a disk, its size."""

    stage: str
    after_s: float
    share: float


def moment_in(seconds: Mapping[str, float], drawn: random.Random) -> Moment:
    stage, share = drawn.choice(["", *seconds]), drawn.random()
    return Moment(stage, share * max(0.1, seconds.get(stage, _START)), share)


def once(work: Path, images: Path, truth: Truth, kind: str, moment: Moment, wanted: Came) -> tuple[str, str]:
    """Return where it was disturbed, and what went wrong, empty for nothing."""
    size = int(moment.share * _DISK * 0.6) + 200_000 if kind == "full disk" else None
    with place(work / "once", size) as disk:
        project = disk / "project"
        project.mkdir()
        (project / "images").symlink_to(images)
        stage = disturb(project, kind, moment.stage, moment.after_s)
        if broken := partial_files(project):
            return stage, f"half-written: {broken[0]}"
        if size is not None:
            subprocess.run(["mount", "-o", f"remount,size={4 * _DISK}", str(disk)], check=True)
        status, line = finish(project)
        if status:
            return stage, f"exit status {status}: {line}"
        came = came_of(project, truth)
        other = [name for name in wanted.digests if came.digests.get(name) != wanted.digests[name]]
        if other or len(came.digests) != len(wanted.digests):
            return stage, f"other bytes: {', '.join(other[:3])}"
        if came.registered != wanted.registered:
            return stage, f"{came.registered} registered, wanted {wanted.registered}"
        if came.position_m > max(_LEAST_M, _BOUND * wanted.position_m):
            return stage, f"{came.position_m:.4f} m from the truth, undisturbed {wanted.position_m:.4f} m"
        if left := [p for p in project.rglob("*.tmp") if p.is_file()]:
            return stage, f"left behind: {left[0].relative_to(project)}"
    return stage, ""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--times", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parsed = parser.parse_args()
    drawn = random.Random(parsed.seed)
    kinds = [k for k in KINDS if k != "full disk" or (hasattr(os, "geteuid") and os.geteuid() == 0)]
    tried: Counter[tuple[str, str]] = Counter()
    failed: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        render_demo(work / "demo", views=8, size=(480, 320))
        truth = read_truth(work / "demo/truth")
        (work / "demo/jpeg").mkdir()
        for file in sorted((work / "demo/images").glob("*.jpg")):
            shutil.move(file, work / "demo/jpeg" / file.name)
        with place(work / "undisturbed", None) as project:
            (project / "images").symlink_to(work / "demo/jpeg")
            status, line = finish(project)
            if status:
                raise SystemExit(f"the undisturbed run failed: {line}")
            wanted = came_of(project, truth)
            records = {
                name: json.loads((project / f"records/{name}.json").read_text()) for name in STAGE_NAMES
            }
            seconds = {name: float(record["seconds"]) for name, record in records.items()}
        print(
            f"undisturbed: {sum(seconds.values()):.1f} s, {wanted.registered} registered,"
            f" {1000 * wanted.position_m:.1f} mm",
            flush=True,
        )
        for number in range(1, parsed.times + 1):
            kind, moment = kinds[(number - 1) % len(kinds)], moment_in(seconds, drawn)
            stage, wrong = once(work, work / "demo/jpeg", truth, kind, moment, wanted)
            tried[kind, stage] += 1
            if wrong:
                failed.append(f"{number}, {kind} in {stage}: {wrong}")
            print(f"{number:4} {kind:9} {stage:14} {wrong or 'survived'}", flush=True)
    stages = [*STAGE_NAMES, "between stages"]
    rows = [(stage, *(str(tried[kind, stage]) for kind in kinds)) for stage in stages]
    print_table("", rows, ("disturbed in", *kinds))
    print(f"survived {parsed.times - len(failed)} of {parsed.times}")
    for text in failed:
        print(text)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
