"""Say what of a lens is free in an adjustment: the steps from COLMAP's own model to richer ones, and the priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from colmap_ihe.colmap.calibration.block import Float64
from colmap_ihe.colmap.calibration.equations import Prior
from colmap_ihe.colmap.calibration.lens import FreeCamera, fitted, tied, turned
from colmap_ihe.colmap.native import parameter_names, pycolmap

PERSPECTIVE = (("SIMPLE_RADIAL", 1), ("RADIAL", 2), ("OPENCV", 4), ("FULL_OPENCV", 5))
FISHEYE = (("SIMPLE_RADIAL_FISHEYE", 1), ("RADIAL_FISHEYE", 2), ("OPENCV_FISHEYE", 4))
"""Camera models of COLMAP's with how many of their coefficients are free, the simplest first. Of FULL_OPENCV the
polynomial alone: the three of its denominator repeat what the others say."""
CENTRE = 0.01
"""Standard deviation of how far real principal points are from the middle, in longer sides."""
FOCAL = 0.05
"""Of a focal length in EXIF, which is rounded, and moves with the focus."""
_ASPECT = (
    0.0003  # of focal lengths across and down: pixels are square, pictures were made smaller to whole ones
)
_COEFFICIENT = {"k": 0.3, "p": 0.001, "s": 0.001}
_TANGENTIAL = ("OPENCV", "FULL_OPENCV")
_TWO_FOCAL_LENGTHS = (*_TANGENTIAL, "OPENCV_FISHEYE")


@dataclass(frozen=True)
class Freedom:
    """Hold the model of a lens, how many of its coefficients are free, and whether its principal point is, and its
    focal lengths across and down are each by itself."""

    model: str
    coefficients: int
    centre: bool = False
    aspect: bool = False

    def richer(self) -> list[Freedom]:
        """Return what is worth a try next: the principal point, and one and two steps up, with it and without; and two
        focal lengths. Tangential coefficients look like a principal point that is off: they come only with it."""
        step = (self.model, self.coefficients)
        ladder = next((ladder for ladder in (PERSPECTIVE, FISHEYE) if step in ladder), (step,))
        at = ladder.index(step)
        tried = [
            Freedom(*one, centre, self.aspect)
            for one in ladder[at : at + 3]
            for centre in (False, True)
            if centre >= max(self.centre, one[0] in _TANGENTIAL)
        ]
        if self.centre:
            squeezed = next((one for one in ladder[at:] if one[0] in _TWO_FOCAL_LENGTHS), step)
            tried.append(Freedom(*squeezed, True, True))
        return [one for one in tried if one != self and (one.model in _TWO_FOCAL_LENGTHS or not one.aspect)]

    def poorer(self, least: Freedom) -> list[Freedom]:
        """Return the steps below, not below that of `least`: the same with fewer coefficients."""
        step, lowest = (self.model, self.coefficients), (least.model, least.coefficients)
        ladder = next((ladder for ladder in (PERSPECTIVE, FISHEYE) if step in ladder), (step,))
        first = ladder.index(lowest) if lowest in ladder else 0
        return [Freedom(*one, self.centre) for one in ladder[first : ladder.index(step)] if not self.aspect]

    def other_kind(self) -> Freedom | None:
        """Return what the lens of a fisheye begins with, of a perspective one, and the other way round."""
        step = (self.model, self.coefficients)
        for own, other in ((PERSPECTIVE, FISHEYE), (FISHEYE, PERSPECTIVE)):
            if step in own:
                return Freedom(*other[1], centre=True)
        return None

    def richest(self) -> Freedom:
        """Return what a lens of this kind can have free at the most."""
        ladder = next(
            (ladder for ladder in (PERSPECTIVE, FISHEYE) if (self.model, self.coefficients) in ladder), None
        )
        if ladder:
            return Freedom(*ladder[-1], True, True)
        return replace(self, centre=True, aspect=self.model in _TWO_FOCAL_LENGTHS)

    @property
    def count(self) -> int:
        """Return the number of parameters that are free, the focal length the first."""
        return 1 + self.coefficients + 2 * self.centre + self.aspect

    @property
    def price(self) -> int:
        """Return for how many parameters these count in a choice. The principal point and the tangential coefficients,
        of which lenses have little, count as one each: their priors hold them where photographs say nothing. Pixels are
        square but for rare pictures, so that two focal lengths are more often what errors of features look like."""
        return self.count - self.centre - (self.model in _TANGENTIAL) + 9 * self.aspect

    def columns_in(self, rich: Freedom) -> list[int]:
        """Return which parameters of a richer freedom these are."""
        after = 1 + rich.coefficients
        centre = [after, after + 1] if self.centre else []
        aspect = [after + 2 * rich.centre] if self.aspect else []
        return [*range(1 + self.coefficients), *centre, *aspect]


def plain(camera: pycolmap.Camera) -> Freedom:
    """Return what COLMAP frees of a camera: all but the principal point, two focal lengths moved alike."""
    return Freedom(camera.model_name, len(camera.extra_params_idxs()))


@dataclass(frozen=True)
class Lens:
    """Hold one lens of the set by the places of its cameras in a list. `quarters`: by how many quarter turns the
    pictures of each are turned against those of the first, as by an editor. None of a lens is free without a
    `freedom`."""

    cameras: tuple[int, ...]
    quarters: tuple[int, ...]
    freedom: Freedom | None


def freed(
    lenses: Sequence[Lens], cameras: Sequence[pycolmap.Camera], known: Sequence[pycolmap.Camera]
) -> tuple[list[FreeCamera], Prior]:
    """Return the cameras as free as their lenses are, and the priors of what is free. `known`: the cameras as they were
    before any adjustment, whose focal lengths may be from EXIF."""
    parts = [_freed(lens, cameras[lens.cameras[0]], known[lens.cameras[0]]) for lens in lenses]
    total = sum(basis.shape[1] for _, basis, _ in parts)
    free: dict[int, FreeCamera] = {}
    offset = 0
    for lens, (start, basis, _) in zip(lenses, parts, strict=True):
        among_all = np.zeros((len(basis), total))
        among_all[:, offset : offset + basis.shape[1]] = basis
        offset += basis.shape[1]
        for camera, quarter in zip(lens.cameras, lens.quarters, strict=True):
            as_first = FreeCamera(start, among_all)
            held = FreeCamera(cameras[camera], np.zeros((len(cameras[camera].params), total)))
            free[camera] = turned(as_first, cameras[camera], quarter) if lens.freedom else held
    prior = Prior(*(np.concatenate([getattr(p, name) for *_, p in parts]) for name in ("mean", "deviation")))
    return [free[n] for n in range(len(cameras))], prior


def _freed(
    lens: Lens, camera: pycolmap.Camera, known: pycolmap.Camera
) -> tuple[pycolmap.Camera, Float64, Prior]:
    if lens.freedom is None:
        return camera, np.zeros((len(camera.params), 0)), Prior(np.zeros(0), np.zeros(0))
    freedom = lens.freedom
    start = fitted(camera, freedom.model, freedom.coefficients)
    coefficients = list(start.extra_params_idxs())[: freedom.coefficients]
    centre = list(start.principal_point_idxs()) if freedom.centre else []
    basis = tied(start, [*coefficients, *centre])
    params, names = np.asarray(start.params), parameter_names(start)
    middle = np.array([start.width, start.height]) / 2
    exif = known.has_prior_focal_length
    means = [known.mean_focal_length() - start.mean_focal_length() if exif else 0.0, *-params[coefficients]]
    deviations = [FOCAL * known.mean_focal_length() if exif else np.inf]
    deviations.extend(_COEFFICIENT.get(names[index][0], np.inf) for index in coefficients)
    if freedom.centre:
        means.extend(middle - params[centre])
        deviations.extend([CENTRE * max(start.width, start.height)] * 2)
    if freedom.aspect:
        across, down = start.focal_length_idxs()
        basis = np.concatenate([basis, np.zeros((len(params), 1))], axis=1)
        basis[[across, down], -1] = 1.0, -1.0
        means.append((params[down] - params[across]) / 2)
        deviations.append(_ASPECT * start.mean_focal_length() / 2)
    return start, basis, Prior(np.array(means, np.float64), np.array(deviations, np.float64))
