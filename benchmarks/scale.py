"""Measure each stage as sets grow, what that gives for a million photographs, and what workers gain.

    python benchmarks/scale.py grow [--small] [--sizes 30 100 300 1000 3000] [--out FOLDER]
    python benchmarks/scale.py workers [--photographs 200] [--workers 2]
    python benchmarks/scale.py paper

`grow` takes photographs of 640x480 on a grid of flight strips over a made-up city (flat, with roofs at three heights,
75 % overlap both ways, GPS and focal length in EXIF), and runs each stage by the command in a process of its own:
core seconds and peak memory from the system, less the core seconds of a command with nothing left to do; sparse and
dense with the page that is written after them. Core seconds, not seconds, for those change little with what else the
machine does. Stages that grow faster than the set end at smaller ones; sizes may be run one by one
into the same FOLDER. Exponents are slopes of log core seconds over log photographs.
`paper` applies its figures, which it keeps in FOLDER, to a million. `workers` runs the per-image stages on
`local:1` and `local:N` in turn, three times, and divides by the cores that were free in the same minute, which it
measures with N busy loops. `--small` is the same at three quarters of the size and with 500 features a photograph
instead of 1,000, so that matching and mapping too can be followed farther.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.machine.threads import local_workers

WIDTH, HEIGHT, STEP = 640, 480, (160, 120)  # pixels on the ground; a quarter of a photograph
FOCAL, FLIGHT = 600.0, 600.0  # pixels, and pixels above the ground, so that there a pixel is a pixel
ROOFS = (0.0, 60.0, 140.0)  # heights of the layers
SIZES = [30, 100, 300, 1000, 3000]
UP_TO = {
    "features": (1000, 3000),
    "exhaustive": (100, 300),
    "spatial": (300, 3000),
    "vocabtree": (100, 3000),
    "sparse": (100, 1000),
    "hierarchical": (100, 3000),
    "dense": (30, 3000),
}
"""Photographs up to which a stage is run here, and of small ones; the others at all sizes."""
FEATURES = tuple(f"features.colmap.sift.max_num_features={most}" for most in (1000, 500))
QUICK = (
    "fit.measure=false",
    "features.colmap.sift.first_octave=0",
    "dense.max_image_size=320",
    "sparse.colmap.ba_refine_focal_length=false",  # it is known, and cannot be told of a flat city seen from above
    "sparse.colmap.ba_refine_extra_params=false",
)
Costs = dict[str, dict[str, tuple[float, float]]]
"""By stage and number of photographs: core seconds, and MB of the largest process."""
METRES = 0.1  # a pixel on the ground
_MEASURED = """
import json, resource, subprocess, sys
status = subprocess.call(sys.argv[2:])
used = resource.getrusage(resource.RUSAGE_CHILDREN)
with open(int(sys.argv[1]), "w") as file:
    json.dump([status, used.ru_utime + used.ru_stime, used.ru_maxrss / 1000], file)
"""
"""Run by a process of its own: the peak memory of a child is at least that of the process that starts it, which here
holds a city."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", choices=("grow", "workers", "paper"))
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "colmap-ihe-scale")
    parser.add_argument("--photographs", type=int, default=200)
    parser.add_argument("--workers", type=int, default=2)
    parsed = parser.parse_args()
    parsed.out.mkdir(parents=True, exist_ok=True)
    if parsed.what == "grow":
        grow(parsed.sizes, parsed.out, parsed.small)
    elif parsed.what == "workers":
        workers(parsed.photographs, parsed.workers)
    else:
        on_paper(json.loads((parsed.out / "costs.json").read_text()))


class City:
    """Make layers of roofs over a ground, each a texture that shows where nothing is above it."""

    def __init__(self, photographs: int, seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        self.across = math.ceil(math.sqrt(photographs))
        down = math.ceil(photographs / self.across)
        size = (down * STEP[1] + 2 * HEIGHT, self.across * STEP[0] + 2 * WIDTH)
        self.layers: list[tuple[NDArray[np.uint8], NDArray[np.uint8]]] = []
        for height in ROOFS:
            shown = np.full(size, 255, np.uint8)
            if height:
                shown[:] = 0
                for _ in range(size[0] * size[1] // 60_000):
                    y, x = (int(random.integers(0, n)) for n in size)
                    cv2.rectangle(shown, (x, y), (x + int(random.integers(40, 140)), y + 90), 255, -1)
            self.layers.append((_texture(size, random), shown))

    def photograph(self, number: int) -> NDArray[np.uint8]:
        """Return (H, W, 3) uint8: looking straight down from a place on the grid."""
        x, y = self.place(number)
        picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        for height, (texture, shown) in zip(ROOFS, self.layers, strict=True):
            scale = FOCAL / (FLIGHT - height)
            to_picture = np.array([[scale, 0, WIDTH / 2 - scale * x], [0, scale, HEIGHT / 2 - scale * y]])
            where = cv2.warpAffine(shown, to_picture, (WIDTH, HEIGHT), flags=cv2.INTER_NEAREST)
            seen = cv2.warpAffine(texture, to_picture, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR)
            picture[where > 0] = seen[where > 0]
        return picture

    def place(self, number: int) -> tuple[float, float]:
        row, column = divmod(number, self.across)
        return WIDTH + column * STEP[0] + 7.3 * (number % 5), HEIGHT + row * STEP[1] + 5.1 * (number % 3)


def _texture(size: tuple[int, int], random: np.random.Generator) -> NDArray[np.uint8]:
    """Draw noise of several scales in colour, with edges: what SIFT finds something in."""
    texture = np.zeros((*size, 3), np.float32)
    for cell in (4, 12, 40):
        small = random.random((size[0] // cell + 2, size[1] // cell + 2, 3), np.float32)
        texture += cv2.resize(small, size[::-1], interpolation=cv2.INTER_CUBIC)
    return np.clip((texture / 3 - 0.2) * 400, 0, 255).astype(np.uint8)


def shoot(project: Path, count: int, small: bool = False) -> None:
    """Write `count` JPEGs with EXIF into project/images, at three quarters of the size if `small`."""
    images = project / "images"
    images.mkdir(parents=True)
    city = City(count)
    for number in range(count):
        exif = Image.Exif()
        exif[0x010F], exif[0x0110] = "Made-up", "Drone"
        exif.get_ifd(0x8769).update({0x920A: 24.0, 0xA405: round(FOCAL / 800 * 43.27)})
        x, y = city.place(number)
        north, east = y * METRES / 110_574, x * METRES / 111_320
        exif.get_ifd(0x8825).update(
            {1: "N", 2: _degrees(north), 3: "E", 4: _degrees(east), 5: b"\0", 6: FLIGHT * METRES}
        )
        picture = Image.fromarray(city.photograph(number))
        if small:
            picture = picture.resize((WIDTH * 3 // 4, HEIGHT * 3 // 4))
        picture.save(images / f"{number:05}.jpg", quality=92, exif=exif)


def _degrees(value: float) -> tuple[float, float, float]:
    whole, rest = divmod(value, 1)
    minutes, rest = divmod(rest * 60, 1)
    return float(whole), float(minutes), rest * 60


def run(project: Path, until: str, *more: str) -> tuple[dict[str, Any], float, float]:
    """Run `reconstruct --until`: the summary, its core seconds, and the peak memory in MB of its largest process."""
    settings = [part for assignment in (*QUICK, *more) for part in ("--set", assignment)]
    command = [
        sys.executable,
        "-m",
        "colmap_ihe.cli",
        "reconstruct",
        str(project),
        "--until",
        until,
        "--json",
        "-q",
    ]
    reading, writing = os.pipe()
    measured = [sys.executable, "-S", "-c", _MEASURED, str(writing), *command, *settings]
    with os.fdopen(reading, encoding="ascii") as usage:
        try:
            output = subprocess.run(measured, stdout=subprocess.PIPE, pass_fds=[writing], check=True).stdout
        finally:
            os.close(writing)
        status, core, memory = json.loads(usage.read())
    if status:
        raise SystemExit(f"reconstruct --until {until} failed for {project}")
    return json.loads(output), core, memory


def grow(sizes: Sequence[int], out: Path, small: bool) -> None:
    file = out / ("costs-small.json" if small else "costs.json")
    features = FEATURES[small]
    up_to = {stage: most[small] for stage, most in UP_TO.items()}
    costs: Costs = json.loads(file.read_text()) if file.exists() else {}
    for count in sizes:
        project = out / f"city-{count}"
        shutil.rmtree(project, ignore_errors=True)
        shoot(project, count, small)

        first = run(project, "captures", features)
        idle = run(project, "captures", features)[1]
        _note(costs, "captures", count, first, idle)

        def measured(
            name: str, until: str, *more: str, at: Path = project, n: int = count, less: float = idle
        ) -> dict[str, Any]:
            found = run(at, until, features, *more)
            _note(costs, name, n, found, less)
            file.write_text(json.dumps(costs))
            return found[0]

        for stage in ("fit", "convert", "features"):
            if count <= up_to.get(stage, count):
                measured(stage, stage)
        for strategy in ("exhaustive", "vocabtree", "spatial"):
            if count <= up_to[strategy]:
                found = measured(strategy, "matches", f"matches.strategy={strategy}")
                print(f"{'':>6} {found['pairs_verified']} pairs verified", flush=True)
        chosen = f"matches.strategy={'spatial' if count <= up_to['spatial'] else 'sequential'}"
        for name, mapper in (("hierarchical", "hierarchical"), ("sparse", "incremental")):
            if count <= up_to[name]:
                found = measured(name, "sparse", chosen, f"sparse.mapper={mapper}")
                print(f"{'':>6} {found['registered_images']} of {count} registered", flush=True)
        if count <= up_to["dense"]:
            mapper = "incremental" if count <= up_to["sparse"] else "hierarchical"
            found = measured("dense", "dense", chosen, f"sparse.mapper={mapper}")
            print(f"{'':>6} {found['dense_points']} points", flush=True)
        shutil.rmtree(project)
    print(f"\n{local_workers()} cores\n")
    tables(costs)


def _note(
    costs: Costs,
    name: str,
    count: int,
    found: tuple[dict[str, Any], float, float],
    idle: float,
) -> None:
    _, core, memory = found
    costs.setdefault(name, {})[str(count)] = (max(0.01, core - idle), memory)
    print(f"{count:>6} {name:<14} {core - idle:>9.2f} core s {memory:>7.0f} MB", flush=True)


def exponent(by_size: dict[int, float]) -> float | None:
    """Return the slope of log core seconds over log photographs, of at least two sizes of 30 and more."""
    known = [(math.log(n), math.log(v)) for n, v in by_size.items() if n >= 30]
    if len(known) < 2:
        return None
    x, y = np.array(known).T
    return float(np.polyfit(x, y, 1)[0])


def tables(costs: Costs) -> None:
    sizes = sorted({int(n) for found in costs.values() for n in found})
    for title, column in (("core seconds", 0), ("peak memory, MB", 1)):
        rows = []
        for name, found in costs.items():
            values = {int(n): cost[column] for n, cost in found.items()}
            slope = exponent(values) if column == 0 else None
            cells = [f"{values[n]:,.{1 if column == 0 else 0}f}" if n in values else "-" for n in sizes]
            rows.append((name, *cells, f"{slope:.2f}" if slope is not None else "-"))
        print_table(title, rows, ("stage", *map(str, sizes), "exponent" if column == 0 else ""))


def on_paper(costs: Costs) -> None:
    """Print core seconds a photograph at the largest size measured, and a million of them on workers."""
    rows = []
    for name, found in costs.items():
        largest = max(map(int, found))
        core = found[str(largest)][0] / largest
        slope = exponent({int(n): cost[0] for n, cost in found.items()}) or 1.0
        spread = name in ("captures", "convert", "features", "exhaustive", "vocabtree", "spatial", "dense")
        power = max(1.0, slope)
        total = core * largest * (1e6 / largest) ** power
        one = _days(total if spread else total / local_workers())
        cells = [one, *(_days(total / n) if spread else "" for n in (100, 1000))]
        rows.append((name, f"{1000 * core:.1f}", f"{power:.2f}", *cells))
    print_table(
        "a million photographs of 0.3 megapixels",
        rows,
        (
            "stage",
            "core ms a photograph",
            "exponent taken",
            "1 worker, or here",
            "100 workers",
            "1000 workers",
        ),
    )


def _days(seconds: float) -> str:
    for unit, size in (("years", 31_557_600), ("days", 86_400), ("h", 3600), ("min", 60)):
        if seconds >= size:
            return f"{seconds / size:,.1f} {unit}"
    return f"{seconds:.0f} s"


def workers(photographs: int, most: int) -> None:
    """Run the per-image stages on one worker and on several, in turn."""
    names = ("captures", "convert", "features")
    found: dict[int, list[dict[str, float]]] = {1: [], most: []}
    free = []
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "source"
        shoot(source, photographs)
        for attempt in range(3):
            for count in found:
                project = Path(folder) / f"{count}-{attempt}"
                project.mkdir()
                (project / "images").symlink_to(source / "images", target_is_directory=True)
                free.append(free_cores(most))
                summary, _, _ = run(project, "features", FEATURES[0], f"cluster.address=local:{count}")
                found[count].append({name: summary["stages"][name] for name in names})
                shutil.rmtree(project)
    rows = []
    cores = median(free)
    for name in (*names, "all three"):
        one, many = (
            median(sum(s.values()) if name == "all three" else s[name] for s in found[n]) for n in (1, most)
        )
        rows.append(
            (name, f"{one:.1f}", f"{many:.1f}", f"{one / many:.2f}", f"{one / many / min(cores, most):.2f}")
        )
    print_table(
        f"{photographs} photographs, {local_workers()} cores, of which {cores:.2f} were free for {most} workers",
        rows,
        ("stage", "1 worker, s", f"{most} workers, s", "speed-up", "of the free cores"),
    )


def free_cores(processes: int) -> float:
    """Return how many times as much so many busy loops do as one does alone."""
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        list(pool.map(spin, [0.01] * processes))
        alone = pool.submit(spin, 1.0).result()
        together = sum(pool.map(spin, [1.0] * processes))
    return together / alone


def spin(seconds: float) -> int:
    """Return how often a little work was done in that time."""
    count, end = 0, time.perf_counter() + seconds
    while time.perf_counter() < end:
        sum(range(1000))
        count += 1
    return count


if __name__ == "__main__":
    main()
