"""A wall of stone with a painting in two colours that have one Rec.709 grey."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

PAINTED = np.s_[140:260, 320:480]
"""Where the painting is, well within its edge."""
SIZE = (400, 600)
_REC709 = (0.2126, 0.7152, 0.0722)
_RED, _GREEN = np.array((190.0, 110.0, 110.0)), np.array((110.0, 133.78, 110.0))  # of one grey


def painted_wall(*, painting: bool = True, shift: int = 0) -> NDArray[np.uint8]:
    """Return (400, 600, 3) uint8; the whole moved to the right by `shift` pixels."""
    rng = np.random.default_rng(7)
    wall = cv2.GaussianBlur(rng.normal(0, 60, SIZE), (0, 0), 1.5)[..., None] + (150.0, 140.0, 120.0)
    if painting:
        pattern = cv2.GaussianBlur(rng.normal(0, 8, SIZE), (0, 0), 2.5)
        share = 1 / (1 + np.exp(-3 * pattern))[..., None]
        picture = share * _RED + (1 - share) * _GREEN
        wall[120:280, 300:500] = picture[120:280, 300:500]
    wall[:60, :] = (140, 140, 140)  # plain plaster, in which noise is measured
    noisy = np.roll(wall, shift, axis=1) + np.random.default_rng((8, shift)).normal(0, 1, (*SIZE, 3))
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def grey_of(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return COLMAP's default grey of it."""
    return np.asarray(np.rint(colour @ np.array(_REC709)), np.uint8)
