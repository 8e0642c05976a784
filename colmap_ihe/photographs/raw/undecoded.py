"""Pixels of a RAW file that LibRaw could not decode, and did not say so.

Where compressed data do not begin as they should, LibRaw ends without a word, and the pixels are whatever was in
memory before. So that memory is given a pattern first: what still shows it was not decoded.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rawpy

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine import decoder_wire
from colmap_ihe.machine.child_process import own_words
from colmap_ihe.machine.decoder_process import BROKEN
from colmap_ihe.machine.system import mallopt

_DAMAGED = re.compile(r"data corrupted at|unexpected end of file", re.IGNORECASE)
_BYTE = 0xE7
_PATTERN = _BYTE << 8 | _BYTE  # no sensor's white level
_M_PERTURB = -6  # of glibc's malloc.h: new memory is filled with the complement of this byte
_MOST = 0.001
"""Of the pixels; of a sensor of 16 bits some have the value by chance, one in 65536."""


def unpack(raw: rawpy.RawPy, path: Path) -> None:
    """Have LibRaw decode the pixels of an opened file. Raises `PhotographError` if some are missing, where the
    system's malloc lets us see that: glibc's does."""
    with _patterned_memory():
        raw.unpack()
    missing = np.count_nonzero(raw.raw_image_visible == _PATTERN) / raw.raw_image_visible.size
    if missing > _MOST:
        raise PhotographError(f"{path.name}: {missing:.1%} of its pixels cannot be decoded", hint=BROKEN)


def refuse_damaged(name: str) -> None:
    """Raise `PhotographError` in a decoder whose stderr says that data of the photograph `name` are damaged, of which
    LibRaw does not always raise an error."""
    if decoder_wire.answer_memory is None:  # no decoder
        return
    if _DAMAGED.search(own_words()):
        raise PhotographError(f"{name}: LibRaw found damaged data in it", hint=BROKEN)


@contextmanager
def _patterned_memory() -> Iterator[None]:
    mallopt(_M_PERTURB, _BYTE ^ 0xFF)
    try:
        yield
    finally:
        mallopt(_M_PERTURB, 0)
