"""Every photograph gets partners, whatever its GPS says."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from colmap_ihe.colmap import matching
from colmap_ihe.colmap.gps_fixes import forget_impossible_fixes, useful_fixes
from colmap_ihe.colmap.matching import choose_strategy, forget_matches, match_features
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.project.options import MatchesOptions

SPATIAL = MatchesOptions(strategy="spatial", pairing={"max_num_neighbors": 4, "max_distance": 25.0})
NOWHERE = (math.nan, math.nan, math.nan)


def east(metres: float) -> tuple[float, float, float]:
    """Return a fix so far east on the equator."""
    return 0.0, 1 + metres / 111_320, 80.0


@pytest.fixture
def database(finished: Path) -> Path:
    file = finished / "workspace/database.db"
    forget_matches(file)
    return file


def locate(database: Path, fixes: Mapping[int, Sequence[float]]) -> None:
    """Give images their fixes: by default image N lies 10 N metres to the east."""
    with pycolmap.Database.open(database) as opened:
        for prior in opened.read_all_pose_priors():
            image_id = prior.corr_data_id.id
            prior.position = np.array(fixes.get(image_id, east(10 * image_id)))
            prior.coordinate_system = pycolmap.PosePriorCoordinateSystem.WGS84
            opened.update_pose_prior(prior)


def partners(database: Path, scratch: Path, options: MatchesOptions = SPATIAL) -> dict[int, set[int]]:
    """Return the images that each was compared with, by its id, and leave the names of `without_fix` to `counts`."""
    with ThreadPoolExecutor(2) as here:
        counts = match_features(database, scratch, options, 8, here, SILENT)
    with pycolmap.Database.open(database) as opened:
        names = {str(image.name): int(image.image_id) for image in opened.read_all_images()}
        pairs = map(pycolmap.pair_id_to_image_pair, opened.read_two_view_geometries()[0])
    compared: dict[int, set[int]] = {image_id: set() for image_id in names.values()}
    for first, second in pairs:
        compared[first].add(second)
        compared[second].add(first)
    compared[0] = {names[name] for name in counts.without_fix}
    return compared


@pytest.mark.parametrize(
    "fix",
    [NOWHERE, (0.0, 0.0, 0.0), (0.0, 0.0, 80.0), (480.0, 2.0, 80.0), east(5000)],
    ids=["without", "at 0 0 0", "at 0 0 80", "beyond the pole", "5 km away"],
)
def test_one_without_a_fix_is_compared_with_all(
    database: Path, tmp_path: Path, fix: tuple[float, float, float]
) -> None:
    locate(database, {3: fix})
    compared = partners(database, tmp_path)
    assert compared[0] == {3}
    assert compared[3] == {1, 2, 4, 5, 6, 7, 8}
    assert compared[7] == {3, 5, 6, 8}  # as before by place, and with the one
    assert not (tmp_path / "vocabulary.bin").exists() and not (tmp_path / "chosen.txt").exists()


def test_a_sound_set_is_compared_by_place_alone(database: Path, tmp_path: Path) -> None:
    locate(database, {})
    compared = partners(database, tmp_path)
    assert compared[0] == set()
    assert compared[4] == {2, 3, 5, 6}


def test_one_fix_for_several_tells_them_not_apart(database: Path, tmp_path: Path) -> None:
    """Four neighbours of each are compared: three on one spot leave room for others, and do not count as a place."""
    locate(database, dict.fromkeys((1, 2, 3), east(10)))
    compared = partners(database, tmp_path)
    assert compared[0] == {1, 2, 3}
    assert compared[1] == {2, 3, 4, 5, 6, 7, 8}


def test_in_a_large_set_it_is_compared_with_those_that_look_like_it(
    database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(matching, "EXHAUSTIVE_UP_TO", 7)
    locate(database, {3: NOWHERE})
    compared = partners(database, tmp_path)
    assert compared[0] == {3}
    assert len(compared[3]) >= 3
    assert compared[7] - {3} == {5, 6, 8}
    assert not (tmp_path / "vocabulary.bin").exists() and not (tmp_path / "chosen.txt").exists()


def test_a_name_that_a_list_cannot_hold(
    database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pycolmap.Database.open(database) as opened:
        image = opened.read_image(3)
        image.name = f"#{image.name}"
        opened.update_image(image)
    monkeypatch.setattr(matching, "EXHAUSTIVE_UP_TO", 7)
    locate(database, {3: NOWHERE})
    compared = partners(database, tmp_path)
    assert len(compared[3]) >= 3
    assert compared[7] - {3} == {5, 6, 8}  # no others of the tree's


def test_on_a_gpu_too(database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matching, "cuda_devices", lambda: 1)
    locate(database, {3: NOWHERE})
    options = SPATIAL.model_copy(
        update={"colmap": {"use_gpu": True, "num_threads": 1}}
    )  # which it has not here
    assert partners(database, tmp_path, options)[3] == {1, 2, 4, 5, 6, 7, 8}


def test_spatial_is_refused_where_no_fix_tells_images_apart(database: Path, tmp_path: Path) -> None:
    locate(database, dict.fromkeys(range(1, 9), (0.0, 0.0, 0.0)))
    with pytest.raises(ProjectError, match=r"no photograph has GPS .* of its own"):
        partners(database, tmp_path)


def test_what_counts_as_a_place(database: Path) -> None:
    locate(
        database,
        {1: NOWHERE, 2: (0.0, 0.0, 7.0), 3: (-91.0, 2.0, 7.0), 4: (2.0, 181.0, 7.0), 5: (2.0, 0.0, 7.0)},
    )
    forget_impossible_fixes(database)
    fixes = useful_fixes(database)
    assert sorted(fixes) == [5, 6, 7, 8]
    assert fixes[5] == (2.0, 0.0, 7.0)
    locate(database, {image_id: east(10) for image_id in range(1, 9)})
    assert len(useful_fixes(database)) == 8  # of 50 neighbours, 42 are elsewhere
    assert useful_fixes(database, 15) == {}


def test_the_strategy_goes_by_fixes_that_tell_apart() -> None:
    assert choose_strategy("auto", 250, 225) == "spatial"
    assert choose_strategy("auto", 250, 224) == "vocabtree"
    assert choose_strategy("auto", 200, 200) == "exhaustive"
