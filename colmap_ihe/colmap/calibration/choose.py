"""Choose what of each lens the photographs determine, step by step from COLMAP's model to richer ones.

A step is taken where the robust cost falls by more than chance lowers it for as many parameters, as by Akaike's and
Schwarz's criteria; held-out points judge the outcome (held_out.py). Of fits that are about as good the simplest counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from colmap_ihe.colmap.calibration.adjust import MOST_STEPS, Adjusted, adjust, cleaned
from colmap_ihe.colmap.calibration.block import Block
from colmap_ihe.colmap.calibration.equations import solved, system_of, without_poses
from colmap_ihe.colmap.calibration.freedom import Freedom, Lens, freed, plain
from colmap_ihe.colmap.calibration.lens import derivatives
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.progress import SILENT, Progress

A_PARAMETER = 9.0
"""By how much each parameter that is free must lower the cost, in units of sigma squared."""
ABOUT = 6.0
"""Of the cost: fits nearer to each other than this are as good, adjustments end that near to their minimum."""
_MOST_ROUNDS = 6
WIDE = 0.8
"""Half the diagonal in focal lengths, from which on a lens may be a fisheye: as of 27 mm for 36 x 24 mm."""


@dataclass(frozen=True)
class Fit:
    """Hold lenses, and all cameras as adjusted with these free."""

    lenses: tuple[Lens, ...]
    cameras: list[pycolmap.Camera]
    adjusted: Adjusted


@dataclass(frozen=True)
class Chooser:
    """Fit lenses to a block. `known`: the cameras before any adjustment. All of it raises `Cancelled`."""

    block: Block
    known: Sequence[pycolmap.Camera]
    progress: Progress = SILENT

    def fit(
        self,
        block: Block,
        lenses: tuple[Lens, ...],
        cameras: Sequence[pycolmap.Camera],
        most: int = MOST_STEPS,
    ) -> Fit:
        """Return the block adjusted from these cameras on, with the lenses as free as they are."""
        free, prior = freed(lenses, cameras, self.known)
        adjusted = adjust(block, free, np.zeros(len(prior.mean)), prior, most=most, progress=self.progress)
        return Fit(lenses, [one.at(adjusted.values) for one in free], adjusted)

    def again(self, fit: Fit) -> Fit:
        """Return the fit made again with those observations of the whole block that are right by it."""
        poses = fit.adjusted.block
        whole = replace(self.block, rotations=poses.rotations, translations=poses.translations)
        block, _ = cleaned(whole, fit.cameras, fit.adjusted.sigma)
        return self.fit(block, fit.lenses, fit.cameras)

    def turned(self, start: Fit, number: int) -> Fit:
        """Return the fit with the pictures of a lens's second camera turned to the other side, or with that camera as
        another lens, if either suits it better than the turn it has."""
        lens = start.lenses[number]
        if len(lens.cameras) < 2 or lens.freedom is None:
            return start
        first, second = (Lens((camera,), (0,), lens.freedom) for camera in lens.cameras)
        others = start.lenses[:number], start.lenses[number + 1 :]
        ways = [
            (*others[0], lens, *others[1]),
            (*others[0], replace(lens, quarters=(0, 3)), *others[1]),
            (*others[0], first, *others[1], second),
        ]
        fits = [self.fit(start.adjusted.block, _with_centres(lenses), start.cameras) for lenses in ways]
        lenses = ways[_simplest_fit(fits)]
        return self.again(self.fit(start.adjusted.block, lenses, start.cameras))

    def chosen(self, start: Fit, number: int) -> Fit:
        """Return the fit with the lens of this number as rich as its photographs determine; that of a wide lens in the
        models of perspective lenses or of fisheyes, whichever suits it better."""
        best = self.climb(start, number)
        lens = best.lenses[number]
        if lens.freedom is None or not _is_wide(best.cameras[lens.cameras[0]]):
            return best
        other = lens.freedom.other_kind()
        if other is None:
            return best
        began = self.fit(best.adjusted.block, _with(best.lenses, number, other), best.cameras)
        fits = [best, self.climb(self.again(began), number)]
        if not _is_wide(fits[1].cameras[lens.cameras[0]]):
            return best  # either shows a lens of little distortion, and then chance would choose
        poses = best.adjusted.block
        block = replace(self.block, rotations=poses.rotations, translations=poses.translations)
        block, _ = cleaned(block, best.cameras, best.adjusted.sigma)
        return fits[_simplest_fit([self.fit(block, fit.lenses, fit.cameras) for fit in fits])]

    def climb(self, start: Fit, number: int, steps: bool = True) -> Fit:
        """Return the fit with the lens of this number as rich as its photographs determine, in its own model without
        `steps`. What was freed and has come out as nothing is held again."""
        best = start
        for _ in range(_MOST_ROUNDS):
            freedom = best.lenses[number].freedom
            if freedom is None:
                break
            least = plain(self.known[best.lenses[number].cameras[0]])
            tried = [freedom, *freedom.richer(), *freedom.poorer(least)]
            tried = [one for one in tried if steps or one.model == freedom.model]
            costs = [-gain for gain in self._gains(best, number, tried)]
            chosen = tried[simplest(costs, [one.price for one in tried])]
            if chosen == freedom:
                break
            other = self.fit(best.adjusted.block, _with(best.lenses, number, chosen), best.cameras, most=4)
            best = self.again(other)
        return best

    def _gains(self, fit: Fit, number: int, tried: Sequence[Freedom]) -> list[float]:
        """Return by how much the cost falls with a lens as free as each of `tried` is, to first order: one step from
        the fit with all free, of which they are parts (Rao's score test); of what it has free beyond, the coefficients
        go to 0 (Wald's test)."""
        lens = fit.lenses[number]
        assert lens.freedom is not None
        rich = lens.freedom.richest()
        lenses = _with(fit.lenses, number, rich)
        free, prior = freed(lenses, fit.cameras, self.known)
        terms = derivatives(fit.adjusted.block, free, np.zeros(len(prior.mean)))
        matrix, gradient = without_poses(
            system_of(fit.adjusted.block, terms, fit.adjusted.sigma, prior, np.zeros(len(prior.mean)), 0.0)
        )
        before = sum(one.freedom.count for one in lenses[:number] if one.freedom)
        others = [k for k in range(len(gradient)) if not before <= k < before + rich.count]
        coefficients = slice(before + 1, before + 1 + rich.coefficients)
        gains = []
        for one in tried:
            columns = [*others, *(before + column for column in one.columns_in(rich))]
            to_none = np.zeros(len(gradient))
            to_none[coefficients] = prior.mean[coefficients]
            to_none[columns] = 0
            pulled = gradient + matrix @ to_none
            part = pulled[columns]
            gain = part @ solved(matrix[np.ix_(columns, columns)], part) - to_none @ (gradient + pulled)
            gains.append(float(gain))
        return gains


def may_be_wide(camera: pycolmap.Camera) -> bool:
    """Tell whether a camera, as it is before any adjustment, may have the lens of a fisheye."""
    return not camera.has_prior_focal_length or _is_wide(camera)


def _is_wide(camera: pycolmap.Camera) -> bool:
    return bool(np.hypot(camera.width, camera.height) / 2 > WIDE * camera.mean_focal_length())


def simplest(costs: Sequence[float], parameters: Sequence[int]) -> int:
    """Return the number of the fit with fewest parameters among those that are about as good as the best."""
    values = [cost + A_PARAMETER * count for cost, count in zip(costs, parameters, strict=True)]
    good = [number for number, value in enumerate(values) if value < min(values) + ABOUT]
    return min(good, key=lambda number: (parameters[number], values[number]))


def _simplest_fit(fits: Sequence[Fit]) -> int:
    sigma = min(fit.adjusted.sigma for fit in fits)
    return simplest([fit.adjusted.cost(sigma) for fit in fits], [len(fit.adjusted.values) for fit in fits])


def _with_centres(lenses: tuple[Lens, ...]) -> tuple[Lens, ...]:
    return tuple(
        replace(lens, freedom=replace(lens.freedom, centre=True)) if lens.freedom else lens for lens in lenses
    )


def _with(lenses: tuple[Lens, ...], number: int, freedom: Freedom) -> tuple[Lens, ...]:
    return tuple(replace(lens, freedom=freedom) if n == number else lens for n, lens in enumerate(lenses))
