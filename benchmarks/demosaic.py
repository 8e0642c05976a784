"""Measure how LibRaw's demosaicing methods affect matches and time.

    python benchmarks/demosaic.py [--work DIR]

RAW of known truth is made from photographs (`guard_sets.raw_set`), developed by each, its weights fitted with the
guard, and coded by the square root. Correct matches at an equal budget of the 5,000 strongest features an image, and
of what COLMAP keeps by default, over two pairs; against `linear`, which is bilinear. Time is that of one development,
the least of three.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
from guard import measure_greys, reference_geometry
from guard_sets import raw_set

import colmap_ihe  # noqa: F401  before pycolmap
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.ihe import fit_weights
from colmap_ihe.photographs.raw.develop import develop
from colmap_ihe.project.recipe import Demosaic, Recipe

SHOTS = (("fountain-p11", 400), ("sceaux", 400), ("fountain-p11", 1600), ("sceaux", 1600))
WAYS = ("budget", "default")
COLUMNS = ("set", "demosaicing", "features", "5,000 strongest", "COLMAP's default", "s")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, help="where the RAW files go, kept; else a temporary folder")
    parsed = parser.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # pycolmap.Sift: arrays, not objects
    pycolmap.logging.minloglevel = 2
    cv2.setNumThreads(1)
    rows = []
    gains: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        for name, iso in SHOTS:
            given = raw_set(name, (parsed.work or Path(temporary)) / f"{name}-{iso}", "a", iso)
            reference_geometry(given)
            base: dict[str, Any] = {}
            for demosaic in get_args(Demosaic):  # linear first
                recipe, images, times = Recipe(demosaic=demosaic), [], []
                for path in given.mosaics:
                    began = time.thread_time()
                    images.append(develop(path, recipe).linear_rgb)
                    times.append(time.thread_time() - began)
                weights = fit_weights(images)
                row = measure_greys(
                    replace(given, images=list(images)), [to_grey(i, weights) for i in images]
                )
                base = base or row
                to_linear = [100 * (sum(row[w]) / max(1, sum(base[w])) - 1) for w in WAYS]
                gains.setdefault(demosaic, []).append(to_linear[0])
                shown = [f"{sum(row[w]):,} ({g:+.1f} %)" for w, g in zip(WAYS, to_linear, strict=True)]
                found = f"{sum(row['features']):,}"
                rows.append(
                    (f"{name.split('-')[0]}, ISO {iso}", demosaic, found, *shown, f"{min(times):.2f}")
                )
                print(*rows[-1], sep=" | ", flush=True)
    print_table("", rows, COLUMNS)
    print_table("mean of the sets", [(d, f"{np.mean(g):+.1f} %") for d, g in gains.items()])


if __name__ == "__main__":
    main()
