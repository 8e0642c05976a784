"""Reconstruct sets that no survey should hold and some do: the result of each, and what the program says.

    python benchmarks/degenerate.py [SET ...]
    python benchmarks/degenerate.py --models FOLDER ...

The first renders the sets of tests/scenes/odd_sets.py, reconstructs each without dense stereo, and prints a row and the
sentences of each. The second prints what is measured on finished projects, by which docs/degenerate.md sets sound and
folded models apart.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/scenes"))

import odd_sets

from colmap_ihe.colmap.checks.plausibility import cameras_of, shape_of
from colmap_ihe.colmap.checks.repeated_structure import conflicts_of
from colmap_ihe.errors import KnownError
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import load_options

QUICK = ("fit.step=0.1", "fit.measure=false", "features.colmap.sift.first_octave=0", "dense.enabled=false")


def outcome(name: str, project: Path) -> tuple[str, list[str]]:
    """Hold the result of a set and the warnings."""
    odd_sets.SETS[name](project / "images")
    try:
        summary = reconstruct(project, load_options(None, QUICK)).summary
    except KnownError as error:
        return "exit 1", [f"{error} ({error.hint})"]
    models = " + ".join(map(str, summary["models"]))
    return f"{models} of {summary['images']}", summary["warnings"]


def measured(project: Project) -> str:
    model = project.sparse / "0"
    found, shape = conflicts_of(model, project.database), shape_of(model)
    cameras = cameras_of(model, project.database)
    changes = [max(c.focal / c.prior, c.prior / c.focal) for c in cameras if c.prior]
    return " | ".join(
        (
            project.root.name,
            f"{found.most:.2f}",
            f"{len(found.blind)} of {found.near}",
            f"{len(found.torn)} of {found.matched}",
            f"{max(max(c.aspect, 1 / c.aspect) for c in cameras):.3f}",
            f"{max(changes):.3f}" if changes else "-",
            f"{100 * shape.thickness:.1f} %",
        )
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="*", metavar="SET", help=", ".join(odd_sets.SETS))
    parser.add_argument("--models", nargs="+", type=Path, metavar="FOLDER", help="finished projects")
    parsed = parser.parse_args()
    if parsed.models:
        print(
            "| set | most unseen | blind pairs | torn pairs | focal across / down | focal / EXIF | thickness |"
        )
        print("|---|---|---|---|---|---|---|")
        for folder in parsed.models:
            print(f"| {measured(Project(folder.resolve(), folder.resolve() / 'images'))} |")
        return
    work = Path(tempfile.mkdtemp(prefix="degenerate-"))
    for name in parsed.sets or odd_sets.SETS:
        words, said = outcome(name, work / name)
        print(f"| {name} | {words} |", flush=True)
        for text in said:
            print(f"    {text}", flush=True)
        if (work / name / "workspace/sparse/0").is_dir():
            print(f"    | {measured(Project.at(work / name))} |", flush=True)
        shutil.rmtree(work / name)
    shutil.rmtree(work)


if __name__ == "__main__":
    main()
