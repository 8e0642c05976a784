"""Make the contents of a batch page with a project of each kind."""

from __future__ import annotations

import numpy as np

from colmap_ihe.report import pictures
from colmap_ihe.report.contents import BatchContents, Picture, ProjectRow


def thumbnail(alt: str = "A photograph") -> Picture:
    return pictures.picture(np.full((90, 160, 3), 120, np.uint8), alt, 160)


def contents(hostile: str = "", again_s: int | None = None) -> BatchContents:
    figures = {
        "registered images": "8 of 9",
        "mean reprojection error": "0.46 px",
        "dense points": "2,345,678",
    }
    facts, shown = list(figures.items()), thumbnail(f"Photograph {hostile}")
    why, log = f"{hostile} crashed", "../c/batch.log"
    rows = [
        ProjectRow(f"{hostile}arch", "done", "done", "../a/index.html", shown, facts),
        ProjectRow("bridge", "running", "running: dense 3 of 14", "", thumbnail(), [("photographs", "14")]),
        ProjectRow(f"{hostile}chapel", "failed", "crashed", "", None, (), why, hostile, log),
        ProjectRow("dome", "waiting", "waiting", "", None),
    ]
    title, command = f"{hostile}campaign: 4 projects", f"colmap-ihe batch {hostile}"
    return BatchContents(title, "1 of 4 done.", rows, command, "now", again_s, [hostile])
