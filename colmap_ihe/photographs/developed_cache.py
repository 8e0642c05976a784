"""RAW photographs that are developed once for several readings: their linear pixels in a folder, by what they are of.

What is kept is a convenience: where there is no room for it, or it cannot be read, the photograph is developed again.
"""

from __future__ import annotations

import os
import shutil
import zipfile
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

import numpy as np
import rawpy

from colmap_ihe.photographs.decode import DecodedPhotograph
from colmap_ihe.photographs.discover import Capture

_FREE = 4  # times its size has to be free on the disk, for one to be kept


def kept_file(capture: Capture) -> Path | None:
    """Where `capture.recipe.kept_in` has or will have its pixels; None for a capture that is not kept."""
    recipe = capture.recipe
    if capture.kind != "raw" or not recipe.cache_folder:
        return None
    about = capture.path.stat()
    what = (
        str(capture.path.absolute()),
        about.st_size,
        about.st_mtime_ns,
        about.st_ctime_ns,
        recipe.identity(),
        rawpy.libraw_version,
    )
    return Path(recipe.cache_folder) / f"{sha256(repr(what).encode()).hexdigest()[:32]}.npz"


def load(file: Path) -> DecodedPhotograph | None:
    """None if there is none, or none that is whole."""
    try:
        with np.load(file, allow_pickle=False) as found:  # its checksums are checked
            rgb, matrix = found["rgb"], found["matrix"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    whole = rgb.dtype == np.uint16 and rgb.ndim == 3 and rgb.shape[2] == 3 and matrix.shape == (3, 3)
    return DecodedPhotograph(rgb, "linear", matrix) if whole else None


def store(file: Path, photograph: DecodedPhotograph) -> None:
    """Keeps a linear photograph, where there is plenty of room."""
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        if shutil.disk_usage(file.parent).free < _FREE * photograph.rgb.nbytes:
            return
        temporary = file.with_name(f".{file.name}.{os.getpid()}.tmp")
        try:
            with temporary.open("wb") as opened:
                np.savez(opened, rgb=photograph.rgb, matrix=np.asarray(photograph.srgb_from_camera))
            temporary.replace(file)
        finally:
            temporary.unlink(missing_ok=True)
