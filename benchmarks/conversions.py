"""Measure the time of each conversion: seconds per megapixel, side by side on one photograph.

    python benchmarks/conversions.py [PHOTOGRAPH] [--size 2832] [--rounds 3] [--methods song,apparent]

The least time of some rounds, after one on a thumbnail that loads what is loaded once. Fitting and converting are
told apart where the fit is over a set. The photograph is the first of ../shared/data/sceaux if none is named. The
table is printed and written to benchmarks/conversions.md.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.grey.conversions import CONVERSIONS, Conversion
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.ihe import fit_weights
from colmap_ihe.grey.srgb import Float32
from colmap_ihe.grey.weights import FIXED, Weights

SCEAUX = Path(__file__).resolve().parents[2] / "shared" / "data" / "sceaux"
COLUMNS = ("conversion", "fit s/MP", "convert s/MP", "s for this photograph")

Pair = tuple[Callable[[Float32], Any] | None, Callable[[Float32, Any], Any]]


def steps(conversion: Conversion) -> Pair:
    """Describe how it is fitted, if to a set, and how it converts what it was fitted to."""
    if conversion.convert is not None:
        convert = conversion.convert
        return None, lambda rgb, _fitted: convert(rgb)
    if conversion.new_fit is not None and conversion.apply is not None:
        new_fit = conversion.new_fit

        def fit(rgb: Float32) -> Any:
            fresh = new_fit()
            fresh.add(rgb)
            return fresh.finish()

        return fit, conversion.apply
    if conversion.name in FIXED:
        weights = Weights(*FIXED[conversion.name], method=conversion.name)
        return None, lambda rgb, _fitted: to_grey(codes(rgb), weights)
    return lambda rgb: fit_weights([codes(rgb)]), lambda rgb, fitted: to_grey(codes(rgb), fitted)


def codes(rgb: Float32) -> Any:
    """Hold the 8-bit photograph again, for the conversions that take it as stored."""
    return np.asarray(rgb * 255 + 0.5, np.uint8)


def seconds(conversion: Conversion, rgb: Float32, rounds: int) -> tuple[float | None, float]:
    fit, convert = steps(conversion)
    small = np.ascontiguousarray(rgb[::16, ::16])
    convert(small, fit(small) if fit else None)
    fits, converts = [], []
    for _ in range(rounds):
        start = time.perf_counter()
        fitted = fit(rgb) if fit else None
        middle = time.perf_counter()
        convert(rgb, fitted)
        fits.append(middle - start)
        converts.append(time.perf_counter() - middle)
    return (min(fits) if fit else None), min(converts)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photograph", type=Path, nargs="?", default=None)
    parser.add_argument("--size", type=int, default=2832, help="pixels of the longer side")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--methods", default=",".join(CONVERSIONS))
    parsed = parser.parse_args()
    file = parsed.photograph or min(SCEAUX.glob("*.JPG"))
    with Image.open(file) as image:
        image.thumbnail((parsed.size, parsed.size), Image.Resampling.LANCZOS)
        rgb = np.asarray(image.convert("RGB"), np.float32) / np.float32(255)
    megapixels = rgb.shape[0] * rgb.shape[1] / 1e6
    rows = []
    for name in parsed.methods.split(","):
        fit, convert = seconds(CONVERSIONS[name], rgb, parsed.rounds)
        cells = [f"{fit / megapixels:.3f}" if fit is not None else "-", f"{convert / megapixels:.3f}"]
        rows.append((name, *cells, f"{(fit or 0) + convert:.2f}"))
    title = f"{file.name}, {rgb.shape[1]} x {rgb.shape[0]}, least of {parsed.rounds}"
    print_table(title, rows, COLUMNS)
    lines = [
        "# Last table of `benchmarks/conversions.py`",
        "",
        f"{title}; {os.cpu_count()} cores, shared with other work; numpy {np.__version__},",
        f"OpenCV {cv2.__version__}. `song`, `realtime` and most of `color2gray` work on a thumbnail or on the",
        "colours that occur, and so cost the same at any size.",
        "",
        "| " + " | ".join(COLUMNS) + " |",
        "|" + "---|" * len(COLUMNS),
        *("| " + " | ".join(row) + " |" for row in rows),
    ]
    Path(__file__).with_suffix(".md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
