"""Cameras in the database that start from the calibration of another campaign."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from calibrations import PARAMS, calibrated
from grey_noise import WHOLE, noise

from colmap_ihe.colmap.calibration_file import CalibratedCamera
from colmap_ihe.colmap.image_import import image_groups, import_images
from colmap_ihe.colmap.known_calibration import CalibrationUse, KnownCalibration, calibration_for, use_of
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.camera_identity import CameraIdentity, read_identities

FOO, SCAN = calibrated(), calibrated("", "", 0)


def imported(
    grey: Path, names: Sequence[str], cameras: Sequence[CalibratedCamera], mode: str = "AUTO"
) -> tuple[dict[str, pycolmap.Camera], CalibrationUse]:
    """Import the images; return the camera of each by name, and what the calibration was good for."""
    database = grey.with_name("database.db")
    database.unlink(missing_ok=True)
    known = KnownCalibration(cameras, read_identities(grey, names))
    groups = image_groups(names, getattr(pycolmap.CameraMode, mode), known.identities)
    import_images(database, grey, groups, pycolmap.ImageReaderOptions(), known, SILENT)
    with pycolmap.Database.open(database) as opened:
        images = opened.read_all_images()
        return {str(i.name): opened.read_camera(i.camera_id) for i in images}, use_of(database, known)


def test_the_camera_of_the_same_photographs_starts_from_it(tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    names = [noise(grey, f"{n}.png", **WHOLE) for n in range(2)]
    names += [noise(grey, "longer.png", **WHOLE | {"focal": 50})]
    names += [noise(grey, "upright.png", (66, 90), **WHOLE)]
    found, use = imported(grey, names, [FOO, SCAN])
    for name in names[:2]:
        assert found[name].model_name == "OPENCV"
        assert found[name].params.tolist() == PARAMS
        assert found[name].has_prior_focal_length
    for name in names[2:]:
        assert found[name].model_name == "SIMPLE_RADIAL"
        assert not found[name].has_prior_focal_length
    assert use == CalibrationUse(
        (found["0.png"].camera_id,), ("longer.png", "upright.png"), ("no make and model, 90x66",)
    )


def test_photographs_without_exif_start_from_the_one_of_their_size(tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    names = [noise(grey, f"{n}.png") for n in range(2)] + [noise(grey, "half.png", (180, 132))]
    found, use = imported(grey, names, [FOO, SCAN])
    assert found["0.png"].params.tolist() == found["1.png"].params.tolist() == PARAMS
    assert use.without == ("half.png",)
    assert use.unused == ("Foo Bar at 35 mm, 90x66",)


def test_at_half_size_it_is_rescaled(tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    name = noise(grey, "half.png", (90, 66), **WHOLE)
    found, use = imported(grey, [name], [calibrated("Foo", "Bar", 35, (181, 132))])
    factors = np.array([90 / 181, 0.5, 90 / 181, 0.5, 1, 1, 1, 1])
    np.testing.assert_allclose(found[name].params, factors * PARAMS, rtol=1e-12)
    assert (found[name].width, found[name].height) == (90, 66)
    assert use.without == use.unused == ()


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        ([(6000, 4000), (3000, 2000)], (3000, 2000)),
        ([(6000, 4000), (12000, 8000)], (12000, 8000)),
        ([(6001, 4001)], (6001, 4001)),
        ([(6000, 4010)], None),
        ([(2000, 3000)], None),
    ],
)
def test_which_size_a_photograph_of_3000x2000_starts_from(
    sizes: list[tuple[int, int]], expected: tuple[int, int] | None
) -> None:
    """The same before the largest; one that was cropped or turned fits none."""
    found = calibration_for(
        CameraIdentity("Foo", "Bar", 35, 0, 3000, 2000),
        [calibrated("Foo", "Bar", 35, size) for size in sizes],
    )
    assert (found and found.identity.size) == expected


def test_a_camera_of_several_kinds_of_photographs_starts_as_usual(tmp_path: Path) -> None:
    grey = tmp_path / "grey"
    names = [noise(grey, "a.png", **WHOLE), noise(grey, "b.png")]
    found, use = imported(grey, names, [FOO, SCAN], "SINGLE")
    assert {camera.model_name for camera in found.values()} == {"SIMPLE_RADIAL"}
    assert use == CalibrationUse(
        (), ("a.png", "b.png"), ("Foo Bar at 35 mm, 90x66", "no make and model, 90x66")
    )
    found, use = imported(grey, names, [FOO, SCAN], "PER_IMAGE")
    assert {tuple(camera.params) for camera in found.values()} == {tuple(PARAMS)}
    assert (use.camera_ids, use.without) == ((1, 2), ())
