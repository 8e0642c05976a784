"""Frames near the origin, and coordinates that cannot be what they are said to be."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.errors import ControlFileError, OptionError
from colmap_ihe.survey.frames import GPS, frame_of

UTM = [(691_234.5, 5_334_765.25, 512.3), (691_254.5, 5_334_785.25, 515.3)]
LOCAL = [(0.0, 0.0, 0.0), (12.0, 3.0, 8.0)]


def test_a_local_system_stays_and_a_map_is_shifted_by_whole_hundreds() -> None:
    assert frame_of("", LOCAL).offset == (0, 0, 0)
    frame = frame_of("EPSG:25832", UTM)
    assert frame.offset == (691_200, 5_334_800, 0)
    near = frame.to_model(np.array(UTM))
    np.testing.assert_allclose(near[0], (34.5, -34.75, 512.3), atol=1e-9)
    np.testing.assert_allclose(frame.to_user(near), UTM, atol=1e-9)


def test_degrees_become_metres_east_north_and_up() -> None:
    places = [(11.0, 48.0, 500.0), (11.001, 48.001, 503.0), (11.0005, 48.0005, 501.5)]
    frame = frame_of(GPS, places)
    east, north, up = (frame.to_model(np.array(places))[1] - frame.to_model(np.array(places))[0]).tolist()
    assert east == pytest.approx(74.6, abs=0.1)  # 111.3 km a degree, times the cosine of 48 degrees
    assert north == pytest.approx(111.2, abs=0.1)
    assert up == pytest.approx(3.0, abs=0.01)
    np.testing.assert_allclose(frame.to_user(frame.to_model(np.array(places))), places, atol=1e-9)
    assert frame_of("EPSG:4326", places).origin == pytest.approx(frame.origin)


@pytest.mark.parametrize(
    ("crs", "values", "words"),
    [
        ("", [(11.5801, 48.1402, 515.0), (11.5803, 48.1404, 520.0)], "look like degrees"),
        ("EPSG:4326", UTM, "no longitude and latitude"),
        ("EPSG:25832", [(11.58, 48.14, 515.0)], "far outside of the area"),
        ("EPSG:25832", [(y, x, z) for x, y, z in UTM], "far outside of the area"),
    ],
)
def test_coordinates_of_another_system_are_refused(
    crs: str, values: list[tuple[float, float, float]], words: str
) -> None:
    with pytest.raises(ControlFileError, match=words) as caught:
        frame_of(crs, values)
    assert "survey.crs" in caught.value.hint


@pytest.mark.parametrize(
    ("crs", "words"),
    [("EPSG:99", "PROJ knows"), ("EPSG:2263", "metres"), ("EPSG:4978", "no system of a map")],
)
def test_systems_that_cannot_serve_are_refused(crs: str, words: str) -> None:
    with pytest.raises(OptionError, match=words):
        frame_of(crs, LOCAL)
