"""Points of a cloud as whole numbers of steps in the user's system."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from colmap_ihe.survey.cloud_system import missing_packages, system_of, whole_file
from colmap_ihe.survey.frames import Frame

KINDS = [(axis, "<f4") for axis in "xyz"]


def test_a_system_is_told_as_wkt_and_a_local_one_not_at_all() -> None:
    rows = np.zeros(1, KINDS)
    assert system_of(rows, Frame("EPSG:25832")).wkt().startswith('PROJCS["ETRS89 / UTM zone 32N"')
    assert system_of(rows, Frame()).wkt() == ""


def test_32_bit_of_steps_hold_all_points() -> None:
    rows = np.array([(0, 0, 0), (0, 900_000, 0)], KINDS)
    assert system_of(rows[:1], Frame()).step_m == 0.0001
    assert system_of(rows, Frame()).step_m == pytest.approx(0.001)


def test_a_file_that_fails_is_removed_and_the_old_one_stays(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(RuntimeError), whole_file(tmp_path / "a") as temporary:
        temporary.write_text("new")
        raise RuntimeError
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "old")]
    with whole_file(tmp_path / "a") as temporary:
        temporary.write_text("new")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "new")]


def test_a_package_that_is_not_there_is_missing() -> None:
    assert missing_packages(Frame(), "json", "no_such_package_of_anyone") == ["no_such_package_of_anyone"]
