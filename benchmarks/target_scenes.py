"""Pictures of one coded target, seen from any direction, blurred and noisy, with its true centre."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from colmap_ihe.survey.sheet_layout import MARGIN_CELLS
from colmap_ihe.survey.targets import BORDER_CELLS, DEFAULT_DICTIONARY, dictionary_of

_FOCAL_PX = 1200.0
_FINER = 16
_CELL = 20  # pixels of the pattern


@dataclass(frozen=True)
class Sight:
    """How a target is seen: its side before it is tilted, the angle between its normal and the ray, and the picture:
    standard deviations of blur in pixels and of noise in levels, and the levels of black and white."""

    side_px: float
    tilt_deg: float
    blur_px: float = 0.7
    noise: float = 3.0
    black: float = 50.0
    white: float = 190.0


@dataclass(frozen=True)
class TargetPicture:
    """A picture (H, W) uint8 of target `number`, and the true centre and corners (4, 2) in COLMAP's pixels."""

    grey: npt.NDArray[np.uint8]
    number: int
    centre_px: npt.NDArray[np.float64]
    corners_px: npt.NDArray[np.float64]

    @property
    def side_px(self) -> float:
        """The mean length of a side in the picture."""
        return float(np.linalg.norm(np.roll(self.corners_px, -1, axis=0) - self.corners_px, axis=1).mean())


def target_picture(
    sight: Sight, rng: np.random.Generator, dictionary: str = DEFAULT_DICTIONARY
) -> TargetPicture:
    """A target of a random number, turned at random, on a wall of middle grey."""
    known = dictionary_of(dictionary)
    number = int(rng.integers(len(known.bytesList)))
    size = int(2.2 * sight.side_px + 20)
    centre = size / 2 + rng.uniform(-0.5, 0.5, 2)
    corners = _seen_corners(sight, rng) + centre
    cells = known.markerSize + 2 * BORDER_CELLS
    pattern = cv2.aruco.generateImageMarker(known, number, cells * _CELL)
    margin = MARGIN_CELLS * _CELL
    pattern = cv2.copyMakeBorder(pattern, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=(255,))
    own = np.array(((0, 0), (1, 0), (1, 1), (0, 1))) * cells * _CELL + margin - 0.5
    there = corners * _FINER - 0.5
    to_picture = cv2.getPerspectiveTransform(own.astype(np.float32), there.astype(np.float32))
    fine = cv2.warpPerspective(pattern, to_picture, (size * _FINER, size * _FINER), borderValue=(120,))
    seen = cv2.resize(fine.astype(np.float32), (size, size), interpolation=cv2.INTER_AREA)
    if sight.blur_px:
        seen = cv2.GaussianBlur(seen, (0, 0), sight.blur_px)
    levels = sight.black + (sight.white - sight.black) * seen / 255 + rng.normal(0, sight.noise, seen.shape)
    return TargetPicture(np.clip(np.rint(levels), 0, 255).astype(np.uint8), number, centre, corners)


def _seen_corners(sight: Sight, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """(4, 2): corners in pixels, from where the centre is seen."""
    square = np.array(((-0.5, -0.5, 0), (0.5, -0.5, 0), (0.5, 0.5, 0), (-0.5, 0.5, 0)))
    turned = square @ _turn((0, 0, rng.uniform(0, 360))).T @ _turn((sight.tilt_deg, 0, 0)).T
    points = turned @ _turn((0, 0, rng.uniform(0, 360))).T + (0, 0, _FOCAL_PX / sight.side_px)
    return np.asarray(points[:, :2] / points[:, 2:] * _FOCAL_PX)


def _turn(angles_deg: tuple[float, float, float]) -> npt.NDArray[np.float64]:
    return np.asarray(cv2.Rodrigues(np.radians(angles_deg))[0])
