"""Make points of a cloud, in a frame at UTM offsets."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from colmap_ihe.survey.frames import Frame

OFFSET = (691_000.0, 5_334_100.0, 0.0)
UTM = Frame("EPSG:25832", OFFSET)
KINDS = [*((axis, "<f4") for axis in "xyz"), *((name, "u1") for name in ("red", "green", "blue"))]


def cloud(count: int = 2500) -> npt.NDArray[np.void]:
    """Return made-up points (N,) with colours, within 60 m of the origin."""
    random = np.random.default_rng(3)
    rows = np.zeros(count, KINDS)
    for axis in "xyz":
        rows[axis] = random.uniform(-60, 60, count)
    for name in ("red", "green", "blue"):
        rows[name] = random.integers(0, 256, count)
    return rows


def model_points(rows: npt.NDArray[np.void]) -> npt.NDArray[np.float64]:
    """Return the places (N, 3) of points."""
    return np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
