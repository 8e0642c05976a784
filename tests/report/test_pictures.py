"""Pictures for pages."""

from __future__ import annotations

import numpy as np
import simplejpeg

from colmap_ihe.report import pictures


def test_pictures_are_shrunk_and_never_enlarged() -> None:
    grey = np.full((100, 200), 90, np.uint8)
    small = pictures.picture(grey, "a wall", 50)
    assert (small.width, small.height, small.alt) == (50, 25, "a wall")
    decoded = simplejpeg.decode_jpeg(small.jpeg, colorspace="GRAY")
    assert decoded.shape == (25, 50, 1)
    assert np.abs(decoded.astype(int) - 90).max() <= 1
    assert pictures.picture(grey, "", 1000).width == 200
    red = np.zeros((40, 30, 3), np.uint8)
    red[..., 0] = 200
    decoded = simplejpeg.decode_jpeg(pictures.picture(red, "", 40).jpeg)
    assert np.abs(decoded.astype(int) - (200, 0, 0)).max() <= 4


def test_rec709_is_colmaps_default() -> None:
    primaries = np.eye(3, dtype=np.uint8)[None] * np.uint8(255)
    assert pictures.rec709(primaries).tolist() == [[54, 182, 18]]


def test_a_difference_is_grey_where_there_is_none() -> None:
    chosen = np.array([[0, 10, 250, 255]], np.uint8)
    default = np.array([[0, 20, 10, 0]], np.uint8)
    assert pictures.difference(chosen, default).tolist() == [[127, 117, 255, 255]]


def test_a_patchwork_has_a_tile_a_photograph() -> None:
    tiles = [np.full((30, 40 + n, 3), 10 * n, np.uint8) for n in range(5)]
    whole = pictures.patchwork(tiles, 16)
    assert whole.shape == (32, 48, 3)
    assert [int(whole[8 + 16 * (n // 3), 8 + 16 * (n % 3), 0]) for n in range(5)] == [0, 10, 20, 30, 40]
    assert (whole[16:, 32:] == 255).all()
    assert pictures.patchwork([np.zeros((20, 50), np.uint8)], 8).shape == (8, 8)


def test_matches_are_lines_between_both() -> None:
    first, second = np.zeros((40, 50), np.uint8), np.zeros((60, 30), np.uint8)
    drawn = pictures.matches_drawn(first, second, np.array([[10.0, 20]]), np.array([[5.0, 20]]))
    assert drawn.shape == (60, 50 + 8 + 30, 3)
    assert drawn[20, 30].max() > 150
    assert not drawn[10, 30].any()
    nothing = pictures.matches_drawn(first, second, np.empty((0, 2)), np.empty((0, 2)))
    assert not nothing[:40, :50].any()


def test_marked_places_stand_out_of_the_paler_photograph() -> None:
    rgb = np.full((40, 60, 3), 100, np.uint8)
    places = np.zeros((4, 6), bool)
    places[1, 2] = True
    drawn = pictures.marked(rgb, places)
    assert drawn[15, 25].tolist() == [165, 90, 50]
    assert drawn[15, 45].tolist() == [201, 201, 201]
