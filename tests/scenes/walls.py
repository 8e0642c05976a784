"""A flat wall, photographed from before it: which photographs see which of its points, as arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.checks.overlap import Places, places_of

Float64 = NDArray[np.float64]


def wall_places(across: Sequence[float], reach: float, distance: float = 5.0) -> tuple[Places, Float64]:
    """The places of a wall 12 by 6 units at z = 0, and the cameras (N, 3) at x = `across` and z = `distance`, each of
    which sees what is within `reach` to its left and right."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0, 12, 0.1), np.arange(0, 6, 0.1)))
    points = np.stack([x, y, np.zeros_like(x)], axis=1)
    centres = np.array([(u, 3.0, distance) for u in across])
    seen = np.abs(points[:, 0, None] - centres[:, 0]) <= reach
    point, image = (np.asarray(n, np.intp) for n in np.nonzero(seen))
    kept = np.flatnonzero(seen.sum(axis=1) > 1)  # as in a model: what one photograph sees is no point
    of = np.full(len(points), -1)
    of[kept] = np.arange(len(kept))
    places = places_of(points[kept], of[point[of[point] >= 0]], image[of[point] >= 0], centres)
    assert places is not None
    return places, centres
