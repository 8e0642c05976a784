"""Measure the fit, side by side in one run: against reading the files, the paper's search and cv2.decolor.

    python benchmarks/fit.py [turns] [sceaux] [synthetic] [memory] [--photographs FOLDER] [--count 1000]

`turns` is the fit against decoding, and `convert` against decoding and encoding, by turns, for both sets. `sceaux` uses
the photographs of ../shared/data/sceaux, `synthetic` makes JPEGs of 1.2 megapixels in a temporary folder. Times are
wall clock on all cores, the best of three where that takes less than a minute; the paper's loop over 5,151 triplets is
timed on 8 of them and scaled.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe import convert_folder
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.fit.fit_set import fit_captures
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.ihe import fit_histogram
from colmap_ihe.grey.weights import triplets
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.png import encode_png
from colmap_ihe.project.options import FitOptions

SCEAUX = Path(__file__).resolve().parents[2] / "shared" / "data" / "sceaux"
PAPER = FitOptions(guard="none")
TIMED = 8  # of the triplets of the paper's loop


def seconds(work: Callable[[], Any], times: int = 3) -> float:
    best = float("inf")
    for _ in range(times):
        began = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - began)
        if best > 20:
            break
    return best


def on_all_cores(work: Callable[[Path], Any], files: Sequence[Path]) -> None:
    with ThreadPoolExecutor(local_workers()) as pool:
        for _ in pool.map(work, files):
            pass


def read_with_opencv(file: Path) -> NDArray[np.uint8]:
    return np.asarray(cv2.imread(str(file), cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION), np.uint8)


def papers_loop(images: Sequence[NDArray[np.uint8]]) -> float:
    """Return the seconds of a NumPy loop over all triplets and the pixels of all images, scaled from a few triplets."""
    grid = triplets()
    chosen = grid[:: len(grid) // TIMED][:TIMED]
    began = time.perf_counter()
    for red, green, blue in chosen:
        counts = np.zeros(256, np.int64)
        for image in images:
            wide = image.astype(np.uint16)
            grey = (red * wide[..., 0] + green * wide[..., 1] + blue * wide[..., 2] + 50) // 100
            counts += np.bincount(grey.ravel(), minlength=256)
        share = counts / counts.sum()
        ((share - 1 / 256) ** 2).sum()
    return (time.perf_counter() - began) / len(chosen) * len(grid)


def loop_over_colours(images: Sequence[NDArray[np.uint8]]) -> float:
    """Return the seconds of the same search in NumPy as anybody would write it who wants it soon: each colour of the
    set is counted once, and the loop over all triplets weighs these; scaled from a few triplets."""
    began = time.perf_counter()
    counts = np.zeros(1 << 24, np.int64)
    for image in images:
        packed = image.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
        counts += np.bincount(packed.ravel(), minlength=1 << 24)
    present = np.flatnonzero(counts)
    weights, channels = counts[present].astype(np.float64), [present >> shift & 255 for shift in (16, 8, 0)]
    counting = time.perf_counter() - began
    grid = triplets()
    chosen = grid[:: len(grid) // TIMED][:TIMED]
    began = time.perf_counter()
    for triplet in chosen:
        grey = (sum(w * c for w, c in zip(triplet, channels, strict=True)) + 50) // 100
        share = np.bincount(grey, weights, 256) / weights.sum()
        ((share - 1 / 256) ** 2).sum()
    return counting + (time.perf_counter() - began) / len(chosen) * len(grid)


class Table:
    """Print rows of times, some of them against the time of another row."""

    def __init__(self) -> None:
        self.times: dict[str, float] = {}
        self.rows: list[tuple[str, str, str, str]] = []

    def add(self, what: str, took: float, *against: str) -> None:
        self.times[what] = took
        if not against:
            self.rows.append((what, f"{took:.3f} s", "", ""))
        for other in against:
            self.rows.append((what, f"{took:.3f} s", other, f"{took / self.times[other]:.3g}"))


def core_seconds() -> float:
    """Return the processor time so far: of this process, and of those that decode for it and still live."""
    taken = time.process_time()
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text(encoding="utf-8").rpartition(")")[2].split()[1])
            if parent == os.getpid():
                taken += int((stat.parent / "schedstat").read_text(encoding="ascii").split()[0]) / 1e9
        except (OSError, ValueError, IndexError):
            continue
    return taken


def turns(folder: Path, title: str) -> None:
    """Time decoding with OpenCV and the fit by turns, then decoding and encoding, and `convert`."""
    captures = discover(folder).captures
    files = [capture.path for capture in captures]
    with local_executor() as executor:
        by_turns(
            title,
            ("decode with OpenCV", lambda: on_all_cores(read_with_opencv, files)),
            (
                "fit, decoding included",
                lambda: fit_captures(captures, FitOptions(), executor, SILENT, strict=True),
            ),
        )
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "out"

        def emptied() -> None:
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir()

        by_turns(
            title,
            ("decode and encode with OpenCV", lambda: on_all_cores(partial(convert_with_opencv, out), files)),
            ("convert: fit, grey, encode, EXIF", lambda: convert_folder(folder, out)),
            emptied,
        )


def convert_with_opencv(out: Path, file: Path) -> None:
    grey = cv2.cvtColor(read_with_opencv(file), cv2.COLOR_RGB2GRAY)
    cv2.imwrite(str(out / f"{file.stem}.png"), grey)


def by_turns(
    title: str,
    first: tuple[str, Callable[[], Any]],
    second: tuple[str, Callable[[], Any]],
    before: Callable[[], None] = lambda: None,
) -> None:
    """Time two functions by turns, by wall clock and processor time, so that what else the machine does hits both
    alike; without the time of `before`, which runs before each."""
    rounds: list[tuple[float, float, float, float]] = []
    before()
    second[1]()  # decoders start
    began = time.perf_counter()
    while len(rounds) < 3 or (time.perf_counter() - began < 60 and len(rounds) < 25):
        took: list[float] = []
        for _, work in (first, second):
            before()
            wall, core = time.perf_counter(), core_seconds()
            work()
            took += [time.perf_counter() - wall, core_seconds() - core]
        rounds.append((took[0], took[2], took[1], took[3]))
    of = np.array(rounds)
    rows = [
        (
            what,
            f"{one.min():.3f} s",
            f"{other.min():.3f} s",
            f"{other.min() / one.min():.2f}",
            f"{middle:.2f}",
        )
        for what, one, other in (("wall clock", of[:, 0], of[:, 1]), ("processor time", of[:, 2], of[:, 3]))
        for middle in (float(np.median(other / one)),)
    ]
    columns = ("", first[0], second[0], "ratio of the best", "median ratio of a round")
    print_table(f"{title}, {len(rounds)} rounds", rows, columns)


def compare(folder: Path, title: str) -> None:
    captures = discover(folder).captures
    files = [capture.path for capture in captures]
    of_file = dict(zip(files, captures, strict=True))
    table = Table()

    def convert_bare(file: Path) -> None:
        grey = np.ascontiguousarray(read_photograph(of_file[file]).rgb[..., 1], np.uint8)
        (out / f"{file.stem}.png").write_bytes(encode_png(grey))

    decoding, coding, bare = (
        "decode with OpenCV",
        "decode and encode with OpenCV",
        "decode and encode, our codecs",
    )
    table.add(decoding, seconds(lambda: on_all_cores(read_with_opencv, files)))
    table.add(
        "decode, our codec", seconds(lambda: on_all_cores(lambda f: read_photograph(of_file[f]), files))
    )
    with local_executor() as executor:
        for options, words in (
            (FitOptions(), "fit, decoding included"),
            (PAPER, "fit without the guard, likewise"),
        ):
            took = seconds(partial(fit_captures, captures, options, executor, SILENT, strict=True))
            table.add(words, took, decoding)
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary)
        table.add(coding, seconds(lambda: on_all_cores(partial(convert_with_opencv, out), files), 2))
        table.add(bare, seconds(lambda: on_all_cores(convert_bare, files), 2))
        runs = iter(range(9))
        took = seconds(lambda: convert_folder(folder, out / str(next(runs))), 2)
        table.add("convert: fit, grey, encode, EXIF", took, coding, bare)

    histogram, counting = Histogram(), 0.0
    for file in files:
        rgb = read_with_opencv(file)
        began = time.perf_counter()
        histogram.add(rgb)
        counting += time.perf_counter() - began
    search = seconds(lambda: fit_histogram(histogram, triplets()))
    some = [read_with_opencv(file) for file in files[:11]]
    loop, patch = "the paper's loop, every pixel", "the paper's loop, its 25 % patchwork"
    colours = "the paper's search over the joint histogram, NumPy"
    quarter = [cv2.resize(i, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_NEAREST) for i in some]
    table.add(loop, papers_loop(some) * len(files) / len(some))
    table.add(patch, papers_loop([np.asarray(q, np.uint8) for q in quarter]) * len(files) / len(some))
    table.add(colours, loop_over_colours([read_with_opencv(file) for file in files]))
    table.add("search alone, without the guard", search)
    table.add("fit of the same pixels in memory", counting + search, colours, patch, loop)
    weights = fit_histogram(histogram, triplets())
    table.add("cv2.decolor, one photograph", seconds(lambda: cv2.decolor(some[0]), 1))
    each = (counting + search) / len(files) + seconds(lambda: to_grey(some[0], weights))
    table.add("fit and grey, one photograph", each, "cv2.decolor, one photograph")
    print_table(title, table.rows, ("what", "time", "against", "ratio"))


def synthetic(folder: Path, count: int) -> Path:
    """Write JPEGs of 1280x960: shaded patches, about as far from grey as photographs are, and noise."""
    folder.mkdir(parents=True, exist_ok=True)

    def make(number: int) -> None:
        rng = np.random.default_rng(number)
        small = (rng.uniform(20, 235, (12, 16, 1)) + rng.normal(0, 20, (12, 16, 3))).astype(np.float32)
        rgb = cv2.resize(small, (1280, 960), interpolation=cv2.INTER_CUBIC)
        grain = rng.normal(0, 6, (960, 1280, 1)).astype(np.float32)
        pixels = np.clip(rgb * rng.uniform(0.5, 1) + grain, 0, 255).astype(np.uint8)
        Image.fromarray(pixels).save(folder / f"{number:05}.jpg", quality=90)

    with ThreadPoolExecutor(local_workers()) as pool:
        list(pool.map(make, range(count)))
    return folder


def memory(folder: Path, counts: Sequence[int]) -> None:
    """Return the peak memory of a fit in a process of its own, without those that decode for it."""
    code = (
        "import sys; from pathlib import Path; from colmap_ihe.pipeline.fit_files import fit_files;"
        "fit_files([Path(p) for p in sys.stdin.read().split()]);"
        # ru_maxrss would be that of this process, of which it is a child
        "print(Path('/proc/self/status').read_text().partition('VmHWM:')[2].split()[0])"
    )
    files = sorted(folder.glob("*.jpg"))
    rows = []
    for count in counts:
        names = "\n".join(str(f) for f in files[:count])
        done = subprocess.run(
            [sys.executable, "-c", code], input=names, capture_output=True, text=True, check=True
        )
        rows.append((f"{count}", f"{int(done.stdout) / 1024:.0f} MB"))
    print_table("peak memory of a fit", rows, ("photographs", "peak"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", default=["turns", "sceaux", "synthetic", "memory"])
    parser.add_argument("--photographs", type=Path, default=SCEAUX)
    parser.add_argument("--count", type=int, default=1000)
    parsed = parser.parse_args()
    cv2.setNumThreads(1)  # one photograph a core, for all alike
    if "turns" in parsed.parts:
        turns(parsed.photographs, f"{parsed.photographs.name}, {local_workers()} cores")
    if "sceaux" in parsed.parts:
        compare(parsed.photographs, f"{parsed.photographs.name}, {local_workers()} cores")
    if {"turns", "synthetic", "memory"} & set(parsed.parts):
        with tempfile.TemporaryDirectory() as temporary:
            made = synthetic(Path(temporary) / "images", parsed.count)
            if "turns" in parsed.parts:
                turns(made, f"{parsed.count} synthetic photographs, {local_workers()} cores")
            if "synthetic" in parsed.parts:
                compare(made, f"{parsed.count} synthetic photographs, {local_workers()} cores")
            if "memory" in parsed.parts:
                memory(made, (10, 100, parsed.count))


if __name__ == "__main__":
    main()
