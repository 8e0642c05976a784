"""What `compare` costs beside as many runs of `reconstruct`: wall-clock seconds, and their ratio.

    python benchmarks/compare.py [--methods ihe,rec709,rgb2gray,green,photoshop,decolorize] [--seeds 0] [--work DIR]

fountain-p11 at half resolution, from nothing to dense clouds, without meshes. `--seeds 0` is one run of the mapper a
method, as `reconstruct` makes it; with more, `compare` does more, and separate runs would have to be as many more.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

from colmap_ihe.compare import compare
from colmap_ihe.pipeline import reconstruct
from colmap_ihe.project_yaml import load_options
from colmap_ihe.terminal import Bars, print_table

PHOTOGRAPHS = Path(__file__).resolve().parents[2] / "shared" / "data" / "fountain-p11"
HALF = ("features.max_image_size=1536", "dense.max_image_size=1536", "mesh.enabled=false")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", default="ihe,rec709,rgb2gray,green,photoshop,decolorize")
    parser.add_argument("--seeds", type=int, default=0)
    parser.add_argument("--work", type=Path, help="kept; a temporary folder if not given")
    parsed = parser.parse_args()
    methods = parsed.methods.split(",")
    with tempfile.TemporaryDirectory() as temporary:
        work = parsed.work or Path(temporary)
        shutil.rmtree(work / "together", ignore_errors=True)
        (work / "together").mkdir(parents=True)
        began = time.monotonic()
        compare(
            work / "together",
            load_options(None, HALF),
            methods=methods,
            seeds=parsed.seeds,
            images=PHOTOGRAPHS,
            audience=Bars(),
        )
        together = time.monotonic() - began
        began = time.monotonic()
        for method in methods:
            options = load_options(None, [*HALF, f"fit.method={method}"])
            shutil.rmtree(work / method, ignore_errors=True)
            reconstruct(work / method, options, images=PHOTOGRAPHS, audience=Bars())
        apart = time.monotonic() - began
    rows = [
        (f"{len(methods)} runs of reconstruct", f"{apart:.0f} s", ""),
        (f"compare, {parsed.seeds} further runs a method", f"{together:.0f} s", f"{together / apart:.2f}"),
    ]
    print_table("", rows, ("", "time", "ratio"))


if __name__ == "__main__":
    main()
