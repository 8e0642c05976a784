"""Photographs that were taken as by one camera: those by two settings of a zoom come apart, others stay together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from wall_survey import camera, survey, whole_block

from colmap_ihe.colmap.calibration.choose import Chooser, Fit
from colmap_ihe.colmap.calibration.freedom import Freedom, Lens
from colmap_ihe.colmap.calibration.sharing import FocalLength, focal_lengths, groups_of


def fitted_as_one(*focal: float) -> Fit:
    """A survey by a zoom at these focal lengths in turn, fitted with one camera."""
    lenses = [camera(params=(f, 600, 450, -0.05), camera_id=n) for n, f in enumerate(focal, start=1)]
    block, cameras = whole_block(survey(lenses, 8, noise=0.3, seed=4))
    block = replace(block, cameras=np.zeros_like(block.cameras))
    chooser = Chooser(block, cameras[:1])
    return chooser.fit(block, (Lens((0,), (0,), Freedom("SIMPLE_RADIAL", 1)),), cameras[:1])


def test_two_settings_of_a_zoom_come_apart() -> None:
    found, gain = focal_lengths(fitted_as_one(1000, 1250), 0)
    assert gain > 1000
    groups = groups_of(found, gain)
    assert [sorted(one.image for one in group) for group in groups] == [[0, 2, 4, 6], [1, 3, 5, 7]]
    means = [float(np.mean([one.pixels for one in group])) for group in groups]
    assert means[1] / means[0] == pytest.approx(1.25, rel=0.01)


def test_one_lens_stays_one_group() -> None:
    found, gain = focal_lengths(fitted_as_one(1000), 0)
    assert len(groups_of(found, gain)) == 1
    assert [one.pixels for one in found] == pytest.approx([1000] * 8, rel=0.01)


def test_gaps_count_where_they_are_wide_and_sure() -> None:
    def group_sizes(*pairs: tuple[float, float], gain: float = 1.0) -> list[int]:
        found = [FocalLength(n, pixels, deviation) for n, (pixels, deviation) in enumerate(pairs)]
        return [len(group) for group in groups_of(found, gain)]

    assert group_sizes((1000, 2), (1300, 2), (1010, 2)) == [2, 1]
    assert group_sizes((1000, 2), (1035, 2)) == [2]  # focus does as much
    assert group_sizes((1000, 40), (1200, 40)) == [2]  # not sure
    assert group_sizes((1000, 2), (1300, 2), gain=0) == [2]  # no better for it
