"""The figures of a model as a surveyor asks for them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from colmap_ihe.pipeline.survey_facts import Measures, survey_facts, taken_in_words

SUMMARY: dict[str, Any] = {
    "images": 3, "registered_images": 2, "left_out": {"c": "cannot be read"}, "points3D": 1234,
    "dense_points": None, "dense_backend": None,
    "dense_pixels_with_depth_percent": None, "mesh_faces": 10, "mesh_texture": None, "peak_memory_bytes": 2_500_000_000,
}  # fmt: skip
CAPTURES = {"images": 2, "taken": {"a": "2016:06:21 10:00:00", "b": "2016:06:21 10:14:59"}}
METRES = Measures(np.array([0.002, 0.003, np.nan]), np.array([12.34, 6.0, 3.0]), metric=True)


def test_rows_say_what_is_known_and_leave_out_the_rest() -> None:
    rows = dict(survey_facts(SUMMARY, CAPTURES, METRES, [(48.5, -2.25, 30.0), (48.5, -2.25, 35.0)]))
    assert rows == {
        "photographs": "2 registered of 3, 1 left out",
        "taken": "2016-06-21, 10:00 to 10:14",
        "GPS": "2 photographs of 3, about 48.50000° N, 2.25000° W, at heights of 30 to 35 m",
        "what a pixel shows": "2.5 mm, by photograph 2 to 3 mm",
        "size of the model": "12.3 m across, 6 m high, 3 m deep (90 % of the points)",
        "points": "1,234",
        "mesh": "10 triangles with vertex colours",
        "memory": "at most 2.5 GB in one process",
    }


def test_without_metres_a_pixel_is_a_part_of_the_model() -> None:
    measures = Measures(np.array([0.002, 0.004]), np.array([8.0, 4.0, 2.0]), metric=False)
    rows = dict(survey_facts({**SUMMARY, "peak_memory_bytes": None}, {"images": 2}, measures, []))
    shown = rows["what a pixel shows"]
    assert shown == "1/2,670 of the model's longest side, by photograph 1/4,000 to 1/2,000"
    assert rows["size of the model"].startswith("1.00 across, 0.50 high, 0.25 deep, in shares")
    assert not {"taken", "GPS", "memory"} & rows.keys()
    assert measures.gsd_mm is None and METRES.gsd_mm == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("taken", "images", "words"),
    [
        ([], 2, ""),
        (["0000:00:00 00:00:00", "yesterday"], 2, ""),
        (["2016:06:21 10:00:10"], 1, "2016-06-21 10:00"),
        (["2016:06:21 10:00:00", "2016:06:24 09:00:00"], 2, "2016-06-21 to 2016-06-24, on 2 days"),
        (["2016:06:21 10:00:00"], 5, "2016-06-21 10:00, as 1 of 5 say"),
    ],
)
def test_dates(taken: list[str], images: int, words: str) -> None:
    assert taken_in_words(taken, images) == words
