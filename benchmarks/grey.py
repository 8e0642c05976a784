"""Measure how the grey affects the sparse model: methods side by side, over several seeds of the mapper.

    python benchmarks/grey.py [PHOTOGRAPHS] [--methods ihe,rec709] [--seeds 3]

Features and matches are made once a method, the mapper runs with every seed; mean and standard deviation. The
photographs are those of ../shared/data/sceaux if none are named.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from statistics import mean, pstdev
from typing import Any

from colmap_ihe.commandline.bars import Terminal, print_table
from colmap_ihe.commandline.display import Display
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.options_file import load_options

SCEAUX = Path(__file__).resolve().parents[2] / "shared" / "data" / "sceaux"
FIGURES = (
    "inlier_matches",
    "registered_images",
    "points3D",
    "points_over_3_views",
    "mean_reprojection_error_px",
)


def summaries(project: Path, photographs: Path, method: str, seeds: int) -> list[dict[str, Any]]:
    found = []
    for seed in range(seeds):
        options = load_options(None, [f"fit.method={method}", f"sparse.seed={seed}", "dense.enabled=false"])
        found.append(
            dict(
                reconstruct(
                    project, options, images=photographs, progress=Display(Terminal(quiet=True))
                ).summary
            )
        )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photographs", type=Path, nargs="?", default=SCEAUX)
    parser.add_argument("--methods", default="ihe,rec709")
    parser.add_argument("--seeds", type=int, default=3)
    parsed = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        for method in parsed.methods.split(","):
            found = summaries(Path(temporary) / method, parsed.photographs, method, parsed.seeds)
            weights = " ".join(f"{w:.2f}" for w in found[0]["weights"])
            spread = [[float(s[name]) for s in found] for name in FIGURES]
            rows.append((method, weights, *(f"{mean(v):.6g} +- {pstdev(v):.3g}" for v in spread)))
    print_table(str(parsed.photographs.name), rows, ("method", "weights", *FIGURES))


if __name__ == "__main__":
    main()
