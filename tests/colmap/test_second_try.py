"""A second try of the mapper: a street walked forward is mapped by it, and what needs none has none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from street import FOCAL_PX, Street, position_error, write_blank_images, write_street

from colmap_ihe.colmap import second_try
from colmap_ihe.colmap.mapper_options import native_options
from colmap_ihe.colmap.mapping import ModelStatistics, map_images
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.colmap.second_try import EASIER, SecondTry, second_try_options, with_changes
from colmap_ihe.errors import MappingError
from colmap_ihe.machine.progress import Silent
from colmap_ihe.project.options import SparseOptions

WALKED = Street(points=1200, wander=0.05)


class Units(Silent):
    """Note what is counted."""

    def __init__(self) -> None:
        super().__init__()
        self.units: list[str] = []

    def start(self, total: int, unit: str = "images") -> None:
        self.units.append(unit)


class Mapped:
    """Map a street, and keep what came of it."""

    def __init__(self, street: Street, folder: Path, **options: Any) -> None:
        self.centres = write_street(street, folder / "database.db")
        write_blank_images(street, folder / "grey")
        self.progress, self.tries, self.sparse = Units(), list[SecondTry](), folder / "sparse"
        self.models: list[ModelStatistics] = []
        try:
            self.models = map_images(
                folder / "database.db",
                folder / "grey",
                self.sparse,
                SparseOptions(**options),
                street.images,
                self.progress,
                on_second_try=self.tries.append,
            ).models
        except MappingError as error:
            assert "none of the 10 photographs" in str(error)


@pytest.mark.parametrize("mapper", ["incremental", "hierarchical"])
def test_a_street_walked_forward_is_mapped_at_the_second_try(tmp_path: Path, mapper: str) -> None:
    mapped = Mapped(WALKED, tmp_path, mapper=mapper)
    assert mapped.tries == [SecondTry(EASIER, 10, first=0, second=10)]
    assert mapped.progress.units == ["images", "images, second try", "calibration steps"]
    assert [model.registered_images for model in mapped.models] == [10]
    assert mapped.models[0].mean_reprojection_error_px == pytest.approx(0.5, abs=0.05)
    model = pycolmap.Reconstruction(mapped.sparse / "0")
    assert position_error(model, mapped.centres) < 0.03  # of 13.5 m walked
    assert model.cameras[1].focal_length == pytest.approx(FOCAL_PX, rel=0.02)
    assert sorted(path.name for path in mapped.sparse.iterdir()) == ["0"]


def test_what_is_mapped_well_is_mapped_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And nothing is asked of the database for it."""
    monkeypatch.setattr(second_try, "joined_by_matches", None)
    mapped = Mapped(Street(sideways=True), tmp_path)
    assert (mapped.tries, mapped.progress.units) == ([], ["images", "calibration steps"])
    assert [model.registered_images for model in mapped.models] == [10]


def test_a_second_try_that_fails_too_is_told(tmp_path: Path) -> None:
    """For the user holds that option by which it would not."""
    mapped = Mapped(WALKED, tmp_path, colmap={"mapper": {"init_max_forward_motion": 0.95}})
    (tried,) = mapped.tries
    assert (mapped.models, tried.first, tried.second, tried.helped) == ([], 0, 0, False)
    assert "init_max_forward_motion" not in tried.in_words()
    assert "as down a street, registered none either (" in tried.in_words()
    assert not list(tmp_path.glob("*sparse*"))


def test_options_that_the_user_set_are_left() -> None:
    given = SparseOptions(
        mapper="hierarchical",
        colmap={
            "mapper": {"init_min_tri_angle": 9.0, "abs_pose_max_error": 7.0},
            "incremental_options": {"mapper": {"init_min_num_inliers": 80}},
            "num_workers": 2,
        },
    )
    changes = {"init_max_forward_motion": 1.0, "abs_pose_min_num_inliers": 15}
    parts = native_options(with_changes(given, changes)).incremental_options.mapper
    assert (parts.init_min_tri_angle, parts.abs_pose_max_error, parts.init_min_num_inliers) == (9, 7, 80)
    assert (parts.init_max_forward_motion, parts.abs_pose_min_num_inliers) == (1, 15)
    assert given.colmap["mapper"] == {"init_min_tri_angle": 9.0, "abs_pose_max_error": 7.0}
    incremental = native_options(with_changes(SparseOptions(), EASIER)).mapper.todict()
    assert {name: incremental[name] for name in EASIER} == EASIER


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    database = tmp_path_factory.mktemp("walked") / "database.db"
    write_street(WALKED, database)
    return database


@pytest.mark.parametrize(("registered", "is_due"), [(0, True), (2, True), (4, True), (5, False), (10, False)])
def test_less_than_half_of_what_matches_join_is_few(walked: Path, registered: int, is_due: bool) -> None:
    assert bool(second_try_options(SparseOptions(), registered, 10, walked)) == is_due


def test_two_are_few_of_three_and_all_of_two(walked: Path) -> None:
    def is_due(registered: int, images: int) -> bool:
        names = [f"{number:02}.png" for number in range(images)]
        options = SparseOptions(colmap={"image_names": names})
        return bool(second_try_options(options, registered, 10, walked))

    assert is_due(2, 3) and is_due(0, 2)
    assert not is_due(2, 2) and not is_due(3, 5)


def test_photographs_that_nothing_joins_do_not_count(walked: Path) -> None:
    most = SparseOptions(colmap={"min_num_matches": 10_000})
    assert second_try_options(most, 0, 10, walked) == EASIER
    assert second_try_options(most, 1, 10, walked) == {}


def test_what_has_no_first_pair_or_no_option_left_is_not_tried_again(walked: Path) -> None:
    every = SparseOptions(colmap={"mapper": dict(EASIER)})
    assert second_try_options(every, 0, 10, walked) == {}
    assert second_try_options(SparseOptions(mapper="global"), 0, 10, walked) == {}
    some = SparseOptions(
        colmap={"mapper": {**EASIER, "init_min_tri_angle": 8.0, "init_max_forward_motion": 1}}
    )
    del some.colmap["mapper"]["abs_pose_min_num_inliers"]
    assert second_try_options(some, 0, 10, walked) == {"abs_pose_min_num_inliers": 15}
    of_parts = {
        "mapper": {"init_min_tri_angle": 8.0},
        "incremental_options": {"mapper": {"init_max_forward_motion": 1}},
    }
    both = SparseOptions(mapper="hierarchical", colmap=of_parts)
    assert second_try_options(both, 0, 10, walked) == {"abs_pose_min_num_inliers": 15}


def test_a_camera_that_only_turned_is_not_tried_again(tmp_path: Path) -> None:
    write_street(Street(step=0, wander=0, turn=10), tmp_path / "turned.db")
    assert second_try_options(SparseOptions(), 2, 10, tmp_path / "turned.db") == {}


def test_the_words_name_what_a_user_can_set() -> None:
    words = SecondTry({"init_max_forward_motion": 1.0, "abs_pose_min_num_inliers": 15}, 10, 2, 9).in_words()
    assert "registered only 2 of 10 photographs, and 9 in a second try" in words
    assert (
        "`--set 'sparse.colmap.mapper={init_max_forward_motion: 1.0, abs_pose_min_num_inliers: 15}'`" in words
    )
    assert "registered no more than 2 of 10 (`--set" in SecondTry(EASIER, 10, 2, 1).in_words()
    assert [SecondTry(EASIER, 10, 2, second).helped for second in (0, 2, 3)] == [False, False, True]
