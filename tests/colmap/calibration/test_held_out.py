"""Points held out tell a lens that is right from one that is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from wall_survey import camera, given_cameras, survey, whole_block

from colmap_ihe.colmap.calibration.choose import Chooser, Fit
from colmap_ihe.colmap.calibration.freedom import Freedom, Lens
from colmap_ihe.colmap.calibration.held_out import HeldOut, held_out

TRUTH = camera(params=(1000, 612, 447, -0.05))


def fits(
    *freedoms: Freedom | None, start: Sequence[float] = (1000, 600, 450, -0.05)
) -> tuple[Chooser, list[Fit]]:
    """A lens off the middle, fitted with each of these free from `start` on."""
    model = survey([TRUTH], points=700, noise=0.3, wrong=0.02)
    given_cameras(model, [camera(params=start)])
    block, cameras = whole_block(model)
    chooser = Chooser(block, cameras)
    made = [chooser.again(chooser.fit(block, (Lens((0,), (0,), one),), cameras)) for one in freedoms]
    return chooser, made


def test_the_right_lens_is_clearly_better_on_points_it_was_not_fitted_to() -> None:
    chooser, (base, right) = fits(Freedom("SIMPLE_RADIAL", 1), Freedom("SIMPLE_RADIAL", 1, True))
    gain = held_out(chooser, base, right)
    assert gain.standard_errors > 5
    assert not gain.worse
    # The median length of errors of 0.3 px in two coordinates, of which the point takes some.
    assert 0.75 < gain.chosen_px / (0.3 * np.sqrt(2 * np.log(2))) < 1.05
    assert gain.colmap_px > 1.2 * gain.chosen_px
    back = held_out(chooser, right, base)
    assert back.worse
    assert back.standard_errors == pytest.approx(-gain.standard_errors)


def test_the_same_fit_is_no_better() -> None:
    chooser, (base,) = fits(Freedom("SIMPLE_RADIAL", 1))
    gain = held_out(chooser, base, base)
    assert gain == HeldOut(gain.colmap_px, gain.colmap_px, 0.0)
    assert not gain.worse


def test_a_lens_that_is_held_is_judged_too() -> None:
    chooser, (wrong, right) = fits(None, Freedom("SIMPLE_RADIAL", 1, True), start=(1040, 600, 450, 0))
    assert held_out(chooser, wrong, right).standard_errors > 5


def test_a_few_wrong_points_do_not_outweigh_the_others() -> None:
    chooser, (base, right) = fits(Freedom("SIMPLE_RADIAL", 1), Freedom("SIMPLE_RADIAL", 1, True))
    pixels = chooser.block.pixels.copy()
    held = np.flatnonzero(np.isin(chooser.block.point, np.arange(3, len(chooser.block.points), 40)))
    pixels[held] += np.random.default_rng(0).normal(0, 5000, (len(held), 2))
    moved = replace(chooser, block=replace(chooser.block, pixels=pixels))
    assert held_out(moved, base, right).standard_errors > 5


def test_points_that_are_not_seen_are_wrong() -> None:
    chooser, (base,) = fits(Freedom("SIMPLE_RADIAL", 1, True))
    points = chooser.block.points.copy()
    points[3::4] = (0, 0, -40)  # those that are held out, behind all cameras
    behind = replace(chooser, block=replace(chooser.block, points=points))
    gain = held_out(behind, base, base)
    assert (gain.colmap_px, gain.chosen_px, gain.standard_errors) == (np.inf, np.inf, 0)
