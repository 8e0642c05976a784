"""Measure what a run uses: memory, disk, open files and threads; and what it does where there is less.

    python benchmarks/limits.py disk PHOTOGRAPHS ...
    python benchmarks/limits.py memory [--views 8] [--size 960 640] [--as GB ...] [--data GB ...]
    python benchmarks/limits.py threads PROJECT

`disk` reconstructs each folder of photographs: by stage the most memory that all its processes held together, and the
most that lay in the project, beside what was estimated before it began. A project that is there already, as
reconstructed, is measured as it is. `memory` runs the demo under no limit, and then under each of several of the
address space (`ulimit -v`) and of the data (`ulimit -d`) of every process: how it ended, seconds, the most that all of
its processes held, and what was said of workers and threads. `threads`: what one stage of COLMAP takes with one and
with two threads, on what a finished project has; and what a process of matching does, on a block of its photographs.
Everything is sampled ten times a second from /proc.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.machine import memory
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline.estimates import bytes_on_disk, needs_of
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.resource_needs import PhotoSetSize
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

TICK_SECONDS = 0.1
QUICK = ("--set", "dense.max_image_size=480", "--set", "mesh.faces=20000")
START = """
import json, os, resource, sys
for kind, most in json.loads(sys.argv[1]):
    resource.setrlimit(kind, (most, most))
os.execv(sys.executable, [sys.executable, "-m", "colmap_ihe.cli", *sys.argv[2:]])
"""


@dataclass
class Seen:
    """Hold the most that was seen, by stage: bytes of memory of all processes and in the project, and open files and
    threads of any one process."""

    memory: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    disk: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    files: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    threads: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    processes: dict[str, int] = field(default_factory=lambda: defaultdict(int))


@dataclass
class Ended:
    status: int
    seconds: float
    output: str
    words: str
    seen: Seen


def descendants(process: int) -> list[int]:
    parents: dict[int, list[int]] = defaultdict(list)
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parents[int((folder / "stat").read_text().rpartition(")")[2].split()[1])].append(
                    int(folder.name)
                )
            except (OSError, ValueError, IndexError):
                continue
    found, left = [], [process]
    while left:
        one = left.pop()
        found.append(one)
        left += parents[one]
    return found


def held(process: int) -> tuple[int, int, int]:
    """Return bytes of memory, shared pages in parts; open files; threads."""
    place = Path("/proc") / str(process)
    try:
        lines = (place / "smaps_rollup").read_text().splitlines()
        size = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("Pss:"))
        return size, len(list((place / "fd").iterdir())), len(list((place / "task").iterdir()))
    except (OSError, StopIteration, ValueError):
        return 0, 0, 0


def size_of(folder: Path) -> int:
    total = 0
    for parent, _, names in os.walk(folder):
        for name in names:
            try:
                total += (Path(parent) / name).lstat().st_size
            except OSError:
                continue
    return total


def sampled(process: int, project: Path, seen: Seen, over: threading.Event) -> None:
    while not over.wait(TICK_SECONDS):
        begun = sorted((project / "records").glob("*.begun.json"))
        stage = begun[0].name.split(".")[0] if begun else "before and after"
        everyone = [held(one) for one in descendants(process)]
        amounts = {
            "memory": sum(size for size, _, _ in everyone),
            "disk": size_of(project),
            "files": max(files for _, files, _ in everyone),
            "threads": max(threads for _, _, threads in everyone),
            "processes": len(everyone),
        }
        for name, amount in amounts.items():
            most = getattr(seen, name)
            most[stage] = max(most[stage], amount)


def run(project: Path, words: Sequence[str], limits: Mapping[int, int] | None = None) -> Ended:
    """Run `colmap-ihe reconstruct` under these limits of `resource`, and watch it."""
    command = [sys.executable, "-c", START, json.dumps(list((limits or {}).items()))]
    command += ["reconstruct", str(project), "--json", "--verbose", *words]
    began, seen, over = time.monotonic(), Seen(), threading.Event()
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(command, stdout=out, stderr=errors)
        watcher = threading.Thread(target=sampled, args=(process.pid, project, seen, over))
        watcher.start()
        process.wait()
        over.set()
        watcher.join()
        out.seek(0)
        errors.seek(0)
        return Ended(process.returncode, time.monotonic() - began, out.read(), errors.read(), seen)


def mega(size: float) -> str:
    return f"{size / 1e6:,.0f}"


def disk(folders: Sequence[Path]) -> None:
    for folder in folders:
        with tempfile.TemporaryDirectory() as temporary:
            project, seen = folder, Seen()
            if not (folder / "records/captures.json").exists():
                project = Path(temporary) / "project"
                project.mkdir()
                ended = run(project, ["--images", str(folder)])
                seen = ended.seen
                print(f"{folder.name}: status {ended.status}, {ended.seconds:.0f} s")
            rows = list(compared(project, seen))
            columns = (
                "stage",
                "estimated, MB",
                "left, MB",
                "most meanwhile, MB",
                "memory estimated, MB",
                "memory, MB",
            )
            print_table(folder.name, rows, columns)


def compared(project: Path, seen: Seen) -> Iterator[tuple[str, ...]]:
    place = Project(project, project / "images")
    record = read_record(place, "captures") or {}
    one = (memory.RAW_BYTES if record["raw"] else memory.JPEG_BYTES) * record["largest"]
    names = ("images", "pixels", "largest", "raw", "with_gps")
    found = needs_of(Options(), PhotoSetSize(**{name: record[name] for name in names}, one_bytes=one))
    left = bytes_on_disk(place)
    for demand in found:
        name = "before and after" if demand.stage == "page" else demand.stage
        wanted = max(demand.memory_bytes(local_workers()), demand.base_bytes + demand.more_bytes)
        amounts = (
            demand.disk_bytes,
            left[demand.stage],
            seen.disk.get(name, 0),
            wanted,
            seen.memory.get(name, 0),
        )
        yield demand.stage, *(mega(amount) if amount else "-" for amount in amounts)
    total = sum(demand.disk_bytes for demand in found)
    most = max([sum(left.values()), *seen.disk.values()])
    yield "all", mega(total), mega(sum(left.values())), mega(most), f"{total / most:.2f} times", ""


def under_limits(views: int, size: tuple[int, int], limits: Sequence[tuple[str, int, float]]) -> None:
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        render_demo(Path(temporary) / "demo", views=views, size=size)
        for number, (name, kind, most) in enumerate([("none", -1, 0.0), *limits]):
            project = Path(temporary) / str(number)
            project.mkdir()
            ended = run(
                project,
                ["--images", f"{temporary}/demo/images", "--set", "fit.step=0.1", *QUICK],
                {} if kind < 0 else {kind: round(most * 1e9)},
            )
            said = [
                line
                for line in ended.words.splitlines()
                if " threads, for each" in line or "it may end" in line
            ]
            result = json.loads(ended.output) if ended.output and not ended.status else {}
            rows.append(
                (
                    f"{name} {most:g} GB" if most else name,
                    str(ended.status),
                    f"{ended.seconds:.0f}",
                    mega(max(ended.seen.memory.values(), default=0)),
                    str(result.get("registered_images", "-")),
                    f"{result.get('dense_points', 0):,}",
                    "; ".join(
                        line.partition(": ")[2] if "colmap_ihe" in line else line.strip() for line in said
                    )
                    or "-",
                )
            )
            print_table("", rows[-1:])
            sys.stdout.flush()
            if ended.status:
                print(ended.words[-300:])
    columns = ("limit", "status", "seconds", "memory, MB", "registered", "dense points", "said")
    print_table("", rows, columns)


ONE_STAGE = """
import shutil, sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from colmap_ihe.colmap.matching_in_blocks import BlockMatching, match_in_blocks
from colmap_ihe.colmap.matching import forget_matches
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.project.options import MatchesOptions
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.pipeline.records import read_record

def held(name):
    return next(int(line.split()[1]) / 1e3 for line in open("/proc/self/status") if line.startswith(name))

stage, threads, root, out = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3]), Path(sys.argv[4])
work, before = root / "workspace", held("VmRSS")
if stage == "features":
    options = pycolmap.FeatureExtractionOptions(num_threads=threads)
    names = sorted(p.relative_to(work / "images").as_posix() for p in (work / "images").rglob("*.*") if p.is_file())
    pycolmap.extract_features(out / "a.db", work / "images", image_names=names[:4], extraction_options=options)
elif stage == "matches":
    shutil.copy(work / "database.db", out / "a.db")
    forget_matches(out / "a.db")
    with pycolmap.Database.open(out / "a.db") as opened:
        ids = [image.image_id for image in opened.read_all_images()]
    before = 0
    pairs = [(one, other) for one in ids for other in ids if one < other]
    with ThreadPoolExecutor(1) as here:
        match_in_blocks(BlockMatching(out / "a.db", pairs, MatchesOptions(), out / "parts", SILENT), here)
else:
    from colmap_ihe.dense.undistort import undistort
    from colmap_ihe.machine.threads import limited
    with limited(threads):
        undistort(work / "sparse/0", work / "images", root / "colour", out / "u", max_image_size=1600)
print(f"{held('VmHWM') - before:.0f}")
"""


def by_threads(project: Path) -> None:
    rows = []
    for stage in ("features", "matches", "undistortion"):
        found = []
        for threads in ("1", "2"):
            with tempfile.TemporaryDirectory() as out:
                command = [sys.executable, "-c", ONE_STAGE, stage, threads, str(project), out]
                done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
                found.append(done.stdout.decode().strip())
        rows.append((stage, *(found if stage != "matches" else (f"{found[0]} in all", "-"))))
    print_table("", rows, ("stage", "MB with one thread", "with two"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    kinds = parser.add_subparsers(dest="kind", required=True)
    kinds.add_parser("disk").add_argument("folders", type=Path, nargs="+")
    under = kinds.add_parser("memory")
    under.add_argument("--views", type=int, default=8)
    under.add_argument("--size", type=int, nargs=2, default=(960, 640))
    under.add_argument("--as", type=float, nargs="*", default=[2.5, 1.6], dest="addresses")
    under.add_argument("--data", type=float, nargs="*", default=[1.2])
    kinds.add_parser("threads").add_argument("project", type=Path)
    parsed = parser.parse_args()
    if parsed.kind == "disk":
        disk(parsed.folders)
    elif parsed.kind == "threads":
        by_threads(parsed.project)
    else:
        limits = [("addresses", resource.RLIMIT_AS, most) for most in parsed.addresses]
        limits += [("data", resource.RLIMIT_DATA, most) for most in parsed.data]
        under_limits(parsed.views, (parsed.size[0], parsed.size[1]), limits)


if __name__ == "__main__":
    main()
