"""RAW photographs that are developed once for several readings: their linear pixels in a folder.

The folder is a convenience: where there is no room for it, or it cannot be read, the photograph is developed again.
"""

from __future__ import annotations

import os
import shutil
import zipfile
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import rawpy
from numpy.typing import NDArray

from colmap_ihe.machine.files import replace_file
from colmap_ihe.photographs.discover import Capture

_FREE = 4  # times its size has to be free on the disk, for one to be kept


def kept_file(capture: Capture) -> Path | None:
    """Return the file in `capture.recipe.cache_folder` for its pixels; None for a capture that is not kept."""
    recipe = capture.recipe
    if capture.kind != "raw" or not recipe.cache_folder:
        return None
    about = capture.path.stat()
    times = (about.st_size, about.st_mtime_ns, about.st_ctime_ns)
    what = (str(capture.path.absolute()), *times, recipe.identity(), rawpy.libraw_version)
    return Path(recipe.cache_folder) / f"{sha256(repr(what).encode()).hexdigest()[:32]}.npz"


def load(file: Path) -> tuple[NDArray[np.uint16], NDArray[np.float64]] | None:
    """Return linear RGB (H, W, 3) and the matrix to sRGB (3, 3); None if there is no file, or none that is whole."""
    try:
        with np.load(file, allow_pickle=False) as arrays:  # its checksums are checked
            rgb, matrix = arrays["rgb"], arrays["matrix"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    whole = rgb.dtype == np.uint16 and rgb.ndim == 3 and rgb.shape[2] == 3 and matrix.shape == (3, 3)
    return (rgb, matrix) if whole else None


def store(file: Path, rgb: NDArray[Any], matrix: NDArray[np.float64] | None) -> None:
    """Keep a linear photograph, where there is plenty of room."""
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        if shutil.disk_usage(file.parent).free < _FREE * rgb.nbytes:
            return
        temporary = file.with_name(f".{file.name}.{os.getpid()}.tmp")
        try:
            with temporary.open("wb") as opened:
                np.savez(opened, rgb=rgb, matrix=np.asarray(matrix))
            replace_file(temporary, file)
        finally:
            temporary.unlink(missing_ok=True)
