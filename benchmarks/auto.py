"""Measure what `auto` chooses, and what guarded IHE gains over Rec.709 by the same measurement; and the time.

    python benchmarks/auto.py [FOLDER ...]

Folders of photographs; sceaux and fountain-p11 of ../shared/data if none are named. `guard.py` leaves the
simulated RAW sets in its `--work` folder, under `sets`.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.fit.fit_set import Fit, fit_captures
from colmap_ihe.fit.trial_bench import Trial
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import discover
from colmap_ihe.project.options import FitOptions

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def fitted(folder: Path, method: str) -> tuple[Fit, float]:
    captures = discover(folder).captures
    with local_executor() as executor:
        began = time.perf_counter()
        options = FitOptions(method=method)
        return (
            fit_captures(captures, options, executor, SILENT, strict=True, trial=Trial()),
            time.perf_counter() - began,
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="*", default=[DATA / "sceaux", DATA / "fountain-p11"])
    rows: list[tuple[str, ...]] = []
    for folder in parser.parse_args().folders:
        for method in ("ihe", "auto"):
            found, took = fitted(folder, method)
            for encoding, tried in found.tried.items():
                for name, one in tried.measured.candidates:
                    taken = "taken" if name == tried.chosen else ""
                    gain = f"{100 * one.gain:+.1f} +- {100 * one.error:.1f} %"
                    rows.append((folder.name, encoding, method, name, f"{one.inliers:,}", gain, taken))
            chosen = ", ".join(f"{tried.chosen}" for tried in found.tried.values())
            rows.append((folder.name, "", method, "", "", f"{took:.1f} s, all of the fit", chosen))
    print_table("", rows, ("set", "encoding", "method", "grey", "verified", "over Rec.709", ""))


if __name__ == "__main__":
    main()
