"""The second grey shows what the first loses, and nothing where the first shows all."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from painted import PAINTED, grey_of, painted_wall

from colmap_ihe.grey.second import SecondGrey, shrunk
from colmap_ihe.grey.second_fit import Blocks, blocks_of, fit_second, lost_places

RED_GREEN = SecondGrey(1.5, -1.5, 0.0, 1.0, 1.0)


def detail(picture: NDArray[np.uint8]) -> float:
    return float(np.std(picture[PAINTED].astype(float)))


def test_a_painting_of_one_grey_is_shown_by_the_second_and_the_wall_beside_it_is_left() -> None:
    colour = painted_wall()
    grey = grey_of(colour)
    assert detail(grey) < 1
    combined, shares = RED_GREEN.combined(grey, colour)
    assert shares[PAINTED].mean() > 0.9
    assert detail(combined) > 20
    wall = np.s_[:, :200]
    assert not shares[wall].any()
    assert np.array_equal(combined[wall], grey[wall])


def test_without_colour_the_grey_is_handed_back_as_it_is() -> None:
    colour = np.repeat(grey_of(painted_wall())[..., None], 3, axis=2)
    combined, shares = RED_GREEN.combined(colour[..., 0], colour)
    assert np.array_equal(combined, colour[..., 0])
    assert not shares.any()


def test_a_twin_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"colour\.shape"):
        RED_GREEN.shares(np.zeros((8, 8), np.uint8), np.zeros((8, 9, 3), np.uint8))


def test_detail_is_measured_at_one_size_for_all() -> None:
    assert shrunk(np.zeros((1000, 3200, 3), np.uint8)).shape == (500, 1600, 3)
    assert shrunk(np.zeros((30, 40), np.uint8)).shape == (30, 40)


def test_the_fit_finds_the_colours_that_the_grey_loses() -> None:
    colour = painted_wall()
    fit = fit_second([blocks_of(grey_of(colour), colour)] * 2)
    assert fit.second is not None
    assert fit.second.red * fit.second.green < 0
    assert 0.05 < fit.lost < 0.4
    assert fit.regained == pytest.approx(fit.lost, rel=0.1)
    combined, _ = fit.second.combined(grey_of(colour), colour)
    assert detail(combined) > 10
    assert fit == fit_second([blocks_of(grey_of(colour), colour)] * 2)


def test_stone_needs_no_second_grey() -> None:
    colour = painted_wall(painting=False)
    fit = fit_second([blocks_of(grey_of(colour), colour)] * 2)
    assert (fit.second, fit.by_photograph) == (None, (0.0, 0.0))


def test_noise_is_no_detail() -> None:
    noise = np.random.default_rng(5).integers(100, 110, (400, 400, 3)).astype(np.uint8)
    assert fit_second([blocks_of(grey_of(noise), noise)]).lost == 0


def test_a_painting_in_one_photograph_alone_matches_nothing() -> None:
    stone, fresco = painted_wall(painting=False), painted_wall()
    photographs = [blocks_of(grey_of(c), c) for c in (fresco, *[stone] * 30)]
    assert fit_second(photographs).second is None
    both = [*photographs, blocks_of(grey_of(fresco), fresco)]
    assert fit_second(both).second is not None


def test_a_named_direction_is_taken_however_little_is_lost() -> None:
    colour = painted_wall(painting=False)
    second = fit_second([blocks_of(grey_of(colour), colour)], "red").second
    assert second is not None
    assert (second.name, second.green, second.blue) == ("red", 0, 0)


def test_the_second_has_the_noise_of_the_first_where_it_does_not_clip() -> None:
    colour = painted_wall()
    second = fit_second([blocks_of(grey_of(colour), colour)] * 2).second
    assert second is not None
    assert second.own_noise <= second.noise * 1.001
    assert max(abs(w) for w in (second.red, second.green, second.blue)) <= 3


def test_photographs_too_small_to_measure_give_none() -> None:
    tiny = np.zeros((3, 3, 3), np.uint8)
    assert fit_second([blocks_of(tiny[..., 0], tiny)]).second is None


def test_lost_places_are_those_of_the_painting_and_other_weights_lose_others() -> None:
    colour = painted_wall()
    noise = fit_second([blocks_of(grey_of(colour), colour)]).noise
    painting = np.s_[140 // 16 + 1 : 260 // 16, 320 // 16 + 1 : 480 // 16]
    by_grey, by_rec709 = lost_places(grey_of(colour), colour, noise)
    assert by_grey.shape == (25, 37)
    assert by_grey[painting].mean() > 0.95
    assert by_rec709[painting].mean() > 0.95
    assert not by_grey[:, :15].any()
    by_red, by_rec709 = lost_places(colour[..., 0], colour, noise)
    assert not by_red[painting].any()
    assert by_rec709[painting].mean() > 0.95


def test_a_pale_painting_counts_as_much_as_a_bright_one() -> None:
    """A direction that keeps half of the pale one's contrast shows noise there; another shows detail in both."""
    covariance = np.zeros((1100, 3, 3), np.float32)
    covariance[:, [0, 1, 2], [0, 1, 2]] = 1
    covariance[:60, 0, 0] += 400
    covariance[60:100, 2, 2] += 16
    colours = covariance[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    flat = np.ones(len(colours), np.float32)
    fit = fit_second([Blocks(colours, flat, flat)])
    assert (fit.lost, fit.regained) == (1, 1)
    assert fit.second is not None
    weights = np.square([fit.second.red, fit.second.green, fit.second.blue])
    assert 1 + 16 * weights[2] / weights.sum() > 9
