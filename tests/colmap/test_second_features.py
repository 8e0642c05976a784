"""Features of the second grey come to those that are there, once, where they count."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from painted import PAINTED, grey_of, painted_wall
from PIL import Image

from colmap_ihe.colmap.array_features import F32, U8
from colmap_ihe.colmap.features import count_features, extract_features
from colmap_ihe.colmap.lower_thresholds import COLMAPS_THRESHOLD
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.second_features import add_second_features
from colmap_ihe.grey.second import SecondGrey
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.project.options import CameraOptions, FeaturesOptions

SECOND = SecondGrey(1.5, -1.5, 0.0, 1.0, 1.0)
NAMES = ["a.png", "b.png"]
Keypoints = dict[str, tuple[NDArray[np.float32], NDArray[np.uint8]]]


def picture(name: str) -> tuple[U8, F32]:
    colour = painted_wall(shift=5 * NAMES.index(name))
    return SECOND.combined(grey_of(colour), colour)


def nothing(name: str) -> tuple[U8, F32]:
    grey, shares = picture(name)
    return grey, np.zeros_like(shares)


def features(database: Path) -> Keypoints:
    with pycolmap.Database.open(database) as opened:
        return {
            str(i.name): (
                np.asarray(opened.read_keypoints(i.image_id)),
                np.asarray(opened.read_descriptors(i.image_id).data),
            )
            for i in opened.read_all_images()
        }


def around_painting(points: NDArray[np.float32]) -> bool:
    x, y = points[:, 0], points[:, 1]
    return bool(((x > 280) & (x < 530) & (y > 95) & (y < 305)).all())


@pytest.fixture
def database(tmp_path: Path) -> Path:
    (tmp_path / "grey").mkdir()
    for number, name in enumerate(NAMES):
        Image.fromarray(grey_of(painted_wall(shift=5 * number))).save(tmp_path / "grey" / name)
    file, options = tmp_path / "database.db", FeaturesOptions()
    with ThreadPoolExecutor(1) as threads:
        extract_features(
            file, tmp_path / "grey", NAMES, None, CameraOptions(), options, tmp_path, threads, SILENT
        )
    return file


def add(
    database: Path,
    pictures: Callable[[str], tuple[U8, F32]] = picture,
    options: FeaturesOptions | None = None,
) -> dict[str, int]:
    with ThreadPoolExecutor(1) as threads:
        return add_second_features(database, NAMES, pictures, options or FeaturesOptions(), threads, SILENT)


def in_painting(points: NDArray[np.float32], shift: int) -> int:
    rows, columns = PAINTED
    x, y = points[:, 0] - shift, points[:, 1]
    return int(((x > columns.start) & (x < columns.stop) & (y > rows.start) & (y < rows.stop)).sum())


def test_those_of_the_painting_come_after_those_that_were_there(database: Path) -> None:
    before = features(database)
    counts = add(database)
    after = features(database)
    for number, name in enumerate(NAMES):
        points, descriptors = after[name]
        old = len(before[name][0])
        assert np.array_equal(points[:old], before[name][0])
        assert np.array_equal(descriptors[:old], before[name][1])
        assert len(points) == len(descriptors) == old + counts[name]
        assert in_painting(before[name][0], 5 * number) < 30
        assert in_painting(points[old:], 5 * number) > 100
        assert around_painting(points[old:])
    assert count_features(database, NAMES).features == sum(len(p) for p, _ in after.values())


def test_a_second_time_adds_nothing(database: Path) -> None:
    counts, once = add(database), features(database)
    assert add(database) == counts
    for name, (points, descriptors) in features(database).items():
        assert np.array_equal(points, once[name][0])
        assert np.array_equal(descriptors, once[name][1])


def test_where_the_second_has_no_share_nothing_is_added(database: Path) -> None:
    before = {name: len(points) for name, (points, _) in features(database).items()}
    assert add(database, nothing) == {}
    assert {name: len(points) for name, (points, _) in features(database).items()} == before


def test_both_photographs_of_a_painting_match_in_it(database: Path) -> None:
    pycolmap.match_exhaustive(database)
    first = matched(database)
    with pycolmap.Database.open(database) as opened:
        opened.clear_matches()
        opened.clear_two_view_geometries()
    add(database)
    pycolmap.match_exhaustive(database)
    assert matched(database) > first + 80


def matched(database: Path) -> int:
    with pycolmap.Database.open(database) as opened:
        return int(opened.num_inlier_matches())


def test_features_of_a_smaller_copy_lie_at_their_places_in_the_photograph(database: Path) -> None:
    before = {name: len(points) for name, (points, _) in features(database).items()}
    assert add(database, options=FeaturesOptions(max_image_size=300))
    for name, (points, _) in features(database).items():
        added = points[before[name] :]
        assert len(added) > 20
        assert around_painting(added)
        assert np.ptp(added[:, 0]) > 150


def test_they_are_sought_at_a_lower_threshold_unless_one_is_given(database: Path, tmp_path: Path) -> None:
    def pale(name: str) -> tuple[U8, F32]:
        grey, shares = picture(name)
        return np.asarray(128 + (grey.astype(np.float32) - 128) * 0.1, np.uint8), shares

    other = Path(shutil.copy(database, tmp_path / "other.db"))
    given = FeaturesOptions(colmap={"sift": {"peak_threshold": COLMAPS_THRESHOLD}})
    few, more = add(other, pale, given), add(database, pale)
    assert sum(more.values()) > 1.3 * sum(few.values()) > 0, f"{few=} {more=}"
