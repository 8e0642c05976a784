"""The version of this package, and of the libraries that a stage's result depends on."""

from __future__ import annotations

from importlib import metadata

import cv2
import rawpy

from colmap_ihe.colmap.native import pycolmap

__version__ = "0.1.0"


def library_versions(*names: str) -> dict[str, str]:
    """Versions of pycolmap, opencv, rawpy or libraw, by these names."""
    known = {
        "pycolmap": pycolmap.__version__,
        "opencv": cv2.__version__,
        "rawpy": metadata.version("rawpy"),
        "libraw": ".".join(map(str, rawpy.libraw_version)),
    }
    return {name: known[name] for name in names}
