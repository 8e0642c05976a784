"""Which photographs one camera took, turned in their pixels or not."""

from __future__ import annotations

from pathlib import Path

import pytest
from exif_samples import IMAGE, SHOT, SIZE, block
from PIL import Image

from colmap_ihe.photographs.camera_identity import (
    CameraIdentity,
    identities_of_cameras,
    read_identities,
    turned_partners,
    without_whole_identity,
)

FLAT = CameraIdentity("Foo", "Bar", 35, 0, 1500, 1000)
UPRIGHT = CameraIdentity("Foo", "Bar", 35, 0, 1000, 1500)
ZOOMED = CameraIdentity("Foo", "Bar", 70, 0, 1500, 1000)
SCAN, TURNED_SCAN = CameraIdentity("", "", 0, 0, 640, 480), CameraIdentity("", "", 0, 0, 480, 640)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
def test_what_exif_says_is_read_with_the_size_as_stored(tmp_path: Path, suffix: str) -> None:
    """Of a TIFF with Orientation 6 Pillow gives the size upright."""
    assert IMAGE[0x0112] == 6
    Image.new("L", SIZE, 90).save(tmp_path / f"a.{suffix}", exif=block(IMAGE, SHOT, {}))
    (tmp_path / f"b.{suffix}").write_bytes(b"no picture")
    found = read_identities(tmp_path, [f"b.{suffix}", f"gone.{suffix}", f"a.{suffix}"])
    assert found == {f"a.{suffix}": CameraIdentity("Canon", "Canon EOS 5D", 24, 24, *SIZE)}


def test_the_equivalent_focal_length_counts_before_the_other() -> None:
    """As in COLMAP: 35.1 and 35.3 mm are one camera where EXIF says 53 mm of both."""
    one, other = (CameraIdentity("Foo", "Bar", focal, 53, 1500, 1000) for focal in (35.1, 35.3))
    assert (one.key, one.focal) == (other.key, 53)
    assert FLAT.focal == 35
    assert FLAT.key != ZOOMED.key


def test_photographs_without_enough_exif_are_grouped_by_size_and_what_there_is() -> None:
    no_focal = CameraIdentity("Foo", "Bar", 0, 0, 640, 480)
    identities = {"d": SCAN, "c": TURNED_SCAN, "b": SCAN, "a": FLAT, "e": no_focal, "f": no_focal}
    assert without_whole_identity(identities) == [["b", "d"], ["c"], ["e", "f"]]


def test_what_is_said_of_cameras_of_the_database() -> None:
    identities = {"a": FLAT, "b": FLAT, "c": UPRIGHT, "d": SCAN, "e": FLAT}
    camera_ids = {"a": 1, "b": 1, "c": 2, "d": 3, "e": 3, "unread": 4}
    assert identities_of_cameras(camera_ids, identities) == {1: FLAT, 2: UPRIGHT}


def test_cameras_that_are_one_turned() -> None:
    assert turned_partners({3: FLAT, 1: UPRIGHT, 2: ZOOMED, 5: SCAN, 4: TURNED_SCAN}) == [(1, 3), (4, 5)]
    assert turned_partners({1: FLAT, 2: UPRIGHT, 3: UPRIGHT}) == []
    assert turned_partners({1: FLAT, 2: FLAT}) == []
    square = CameraIdentity("Foo", "Bar", 35, 0, 900, 900)
    assert turned_partners({1: square, 2: square}) == []
