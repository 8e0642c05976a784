"""Make the rules by which the compiled loops give a colour its grey level, exactly, though they compute in float32."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

LEVELS = 256
_FINE = 4

Rules = NDArray[np.float32]
"""(m, 6): red, green, blue, fine, scale, offset; the level of a colour is `floor(floor(fine (red R + green G +
blue B)) scale + offset)`, at most 255. See `parts_rule` and `linear_rules`."""


def parts_rule(numerators: NDArray[np.float64], parts: int) -> Rules | None:
    """Return the nearest level, halves up, of weights that are whole numbers of `parts`; None if they are not whole."""
    whole = np.rint(numerators)
    if np.abs(numerators - whole).max() > 1e-6:
        return None
    offset = 0.5 + (0.5 / parts if parts % 2 == 0 else 0)  # 0.5 / parts from every integer at least
    return np.array([[*whole, 1, 1 / parts, offset]], np.float32)


def linear_rules(triplets: Sequence[tuple[int, int, int]], whites: Sequence[int]) -> Rules:
    """Return levels of linear values: `(i R + j G + k B) * 256 // white`, exactly. `whites` are multiples of 1024."""
    step = np.asarray(whites, np.float64) / LEVELS / _FINE
    if (step % 1 != 0).any() or (step < 1).any():
        raise ValueError(f"{whites=}, expected multiples of {LEVELS * _FINE}")
    rules = np.empty((len(triplets), 6), np.float32)
    rules[:, :3] = triplets
    rules[:, 3] = 1 / _FINE
    rules[:, 4] = 1 / step
    rules[:, 5] = 0.5 / step  # 0.00008 from every integer at least, and float32 errs by 0.00003
    return rules
