"""Which images share a camera in COLMAP's database, whatever EXIF says; and what COLMAP does by itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from grey_noise import WHOLE, noise

from colmap_ihe.colmap.image_import import assumed, image_groups, import_images
from colmap_ihe.colmap.known_calibration import KnownCalibration
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.camera_identity import read_identities

AUTO, SINGLE, PER_IMAGE = (
    pycolmap.CameraMode.AUTO,
    pycolmap.CameraMode.SINGLE,
    pycolmap.CameraMode.PER_IMAGE,
)
PARTS: Mapping[str, Mapping[str, Any]] = {
    "none": {},
    "no-focal": {"make": "Foo", "model": "Bar"},
    "no-make": {"model": "Bar", "focal": 35},
    "no-model": {"make": "Foo", "focal": 35},
    "only-focal": {"focal": 35},
    "other-focal": {"focal": 40},
    "only-35mm": {"f35": 50},
}
"""What photographs may say of their cameras and COLMAP cannot group them by."""


def cameras_of(grey: Path, names: list[str], mode: pycolmap.CameraMode = AUTO) -> dict[str, int]:
    """Import the images; return their camera ids by name, in the order of their image ids."""
    database = grey.with_name("database.db")
    database.unlink(missing_ok=True)
    groups = image_groups(names, mode, read_identities(grey, names))
    import_images(database, grey, groups, pycolmap.ImageReaderOptions(), KnownCalibration(), SILENT)
    with pycolmap.Database.open(database) as opened:
        images = sorted(opened.read_all_images(), key=lambda image: int(image.image_id))
        assert {i.camera_id for i in images} == {c.camera_id for c in opened.read_all_cameras()}
        assert opened.num_rigs() == opened.num_cameras()
        assert opened.num_frames() == len(images)
    assert not list(grey.parent.glob("unfinished*"))
    return {str(image.name): image.camera_id for image in images}


def test_what_colmap_does_by_itself(tmp_path: Path) -> None:
    """The reason for all this: without make, model or focal length each photograph has a camera of its own."""
    grey = tmp_path / "grey"
    names = [noise(grey, f"{kind}-{n}.png", **said) for kind, said in PARTS.items() for n in range(2)]
    names += [noise(grey, f"whole-{n}.png", **WHOLE) for n in range(2)]
    database = tmp_path / "plain.db"
    pycolmap.Database.open(database).close()
    pycolmap.import_images(database, grey, camera_mode=AUTO, image_names=names)
    with pycolmap.Database.open(database) as opened:
        assert opened.num_cameras() == 2 * len(PARTS) + 1


def test_photographs_of_one_size_without_exif_share_a_camera(tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    names = [noise(grey, name) for name in ("c.png", "a/b.png", "b.png")]
    assert cameras_of(grey, names) == {"a/b.png": 1, "b.png": 1, "c.png": 1}
    noise(grey, "b.png", (66, 90))
    assert cameras_of(grey, names) == {"a/b.png": 1, "c.png": 1, "b.png": 2}


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_photographs_that_say_the_same_part_share_a_camera(tmp_path: Path, suffix: str) -> None:
    grey = tmp_path / "grey"
    names = [noise(grey, f"{kind}-{n}.{suffix}", **said) for kind, said in PARTS.items() for n in range(2)]
    found = cameras_of(grey, names)
    for kind in PARTS:
        assert found[f"{kind}-0.{suffix}"] == found[f"{kind}-1.{suffix}"]
    assert sorted(set(found.values())) == [1, 2, 3, 4, 5, 6, 7]
    assert cameras_of(grey, names[::-1]) == found


def test_photographs_with_exif_stay_as_colmap_groups_them(tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    names = [noise(grey, f"{n}.png", **WHOLE) for n in (1, 3)]
    names += [noise(grey, "4.png", **WHOLE | {"focal": 50}), noise(grey, "5.png", (66, 90), **WHOLE)]
    names += [noise(grey, "0.png"), noise(grey, "2.png")]
    assert cameras_of(grey, names) == {"1.png": 1, "3.png": 1, "4.png": 2, "5.png": 3, "0.png": 4, "2.png": 4}


def test_other_modes_mean_what_they_mean_in_colmap(tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    names = [noise(grey, name) for name in ("a/1.png", "a/2.png", "b/1.png")]
    assert set(cameras_of(grey, names, PER_IMAGE).values()) == {1, 2, 3}
    assert list(cameras_of(grey, names, pycolmap.CameraMode.PER_FOLDER).values()) == [1, 1, 2]
    noise(grey, "b/1.png", **WHOLE)
    assert set(cameras_of(grey, names, SINGLE).values()) == {1}


def test_an_image_that_cannot_be_read_keeps_the_others_together(tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    names = [noise(grey, f"{n}.png") for n in range(3)]
    (grey / "0.png").write_bytes(b"no picture")
    assert cameras_of(grey, [*names, "gone.png"]) == {"1.png": 1, "2.png": 1}


def test_what_was_assumed_is_counted(tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    names = [noise(grey, f"{n}.png") for n in range(3)]
    names += [noise(grey, "alone.png", (66, 90)), *(noise(grey, f"w{n}.png", **WHOLE) for n in range(2))]
    names += [noise(grey, f"n{n}.png", make="Foo", model="Bar") for n in range(2)]
    identities = read_identities(grey, names)
    assert assumed(image_groups(names, AUTO, identities)) == (3, 2)
    assert assumed(image_groups(names, SINGLE, identities)) == ()
