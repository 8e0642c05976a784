"""Find coded targets in a grey picture, with their centres to a small part of a pixel.

OpenCV finds and reads the targets. Their outer black squares are then measured here: points along each edge to a part
of a pixel, a straight line through each, and as centre the crossing of the diagonals, which is that of the square from
any direction. Given the camera, the lines are fitted where its lens is taken away.

The name of a target is "T" and its number in the dictionary: T17.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import OptionError, did_you_mean
from colmap_ihe.survey.observations import F64
from colmap_ihe.survey.target_edges import Square, square_of

U8 = npt.NDArray[np.uint8]

DEFAULT_DICTIONARY = "APRILTAG_36h11"
SMALLEST_PX = 12.0
"""Side below which no target is looked for; from 20 px on nearly all are found."""

BORDER_CELLS = 1
"""Width of the black border of a target, in cells."""

_LARGEST_OFF = 0.5  # pixels: a target whose edges are less straight than this is none
_SMALL_PX = 80.0  # candidates up to this side are read again
_CORRECTED = (
    0.2  # of the bits a dictionary could correct: one in 36, for textures are read as targets otherwise
)
_CELL_PX = 8  # of a cell in the picture that is read
_LEAST_CONTRAST = 12
_ALONG, _MOST_PLACES = np.array((0.2, 0.35, 0.5, 0.65, 0.8)), 0.75  # of an edge; of the places along all four


@dataclass(frozen=True)
class Target:
    """Describe one target in one photograph, in COLMAP's pixels (the centre of the top left one is (0.5, 0.5)).

    `corners_px` is (4, 2), clockwise from the target's own top left; `side_px` is the mean length of a side;
    `deviation_px` the standard deviation of each coordinate of the centre.
    """

    name: str
    centre_px: tuple[float, float]
    corners_px: F64
    side_px: float
    deviation_px: float


def find_targets(
    grey: U8, dictionary: str = DEFAULT_DICTIONARY, camera: pycolmap.Camera | None = None
) -> list[Target]:
    """Return the targets of a `dictionary` in a picture (H, W) uint8, in the order of their numbers. `camera` is that
    of the picture, if known. Raises `OptionError` for a dictionary that OpenCV has not."""
    known = dictionary_of(dictionary)
    cells = known.markerSize + 2 * BORDER_CELLS
    targets = []
    for number, corners in _read(grey, known, cells):
        square = square_of(grey, corners, cells, camera)
        if square is not None and square.off_px < _LARGEST_OFF:
            targets.append(_target(number, square))
    return sorted(_distinct(targets), key=lambda target: int(target.name[1:]))


def dictionary_names() -> list[str]:
    """Return the names of OpenCV's dictionaries, without `DICT_`."""
    return [name.removeprefix("DICT_") for name in dir(cv2.aruco) if name.startswith("DICT_")]


def dictionary_of(name: str) -> cv2.aruco.Dictionary:
    """Return a dictionary by OpenCV's name, with or without `DICT_`, in any case. Raises `OptionError`."""
    wanted = name.upper().replace("-", "_").removeprefix("DICT_")
    for known in dictionary_names():
        if known.upper() == wanted:
            return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{known}"))
    hint = did_you_mean(wanted, dictionary_names()) or f"known are {', '.join(dictionary_names())}"
    raise OptionError(f"{name!r} is no dictionary of targets", hint=hint)


def target_name(number: int) -> str:
    """Return the name of target `number` of a dictionary: T17."""
    return f"T{number}"


def _read(grey: U8, dictionary: cv2.aruco.Dictionary, cells: int) -> Iterator[tuple[int, F64]]:
    """Yield number and corners (4, 2), in OpenCV's pixels, of each target that can be read."""
    quads, numbers, unread = _detector(dictionary, max(grey.shape)).detectMarkers(grey)
    if numbers is not None:
        for number, quad in zip(np.ravel(numbers), quads, strict=True):
            yield int(number), np.asarray(quad, np.float64).reshape(4, 2)
    for quad in unread:
        again = _read_again(grey, np.asarray(quad, np.float64).reshape(4, 2), dictionary, cells)
        if again is not None:
            yield again


def _detector(dictionary: cv2.aruco.Dictionary, longest: int) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.minMarkerPerimeterRate = 4 * SMALLEST_PX / longest
    parameters.minMarkerDistanceRate = (
        0.02  # a small target and the white margin around it are two quadrangles
    )
    parameters.perspectiveRemovePixelPerCell = 8
    parameters.errorCorrectionRate = _CORRECTED
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return cv2.aruco.ArucoDetector(dictionary, parameters)


def _read_again(
    grey: U8, corners: F64, dictionary: cv2.aruco.Dictionary, cells: int
) -> tuple[int, F64] | None:
    """Return the number and the corners of a small target that OpenCV found and could not read: with edges measured
    to a part of a pixel the cells are where they are looked for."""
    side = float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean())
    if not SMALLEST_PX <= side <= _SMALL_PX or not _is_dark_within(grey, corners):
        return None
    square = square_of(grey, corners, cells)
    if square is None or square.off_px > _LARGEST_OFF:
        return None
    exact = square.corners_px - 0.5
    bits = _bits(grey, exact, cells)
    if bits is None:
        return None
    is_known, number, turns = dictionary.identify(bits, _CORRECTED)
    return (int(number), np.roll(exact, turns, axis=0)) if is_known else None


def _is_dark_within(grey: U8, corners: F64) -> bool:
    """Tell whether a quadrangle is darker just within its edges than just outside, at most places: the corners of small
    targets are off by a pixel."""
    middle = corners.mean(axis=0)
    edges = corners[:, None] + _ALONG[:, None] * (np.roll(corners, -1, axis=0) - corners)[:, None]
    inside, outside = middle + 0.9 * (edges - middle), middle + 1.15 * (edges - middle)
    last = (grey.shape[1] - 1, grey.shape[0] - 1)
    places = np.rint(np.clip((inside, outside), 0, last)).astype(int)
    dark, bright = grey[places[..., 1], places[..., 0]].astype(int)
    return bool((bright - dark > _LEAST_CONTRAST).mean() >= _MOST_PLACES)


def _bits(grey: U8, corners: F64, cells: int) -> U8 | None:
    """Return the inner cells, 1 where they are white; None where the border around them is not black all over, or the
    margin around that is not white."""
    size = (cells + 2) * _CELL_PX
    own = np.array(((1, 1), (cells + 1, 1), (cells + 1, cells + 1), (1, cells + 1))) * _CELL_PX - 0.5
    to_picture = cv2.getPerspectiveTransform(own.astype(np.float32), corners.astype(np.float32))
    patch = cv2.warpPerspective(grey, to_picture, (size, size), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)
    part = _CELL_PX // 4
    values = patch.reshape(cells + 2, _CELL_PX, cells + 2, _CELL_PX)[:, part:-part, :, part:-part]
    means = values.mean(axis=(1, 3))
    margin = np.concatenate((means[0], means[-1], means[1:-1, 0], means[1:-1, -1]))
    border = np.concatenate((means[1, 1:-1], means[-2, 1:-1], means[2:-2, 1], means[2:-2, -2]))
    middle = (np.median(margin) + np.median(border)) / 2
    if np.median(margin) - np.median(border) < _LEAST_CONTRAST or (border > middle).any():
        return None
    return np.ascontiguousarray(means[2:-2, 2:-2] > middle, np.uint8)


def _target(number: int, square: Square) -> Target:
    x, y = square.centre_px
    return Target(
        name=target_name(number),
        centre_px=(float(x), float(y)),
        corners_px=square.corners_px,
        side_px=square.side_px,
        deviation_px=square.deviation_px,
    )


def _distinct(targets: list[Target]) -> list[Target]:
    """Return the targets without a second find of the same one at the same place."""
    kept: list[Target] = []
    for target in targets:
        same = [other for other in kept if other.name == target.name]
        if all(
            np.hypot(*np.subtract(target.centre_px, other.centre_px)) > other.side_px / 2 for other in same
        ):
            kept.append(target)
    return kept
