"""Measure the time of `compare` beside as many runs of `reconstruct`: wall-clock seconds, and their ratio.

    python benchmarks/compare.py [--methods ihe,rec709,rgb2gray,green,photoshop,decolorize] [--seeds 0] [--size 1536]

fountain-p11, from nothing to dense clouds, without meshes; a run of its own and one method more of `compare` by turns,
so that what else the machine does hits both. `--seeds 0` is one run of the mapper a method, as `reconstruct` makes it;
with more, `compare` does more, and separate runs would have to be as many more.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.compare import compare
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.options_file import load_options

PHOTOGRAPHS = Path(__file__).resolve().parents[2] / "shared" / "data" / "fountain-p11"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", default="ihe,rec709,rgb2gray,green,photoshop,decolorize")
    parser.add_argument("--seeds", type=int, default=0)
    parser.add_argument("--size", type=int, default=1536, help="longer side for features and dense stereo")
    parser.add_argument("--work", type=Path, help="kept; a temporary folder if not given")
    parsed = parser.parse_args()
    methods = parsed.methods.split(",")
    small = [f"{stage}.max_image_size={parsed.size}" for stage in ("features", "dense")] + [
        "mesh.enabled=false"
    ]
    together = apart = 0.0
    with tempfile.TemporaryDirectory() as temporary:
        work = parsed.work or Path(temporary)
        shutil.rmtree(work / "together", ignore_errors=True)
        (work / "together").mkdir(parents=True)
        for number, method in enumerate(methods, 1):
            shutil.rmtree(work / method, ignore_errors=True)
            began = time.monotonic()
            reconstruct(
                work / method, load_options(None, [*small, f"fit.method={method}"]), images=PHOTOGRAPHS
            )
            apart += time.monotonic() - began
            began = time.monotonic()
            compare(
                work / "together",
                load_options(None, small),
                methods=methods[:number],
                seeds=parsed.seeds,
                images=PHOTOGRAPHS,
            )
            together += time.monotonic() - began
            print(f"{method}: apart {apart:.0f} s, together {together:.0f} s so far", flush=True)
    rows = [
        (f"{len(methods)} runs of reconstruct", f"{apart:.0f} s", ""),
        (f"compare, {parsed.seeds} further runs a method", f"{together:.0f} s", f"{together / apart:.2f}"),
    ]
    print_table("", rows, ("", "time", "ratio"))


if __name__ == "__main__":
    main()
