"""What remains of a run: foreseen costs, corrected by what the run does."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest

from colmap_ihe.machine.remaining_time import Forecast, Part
from colmap_ihe.pipeline.estimates import stage_parts
from colmap_ihe.pipeline.resource_needs import Known
from colmap_ihe.project.options import Options

CAPTURES = {"images": 11, "pixels": 66_000_000, "raw": 0, "with_gps": 0, "of_one_camera": 10}
SET = Known.from_records({"captures": CAPTURES})
PARTS = [Part("one", "images", 10.0), Part("two", "pairs", 30.0), Part("two", "maps", 60.0)]


@dataclass
class Clock:
    now: float = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def forecast(clock: Clock) -> Forecast:
    forecast = Forecast(clock)
    forecast.expect(PARTS)
    return forecast


def work(forecast: Forecast, clock: Clock, part: Part, pace: float, until: float = 1.0) -> None:
    forecast.begin(part.stage, part.unit)
    for step in range(1, 11):
        clock.now += part.seconds * pace * until / 10
        forecast.reach(until * step / 10)


def test_before_anything_it_is_what_was_foreseen(forecast: Forecast) -> None:
    assert forecast.remaining_s() == 100
    assert forecast.remaining_s("two") == 90


def test_nothing_is_said_of_what_was_not_foreseen_and_has_not_moved(clock: Clock) -> None:
    forecast = Forecast(clock)
    assert forecast.remaining_s() is None
    forecast.begin("fit", "images")
    clock.now += 5
    assert forecast.remaining_s() is None
    forecast.reach(0.25)
    assert forecast.remaining_s() == pytest.approx(15)


@pytest.mark.parametrize("pace", [0.1, 1.0, 7.0])
def test_a_slow_machine_and_a_fast_one_correct_it(forecast: Forecast, clock: Clock, pace: float) -> None:
    work(forecast, clock, PARTS[0], pace)
    work(forecast, clock, PARTS[1], pace, until=0.5)
    left = forecast.remaining_s()
    assert left is not None
    assert 1 / 1.5 < left / (75 * pace) < 1.5


def test_a_part_that_goes_unlike_its_cost_is_judged_by_how_it_goes(forecast: Forecast, clock: Clock) -> None:
    work(forecast, clock, PARTS[0], 1.0)
    work(forecast, clock, PARTS[1], 5.0, until=0.8)
    left = forecast.remaining_s("two")
    assert left is not None
    own = left - 60 * (10 + 120 + 0.5) / (10 + 24 + 0.5)  # the maps, at the pace so far
    assert own == pytest.approx(30, rel=0.35)


def test_one_unit_that_is_late_never_promises_nothing(forecast: Forecast, clock: Clock) -> None:
    forecast.begin("two", "maps")
    for _ in range(20):
        clock.now += 10
        left = forecast.remaining_s()
        assert left is not None
        assert left > 1


def test_what_is_kept_or_left_out_is_not_waited_for(forecast: Forecast) -> None:
    forecast.end("one")
    assert forecast.remaining_s() == 90
    forecast.begin("two", "maps")
    assert forecast.remaining_s() == pytest.approx(60)


def stages(until: str, **options: Any) -> list[str]:
    parts = stage_parts(Options.model_validate(options), SET, until)
    return list(dict.fromkeys(part.stage for part in parts))


def test_the_road_has_the_parts_that_the_options_leave() -> None:
    road = ["fit", "convert", "features", "matches", "sparse", "survey", "dense", "mesh", "page"]
    assert stages("drawings") == road  # of a model that is not metric
    assert stages("drawings", drawings={"enabled": True}) == [*road[:8], "drawings", "page"]
    assert stages("mesh") == road
    assert stages("mesh", dense={"enabled": False}) == [*road[:6], "page"]
    assert stages("sparse") == [*road[:5], "page"]
    assert stages("matches") == road[:4]
    assert stages("captures") == []
    plain = stage_parts(Options.model_validate({"mesh": {"texture": False}}), SET, "mesh")
    assert [part.unit for part in plain if part.stage == "mesh"] == [
        "parts of the surface",
        "depth maps compared with the surface",
        "depth maps compared with the surface",
    ]


def test_photographs_that_see_little_of_one_another_take_less() -> None:
    def dense(inliers: int) -> float:
        parts = stage_parts(Options(), replace(SET, inliers=inliers), "mesh")
        return sum(part.seconds for part in parts if part.stage in ("dense", "mesh"))

    assert dense(SET.features // 20) < 0.7 * dense(SET.features // 2)
    assert dense(SET.features // 2) == dense(SET.features) == dense(100 * SET.features)
    few = Known.from_records({"captures": CAPTURES | {"of_one_camera": 2}})
    assert dense(few.inliers) < dense(SET.inliers)
