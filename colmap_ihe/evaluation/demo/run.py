"""The demo: rendered, reconstructed, and held against its truth."""

from __future__ import annotations

from pathlib import Path

from colmap_ihe.errors import ProjectError
from colmap_ihe.evaluation.demo.errors import add_truth
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.machine.progress import Audience
from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
from colmap_ihe.pipeline.rewrite_page import report
from colmap_ihe.project.options_file import project_options


def demo(folder: Path, assignments: list[str], audience: Audience) -> Reconstruction:
    """Renders the demo into `folder`, reconstructs it, and adds its error against the truth."""
    if (folder / "images").exists() and not (folder / "truth").exists():
        raise ProjectError(
            f"{folder}: holds photographs that are not the demo's", hint="name another folder for the demo"
        )
    options = project_options(folder, assignments)
    with audience.stage("render") as watch:
        render_demo(folder, watch=watch)
    done = add_truth(reconstruct(folder, options, audience=audience), folder / "truth")
    if done.project.page_file.exists():
        report(folder, assignments, audience=audience)  # now with the truth
    return done
