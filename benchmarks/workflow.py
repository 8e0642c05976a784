"""Measure how the wider workflow of the paper affects matches: colour balance, denoising, Wallis, each against none.

    python benchmarks/workflow.py [balance | denoise | wallis ...] [--work DIR] [--strength 1]

Photographs at half size as they are, RAW made of them at three ISO (`guard_sets.expose`), and photographs whose
light or white balance differs from one to the next. Each step is done as the product does it, the weights are
fitted with the guard on what comes of it, and correct matches are told by the true geometry: at the 5,000
strongest features an image, the 8,192 coarsest, and what COLMAP keeps by default (whole levels of scale).
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from guard import measure_greys, reference_geometry
from guard_sets import Rgb, Set, linear_of, photographs, raw_set
from numpy.typing import NDArray
from PIL import Image
from tone import WAYS, gain, greys_of

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.grey.wallis import wallis
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.adjust import prepared
from colmap_ihe.photographs.colour_balance import balance_gains
from colmap_ihe.photographs.discover import discover
from colmap_ihe.project.recipe import Recipe

NAMES = ("fountain-p11", "sceaux")
LIGHTS = ((1.0, 1.0, 1.0), (1.3, 1.0, 0.7), (0.75, 1.0, 1.35))
"""What the white balance of a camera left to itself does from one photograph to the next."""
DUSK = ((1.0, 1.0, 1.0), (0.7, 0.6, 0.5), (0.3, 0.35, 0.45))
"""Light that fades and turns blue while photographs are taken."""
COLUMNS = (
    "set",
    "step",
    "features",
    "5,000 strongest",
    "8,192 coarsest",
    "COLMAP's default",
    "s a megapixel",
)


def recoloured(name: str) -> Set:
    """Make coded photographs in unlike white balance."""
    given = photographs(name)
    images: list[Rgb] = []
    for rgb, light in zip(given.images, LIGHTS, strict=True):
        linear = np.minimum(linear_of(np.asarray(rgb, np.uint8)) * np.array(light, np.float32), 1)
        coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        images.append(np.rint(255 * coded).astype(np.uint8))
    return replace(given, images=images)


def saved(images: Sequence[Rgb], folder: Path) -> None:
    folder.mkdir(parents=True)
    for n, rgb in enumerate(images):
        if rgb.dtype == np.uint8:
            Image.fromarray(rgb).save(folder / f"{n}.png", compress_level=1)


def balanced(given: Set, folder: Path) -> list[Rgb]:
    """Balance as `develop.balance`."""
    if not given.mosaics:
        saved(given.images, folder)
    captures = discover(given.mosaics[0].parent if given.mosaics else folder).captures
    with local_executor() as executor:
        gains = balance_gains(captures, executor, SILENT)
    print("gains", {name: tuple(round(g, 3) for g in three) for name, three in gains.items()}, flush=True)
    return [prepared(rgb, Recipe(gains=gains[c.name])) for rgb, c in zip(given.images, captures, strict=True)]


def sets(work: Path) -> dict[str, tuple[tuple[str, ...], Callable[[], Set]]]:
    """Return the sets by name, with the steps that are tried on it."""
    every = ("balance", "denoise", "wallis")
    found: dict[str, tuple[tuple[str, ...], Callable[[], Set]]] = {}
    for name in NAMES:
        short = name.split("-")[0]
        found[f"{short}, JPEG"] = every, partial(photographs, name)
        for iso in (400, 1600, 6400):
            steps = every if iso == 1600 else ("denoise", "wallis")
            found[f"{short}, RAW, ISO {iso}"] = (
                steps,
                partial(raw_set, name, work / f"{short}-{iso}", "a", iso),
            )
        found[f"{short}, JPEG, white balance differs"] = ("balance",), partial(recoloured, name)
        found[f"{short}, RAW, ISO 400, light differs"] = (
            ("balance",),
            partial(raw_set, name, work / f"{short}-dusk", "a", 400, lights=DUSK),
        )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("steps", nargs="*", help="balance, denoise, wallis; all if none is named")
    parser.add_argument("--work", type=Path, help="where the RAW files go, kept; else a temporary folder")
    parser.add_argument("--strength", type=float, default=1.0, help="of the denoising")
    parser.add_argument("--only", default="", help="sets whose name holds this")
    parsed = parser.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # pycolmap.Sift: arrays, not objects
    pycolmap.logging.minloglevel = 2
    cv2.setNumThreads(1)
    began = time.monotonic()
    rows: list[tuple[str, ...]] = []
    geometry: dict[str, dict[tuple[int, int], NDArray[np.float64]]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        work = parsed.work or Path(temporary)
        for name, (possible, make) in sets(work).items():
            steps = [s for s in possible if s in (parsed.steps or possible)]
            if not steps or parsed.only not in name:
                continue
            given = make()
            scene = name.split(",")[0]
            if scene not in geometry:  # the same views in every set of a scene
                reference_geometry(given)
                geometry[scene] = given.fundamental
            given.fundamental = geometry[scene]
            base: dict[str, Any] = {}
            for step in ("none", *steps):
                images, seconds = list(given.images), time.monotonic()
                if step == "balance":
                    images = balanced(given, Path(temporary) / name)
                elif step == "denoise":
                    images = [prepared(rgb, Recipe(denoise=parsed.strength)) for rgb in images]
                seconds = time.monotonic() - seconds
                greys = greys_of(images, "sqrt")
                if step == "wallis":
                    seconds = time.monotonic()
                    greys = [wallis(g) for g in greys]
                    seconds = time.monotonic() - seconds
                row = measure_greys(given, greys)
                base = base or row
                megapixels = sum(g.size for g in greys) / 1e6
                shown = [f"{sum(row[w]):,} ({gain(row, base, w)})" for w in WAYS]
                rows.append((name, step, f"{sum(row['features']):,}", *shown, f"{seconds / megapixels:.2f}"))
                print(*rows[-1], sep=" | ", flush=True)
    print_table("\ncorrect matches, and against none", rows, COLUMNS)
    print(f"{time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
