"""Choose the backend of dense stereo that this machine has, and run PatchMatch; each backend writes the same files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from colmap_ihe.colmap.native import apply_options, called, cuda_devices, pycolmap
from colmap_ihe.errors import CapabilityError
from colmap_ihe.machine.files import link_or_copy
from colmap_ihe.machine.progress import SILENT, Progress

Backend = Literal["patchmatch", "sgm"]


def pick_backend(requested: Literal["auto", "patchmatch", "sgm"] = "auto") -> Backend:
    """Return the backend that will run. Raises `CapabilityError` if PatchMatch is requested without CUDA."""
    if requested == "auto":
        return "patchmatch" if cuda_devices() else "sgm"
    if requested == "patchmatch" and not cuda_devices():
        raise CapabilityError(
            "dense.backend is 'patchmatch', which needs CUDA, and pycolmap finds no device here",
            hint="install pycolmap-cuda12 on a machine with an NVIDIA GPU, or set dense.backend to 'sgm'",
        )
    return requested


def patchmatch_depth_maps(
    dense_dir: Path, *, options: Mapping[str, Any] | None = None, progress: Progress = SILENT
) -> None:
    """Make depth and normal maps by COLMAP's PatchMatch on CUDA, from the grey images.

    `options` goes to pycolmap.PatchMatchOptions.
    """
    native = patchmatch_options(options or {})
    progress.start(1, "runs of PatchMatch")
    called(pycolmap.patch_match_stereo, dense_dir / "grey", options=native, progress=progress)
    # Linked or copied, not moved: COLMAP skips the maps that it finds in its own workspace.
    for source in (dense_dir / "grey" / "stereo").glob("*_maps/**/*.geometric.bin"):
        target = dense_dir / source.relative_to(dense_dir / "grey")
        link_or_copy(source, target)
    progress.advance()


def patchmatch_options(values: Mapping[str, Any]) -> pycolmap.PatchMatchOptions:
    """Return pycolmap's options with `values` set. Raises `OptionError`."""
    return apply_options(pycolmap.PatchMatchOptions(), values, "dense.patchmatch")
