"""Photographs of different exposure are made alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.dense.texture.exposure import exposure_tables, with_table

FACES = 4000


def shown(*exposures: tuple[float, float]) -> NDArray[np.uint8]:
    """(F, K, 3): what photographs of such gains and offsets show of one scene."""
    scene = np.random.default_rng(3).uniform(60, 160, (FACES, 1, 3))
    gain, offset = np.array(exposures).T[:, None, :, None]
    return np.asarray(np.clip(np.rint(gain * scene + offset), 0, 255), np.uint8)


def test_photographs_become_like_the_middle_one() -> None:
    colour = shown((1.0, 0.0), (1.3, 20.0), (0.8, -10.0))
    view = np.tile(np.arange(3, dtype=np.int32), (FACES, 1))
    tables = exposure_tables(view, colour, 3)
    alike = [with_table(colour[:, number], tables[number]).astype(float) for number in range(3)]
    assert np.abs(alike[0] - colour[:, 0]).mean() < 1
    assert max(np.abs(other - alike[0]).mean() for other in alike[1:]) < 1.5
    assert np.abs(colour[:, 1].astype(float) - colour[:, 0]).mean() > 40


def test_what_stands_before_a_part_of_the_scene_moves_no_photograph() -> None:
    colour = shown(*[(1.0, 0.0)] * 4)
    colour[: FACES // 8, 0] = (20, 90, 10)  # leaves
    view = np.tile(np.arange(4, dtype=np.int32), (FACES, 1))
    levels = exposure_tables(view, colour, 4)[0, 60:160].astype(int)
    assert np.abs(levels - np.arange(60, 160)[:, None]).max() < 22


def test_a_photograph_is_as_it_is_where_nothing_tells() -> None:
    colour = shown((1.0, 0.0), (1.3, 20.0))
    view = np.tile(np.arange(2, dtype=np.int32), (FACES, 1))
    own = np.repeat(np.arange(256)[:, None], 3, axis=1)
    assert (exposure_tables(view, colour, 2) == own).all()  # of two neither is the right one
    assert (exposure_tables(view[:0], colour[:0], 2) == own).all()
