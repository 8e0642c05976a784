"""Compare what the trial of greys says with what whole sets bring: features of all photographs, matches of all pairs.

    python benchmarks/never_worse.py [SET ...] [--greys ihe,green] [--work DIR]

Every row is one grey of one set against COLMAP's default grey: the gain in verified matches over all pairs of the set,
as the mapper would get them, the gain that the trial states with two
standard errors, and the core seconds of the trial. `ihe` is the grey that .998 of the best contrast admits, without
the rule that keeps Rec.709 at .94 of it.
The sets are photographs of ../shared/data at half their size or less, and RAW made from them as `guard_sets.py` makes
it. What is done lies in WORK, where a second run goes on.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from guard_sets import DATA, GAINS, expose, linear_of, read_rgb
from numpy.typing import NDArray

from colmap_ihe.colmap.native import quiet
from colmap_ihe.colmap.part_databases import task_folder
from colmap_ihe.colmap.tried_features import add_pictures, match_pictures
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.fit.counting import CountOptions, gather
from colmap_ihe.fit.fit_set import _SetFit
from colmap_ihe.fit.trial import measure
from colmap_ihe.fit.trial_bench import Trial
from colmap_ihe.fit.trial_result import REFERENCE, TrialResult
from colmap_ihe.grey.contrast import CLOSENESS
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.ihe import fit_cells
from colmap_ihe.grey.weights import Grey, triplets
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.photographs.recipes import with_recipes
from colmap_ihe.photographs.survey import survey
from colmap_ihe.project.options import DevelopOptions, FeaturesOptions, FitOptions

LARGE, SMALL = 1416, 708
QUALITY = 92


def _smaller(path: Path, side: int) -> NDArray[np.uint8]:
    """Return a photograph a whole number of times smaller, with its longer side at most about `side`."""
    rgb = read_rgb(path)
    return read_rgb(path, -(-max(rgb.shape) // side)) if max(rgb.shape) > side * 1.1 else rgb


def jpeg_set(name: str, side: int, folder: Path) -> None:
    for path in sorted((DATA / name).glob("*.[jJ]*")):
        options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]
        cv2.imwrite(str(folder / f"{path.stem}.jpg"), _smaller(path, side)[..., ::-1], options)


def raw_set(name: str, side: int, iso: int, folder: Path) -> None:
    scenes = [linear_of(_smaller(path, side)) for path in sorted((DATA / name).glob("*.[jJ]*"))]
    scenes = [s[: s.shape[0] // 2 * 2, : s.shape[1] // 2 * 2] for s in scenes]
    brightest = float(np.percentile(np.stack([s[::4, ::4] for s in scenes]), 99.8))
    expose([np.asarray(s / brightest, np.float32) for s in scenes], folder, GAINS["a"], iso)


SETS = {
    "sceaux": partial(jpeg_set, "sceaux", LARGE),
    "fountain-p11": partial(jpeg_set, "fountain-p11", LARGE),
    "sacre-coeur": partial(jpeg_set, "sacre-coeur", LARGE),
    "sceaux-small": partial(jpeg_set, "sceaux", SMALL),
    "fountain-p11-small": partial(jpeg_set, "fountain-p11", SMALL),
    "sacre-coeur-small": partial(jpeg_set, "sacre-coeur", SMALL),
    "sceaux-raw-1600-small": partial(raw_set, "sceaux", SMALL, 1600),
    "fountain-raw-400-small": partial(raw_set, "fountain-p11", SMALL, 400),
}


def captures_of(folder: Path) -> list[Capture]:
    """Return the photographs as `reconstruct` has them, RAW with its white balance, which Rec.709 weighs."""
    with local_executor() as executor:
        surveyed, _ = survey(discover(folder).captures, executor, SILENT, strict=True)
        found = with_recipes(surveyed, DevelopOptions(), None, folder, executor, SILENT, strict=True)
    return [s.capture for s in found.surveyed]


def whole(captures: Sequence[Capture], grey: Grey) -> dict[str, Any]:
    """Return verified matches of all pairs, and the number of features."""
    images = [(c.name, to_grey(read_photograph(c).rgb, grey, "sqrt")) for c in captures]
    with task_folder() as folder:
        database = folder / "whole.db"
        ids = add_pictures(database, images, FeaturesOptions(), SILENT)
        found = match_pictures(database, list(combinations(ids, 2)), folder / "parts", SILENT).values()
    features = sum(f.features for f in found) // (len(ids) - 1)
    return {"verified": [len(f.places) for f in found], "features": features}


def greys_of(captures: Sequence[Capture]) -> dict[str, Grey]:
    counting = CountOptions("ihe", "pixel", 1.0, True, True)
    with local_executor() as executor:
        (counts,) = gather(captures, counting, executor, SILENT, {}).values()
        fit = _SetFit(counts, captures, FitOptions(), executor, SILENT, False)
        contrast = counts.contrast.snr_of(grid := triplets(0.01))
        admitted = [t for t, c in zip(grid, contrast, strict=True) if c >= CLOSENESS * contrast.max()]
        paper = fit.weights("paper", fit_cells(counts.histogram, grid).triplet)
        fixed = {name: fit.grey(name) for name in (REFERENCE, "snr", "mean", "green")}
        return {"ihe": fit.flattest(admitted), "paper": paper, **fixed}


def tried(captures: Sequence[Capture], name: str, greys: Mapping[str, Grey]) -> tuple[TrialResult, float]:
    both = {REFERENCE: greys[REFERENCE], name: greys[name]}
    with local_executor() as executor:
        began = os.times()
        result = measure(captures, both, executor, SILENT, Trial(), "choose")
        return result, sum(os.times()[:4]) - sum(began[:4])


def rows_of(name: str, folder: Path, wanted: Sequence[str]) -> list[tuple[str, ...]]:
    if not folder.exists():
        folder.mkdir(parents=True)
        SETS[name](folder)
    captures = captures_of(folder)
    greys = greys_of(captures)
    notes = folder.with_suffix(".json")
    known = json.loads(notes.read_text()) if notes.is_file() else {}
    rows: list[tuple[str, ...]] = []
    for grey in (REFERENCE, *wanted):
        if grey not in known:
            with quiet():
                known[grey] = whole(captures, greys[grey])
            notes.write_text(json.dumps(known))
        if grey == REFERENCE:
            continue
        gain = sum(known[grey]["verified"]) / sum(known[REFERENCE]["verified"]) - 1
        result, seconds = tried(captures, grey, greys)
        stated = (result.held_out or result).of(grey)
        said = f"{100 * stated.gain:+.1f} +- {200 * stated.error:.1f} %" if stated else result.reason
        weights = " ".join(f"{w:.2f}" for w in greys[grey].as_dict()["weights"])
        rows.append((name, grey, weights, f"{100 * gain:+.1f} %", said, f"{seconds:.0f} s"))
        print(*rows[-1], flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="*", default=list(SETS))
    parser.add_argument("--greys", default="ihe,green,paper")
    parser.add_argument("--work", type=Path, default=Path("never-worse-work"))
    parsed = parser.parse_args()
    rows = [r for name in parsed.sets for r in rows_of(name, parsed.work / name, parsed.greys.split(","))]
    print_table("", rows, ("set", "grey", "weights", "whole set", "trial, two errors", "core time"))


if __name__ == "__main__":
    main()
