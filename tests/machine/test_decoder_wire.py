"""Values between a run and its decoders are of the types that functions are annotated with, however these are spelt."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from colmap_ihe.machine.decoder_wire import from_plain

T = TypeVar("T", bound=np.generic)
Pixels = TypeAliasType("Pixels", np.ndarray[tuple[Any, ...], np.dtype[T]], type_params=(T,))
"""What NDArray is from numpy 2.5 and Python 3.12 on."""


def test_an_array_may_be_annotated_by_an_alias() -> None:
    arrays: list[NDArray[Any]] = [np.arange(3, dtype=np.uint8), np.arange(3, dtype=np.uint16)]
    assert from_plain(0, Pixels[np.uint8], arrays) is arrays[0]
    assert from_plain(1, Pixels[np.uint8] | Pixels[np.uint16], arrays) is arrays[1]
    assert from_plain(None, Pixels[np.uint8] | None, arrays) is None
    with pytest.raises(ValueError, match="pixels of uint16"):
        from_plain(1, Pixels[np.uint8], arrays)
