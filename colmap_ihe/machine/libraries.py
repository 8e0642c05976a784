"""The version of this package, and of the libraries that a stage's result depends on."""

from __future__ import annotations

import hashlib
import zlib  # noqa: F401  before pycolmap, whose own zlib symbols would else be bound to the system's
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path

import cv2
import numpy as np
import PIL.Image  # noqa: F401

import pycolmap as pycolmap  # isort: skip  after zlib, cv2 and PIL; others take it from here
import rawpy

__version__ = "0.2.0"


def library_versions(*names: str) -> dict[str, str]:
    """Return the versions of libraries by name: pycolmap, opencv, numpy, libraw, or any installed package."""
    return {name: _version(name) for name in names}


@cache
def _version(name: str) -> str:
    versions = {
        "pycolmap": pycolmap.__version__,
        "opencv": cv2.__version__,
        "numpy": np.__version__,
        "libraw": ".".join(map(str, rawpy.libraw_version)),
    }
    return versions.get(name) or metadata.version(name)


def package_version(name: str) -> str | None:
    """Return the version of a package, None where it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


@lru_cache(maxsize=1)
def code_digest() -> str:
    """Return a digest of this package's code: two that say the same version may not be the same."""
    package = Path(__file__).parents[1]
    digest = hashlib.blake2b(digest_size=6)
    for file in sorted([*package.rglob("*.py"), *package.rglob("*.so")]):
        digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()
