"""The demo: rendered, reconstructed, and held against its truth."""

from __future__ import annotations

from pathlib import Path

from colmap_ihe.errors import ProjectError
from colmap_ihe.evaluation.demo.errors import add_truth
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.machine.progress import RunProgress
from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
from colmap_ihe.pipeline.rewrite_page import report
from colmap_ihe.project.options_file import project_options


def demo(folder: Path, assignments: list[str], progress: RunProgress) -> Reconstruction:
    """Renders the demo into `folder`, reconstructs it, and adds its error against the truth."""
    if (folder / "images").exists() and not (folder / "truth").exists():
        raise ProjectError(
            f"{folder}: holds photographs that are not the demo's", hint="name another folder for the demo"
        )
    options = project_options(folder, assignments)
    with progress.stage("render") as stage_progress:
        render_demo(folder, progress=stage_progress)
    done = add_truth(reconstruct(folder, options, progress=progress), folder / "truth")
    if done.project.page_file.exists():
        report(folder, assignments, progress=progress)  # now with the truth
    return done
