"""Name the small demo that many tests share, and the folders that they read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from colmap_ihe.project.options import Options

ROOT = Path(__file__).resolve().parents[2]
PHOTOGRAPHS = ROOT.parent / "shared/data"
"""Real photographs; tests that need them skip where they are missing."""
DEMO_VIEWS, DEMO_SIZE = 8, (480, 320)
QUICK = ("fit.step=0.1", "features.colmap.sift.first_octave=0", "dense.max_image_size=240", "mesh.faces=2000")
"""Options with which the small demo still registers all its views, in a third of the time."""
SETTINGS = [part for assignment in QUICK for part in ("--set", assignment)]
"""The same for the command line."""

Make = Callable[..., Path]
"""Of the fixture `new_project`."""
MakeOptions = Callable[..., Options]
"""Of the fixture `quick_options`."""
