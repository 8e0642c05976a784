"""Measure our development of RAW beside LibRaw's own with the same demosaicing: ratios of processor time.

    python benchmarks/develop.py [--size 6000 4000] [--repeats 7]

The file is a DNG of that size, not compressed, so that reading it costs next to nothing: of a camera's own, compressed
files the ratios are lower. Least of several repeats, one thread, in one run.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import rawpy

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.demo.dng import write_dng
from colmap_ihe.evaluation.demo.exif import PhotoExif
from colmap_ihe.photographs.raw.develop import develop
from colmap_ihe.project.recipe import Recipe


def bare(path: Path) -> None:
    with rawpy.imread(str(path)) as raw:
        raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
            gamma=(1, 1),
            no_auto_bright=True,
            output_bps=16,
            use_camera_wb=True,
            output_color=rawpy.ColorSpace.raw,
            user_flip=0,
        )


def seconds(function: Callable[[], object], repeats: int) -> float:
    """Return the processor time of the least of the repeats."""
    times = []
    for _ in range(repeats):
        began = time.thread_time()
        function()
        times.append(time.thread_time() - began)
    return min(times)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, nargs=2, default=(6000, 4000))
    parser.add_argument("--repeats", type=int, default=7)
    parsed = parser.parse_args()
    cv2.setNumThreads(1)
    width, height = parsed.size
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "a.dng"
        mosaic = rng.integers(600, 16000, (height, width), dtype=np.uint16)
        write_dng(
            file,
            mosaic,
            black=512,
            white=16383,
            as_shot_neutral=(0.5, 1, 0.6),
            colour_matrix=np.eye(3),
            exif=PhotoExif(),
        )
        for name, array in (
            ("dark", rng.uniform(500, 520, (height, width)).astype(np.float32)),
            ("flat", rng.uniform(1, 1.5, (height, width)).astype(np.float32)),
            ("bad", rng.integers(0, min(parsed.size), (500, 2))),
        ):
            np.save(Path(folder) / f"{name}.npy", array)
        framed = Recipe(dark=f"{folder}/dark.npy", flat=f"{folder}/flat.npy", bad_pixels=f"{folder}/bad.npy")
        base = seconds(lambda: bare(file), parsed.repeats)
        rows = [("LibRaw, bilinear", f"{base:.2f}", "1")]
        for name, recipe in (
            ("ours", Recipe()),
            ("ours, without green equilibrium", Recipe(green_equilibrium=False)),
            ("ours, with dark frame, flat field and 500 bad pixels", framed),
        ):
            took = seconds(partial(develop, file, recipe), parsed.repeats)
            rows.append((name, f"{took:.2f}", f"{took / base:.2f}"))
    print_table("", rows, ("development", "s", "ratio"))


if __name__ == "__main__":
    main()
