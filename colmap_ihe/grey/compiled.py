"""Load the compiled inner loops of the grey room (kernels.c), and hand them NumPy arrays.

Loaded as a plain shared library: ctypes gives up the interpreter's lock for the time of a call, so threads
run side by side. Callers check their arrays, for C does not.
"""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import CapabilityError


def _load() -> ctypes.CDLL:
    path = Path(__file__).with_name("libkernels.so")
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise CapabilityError(
            f"{path}: the compiled part of colmap-ihe cannot be loaded ({error})",
            hint="install colmap-ihe with pip, which builds it, as in `pip install .` in its clone",
        ) from error
    for name in ("occupied", "gather", "pack_cells", "pack_table"):
        getattr(library, name).restype = ctypes.c_size_t
    return library


C = _load()


def check(array: NDArray[np.generic], dtype: type[np.generic], shape: tuple[int, ...]) -> None:
    """Raise ValueError for an array of another dtype or shape, or one that is not C-contiguous."""
    if array.dtype != dtype or array.shape != shape or not array.flags.c_contiguous:
        raise ValueError(f"{array.shape=} {array.dtype=}, expected contiguous {shape} {np.dtype(dtype)}")


def at(array: NDArray[np.generic]) -> ctypes.c_void_p:
    """Return the address of an array, valid until the call is over."""
    return array.ctypes.data_as(ctypes.c_void_p)  # which keeps it alive


length = ctypes.c_size_t
"""A number of things, as C takes it."""
