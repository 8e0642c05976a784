"""The page as text: what it shows, and what is left out."""

from __future__ import annotations

import base64
import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from html_elements import HOSTILE, Elements
from synthetic import facade_cloud, synthetic_contents

from colmap_ihe.report import charts
from colmap_ihe.report.contents import Cloud, Contents, PhotographEntry
from colmap_ihe.report.embed import cloud_data
from colmap_ihe.report.page import render_page


def nothing_but(title: str = "A set", **more: Any) -> Contents:
    return Contents(title, "", [], None, [], **more)


@pytest.fixture(scope="module")
def whole() -> str:
    return render_page(synthetic_contents(2000))


def test_title_alone_is_a_page() -> None:
    elements = Elements(render_page(nothing_but()))
    names = [tag for tag, _ in elements.tags]
    assert "section" not in names and "nav" not in names and "canvas" not in names
    assert elements.headings == [1]


def test_names_reach_the_viewer_unchanged() -> None:
    scripts = Elements(render_page(synthetic_contents(500, hostile=HOSTILE))).scripts
    data = next(json.loads(text) for kind, text in scripts if kind == "application/json")
    assert data["cameras"][0]["name"] == f"{HOSTILE}DSC_4100.NEF"


def test_name_that_is_not_utf8_can_be_written() -> None:
    photograph = PhotographEntry("caf\udce9.jpg", None, left_out="cannot be read")
    page = render_page(dataclasses.replace(nothing_but(), photographs=[photograph]))
    assert b"caf\\udce9.jpg" in page.encode()


@pytest.mark.parametrize(
    ("left_out", "heading"),
    [
        ({"grey": None}, "The grey that the set was matched in"), ({"pairs": ()}, "Matches, side by side"),
        ({"sliders": ()}, "Before and after"), ({"warnings": ()}, "Warnings"), ({"versions": {}}, "Versions"),
        ({"points_by_images": {}}, "How many photographs see a point"), ({"cloud": None}, "The model"),
        ({"surface": None}, "The model"),
        ({"lenses": ()}, "Cameras"), ({"matches": None}, "Which photographs match"), ({"options": ""}, "All options"),
        ({"drawings": ()}, "Drawings"),
    ],
)  # fmt: skip
def test_sections_without_contents_are_left_out(whole: str, left_out: dict[str, Any], heading: str) -> None:
    assert f"{heading}</h" in whole or f"{heading}</s" in whole
    fewer = render_page(dataclasses.replace(synthetic_contents(500), **left_out))
    assert f"{heading}</h" not in fewer and f"{heading}</s" not in fewer


def test_headings_are_in_order_and_pictures_have_words(whole: str) -> None:
    elements = Elements(whole)
    assert elements.headings[0] == 1 and elements.headings.count(1) == 1
    assert all(b <= a + 1 for a, b in zip(elements.headings, elements.headings[1:], strict=False))
    assert all(a.get("alt") for tag, a in elements.tags if tag == "img")
    ids = [a["id"] for _, a in elements.tags if "id" in a]
    assert len(ids) == len(set(ids))


def test_positions_come_back_within_half_a_step() -> None:
    cloud = facade_cloud(3000)
    data = json.loads(cloud_data(cloud))
    steps = np.frombuffer(base64.b64decode(data["positions"]), "<u2").reshape(-1, 3)
    back = np.array(data["low"]) + steps / 65535 * np.array(data["extent"])
    assert np.abs(back - cloud.positions).max() <= 0.51 * max(data["extent"]) / 65535
    tints = np.frombuffer(base64.b64decode(data["tints"]), np.uint8).reshape(-1, 4)
    assert np.array_equal(tints[:, :3], cloud.colours) and np.array_equal(tints[:, 3], cloud.grey)


def test_stray_points_are_left_out() -> None:
    cloud = facade_cloud(1000)
    positions = cloud.positions.copy()
    positions[0], positions[1] = 1e6, np.nan
    data = json.loads(cloud_data(dataclasses.replace(cloud, positions=positions)))
    assert max(data["extent"]) < 20
    assert len(base64.b64decode(data["positions"])) == 6 * (len(positions) - 2)


@pytest.mark.parametrize("value", [0.0, 5.0, np.nan])
def test_cloud_of_one_place_is_drawn(value: float) -> None:
    same = np.full((4, 3), value, np.float32)
    cloud = Cloud(same, np.zeros((4, 3), np.uint8), np.zeros(4, np.uint8), "sparse", 4)
    assert "canvas" in render_page(nothing_but(cloud=cloud))


def test_cloud_of_unequal_arrays_is_refused() -> None:
    cloud = dataclasses.replace(facade_cloud(100), grey=np.zeros(3, np.uint8))
    with pytest.raises(ValueError, match="3 greys"):
        render_page(nothing_but(cloud=cloud))


def test_long_tracks_share_the_last_bar() -> None:
    bars = charts.tracks_chart({2: 10, 40: 3, 60: 2})
    assert len(bars) == 20 and bars[0].points == 10
    assert (bars[-1].label, bars[-1].points) == ("21+", 5)
    assert charts.tracks_chart({3: 0}) == []


def test_match_picture_takes_either_half() -> None:
    upper = np.triu(np.arange(16).reshape(4, 4), 1)
    one, other = charts.match_picture(upper), charts.match_picture(upper.T)
    assert one is not None and one == other
    assert (one.most, one.linked_pairs) == (11, 6)
    assert charts.match_picture(np.zeros((3, 3), np.int64)) is None


def test_durations() -> None:
    words = [charts.duration(seconds) for seconds in (0.04, 61.2, 125, 7325)]
    assert words == ["0.0 s", "61 s", "2 min 05 s", "2 h 02 min"]
