"""The version of this package, and of the libraries that a stage's result depends on."""

from __future__ import annotations

from functools import cache
from importlib import metadata

import cv2
import numpy as np
import rawpy

from colmap_ihe.colmap.native import pycolmap

__version__ = "0.1.0"


def library_versions(*names: str) -> dict[str, str]:
    """Versions of pycolmap, opencv, numpy, rawpy, libraw, pillow, simplejpeg or tifffile, by these names."""
    return {name: _version(name) for name in names}


@cache
def _version(name: str) -> str:
    known = {
        "pycolmap": pycolmap.__version__,
        "opencv": cv2.__version__,
        "numpy": np.__version__,
        "libraw": ".".join(map(str, rawpy.libraw_version)),
    }
    return known.get(name) or metadata.version(name)
