"""The version of this package, and of the libraries that a stage's result depends on."""

from __future__ import annotations

import hashlib
import signal
import threading
import zlib  # noqa: F401  before pycolmap, whose own zlib symbols would else be bound to the system's
from functools import cache, lru_cache
from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from colmap_ihe.errors import CapabilityError

if TYPE_CHECKING:
    import pycolmap as pycolmap

__version__ = "0.2.0"
_MODULES = {"opencv": "cv2", "numpy": "numpy"}


class _Later:
    """Stand for pycolmap, which takes longer to import than all else: it is imported as something of it is used."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") and name != "__version__":  # what Python itself and test runners look for
            raise AttributeError(name)
        return getattr(_pycolmap(), name)

    def __dir__(self) -> list[str]:
        return dir(_pycolmap())


if not TYPE_CHECKING:
    pycolmap = _Later()


@cache
def _pycolmap() -> Any:
    """Import pycolmap, after the libraries that it must not come before (docs/decisions/0003-import-order.md)."""
    for name in ("cv2", "PIL.Image"):
        import_module(name)
    stopping = signal.getsignal(signal.SIGTERM)
    try:
        module = import_module("pycolmap")
    except ModuleNotFoundError as error:
        raise CapabilityError(
            "pycolmap is not installed: without it `fit`, `convert` and `develop` work, and nothing else",
            hint="pip install pycolmap, where there is a wheel of it; on other machines see docs/systems.md",
        ) from error
    module.logging.alsologtostderr = False
    # COLMAP's log takes SIGTERM for a crash, and may wait for ever as it writes of it. Only a main thread may say so.
    if stopping is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stopping)
    return module


def library_versions(*names: str) -> dict[str, str]:
    """Return the versions of libraries by name: pycolmap, opencv, numpy, libraw, or any installed package."""
    return {name: _version(name) for name in names}


@cache
def _version(name: str) -> str:
    if name == "pycolmap":
        return str(pycolmap.__version__)
    if name == "libraw":
        return ".".join(map(str, import_module("rawpy").libraw_version))
    return str(import_module(_MODULES[name]).__version__) if name in _MODULES else metadata.version(name)


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
