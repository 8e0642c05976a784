"""What is known of cameras reaches COLMAP through the EXIF of the grey images, pixel for pixel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from PIL.TiffImagePlugin import IFDRational as R
from told import Told

from colmap_ihe import Weights, convert_folder
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import OptionError
from colmap_ihe.photographs.encode import SUFFIXES, Format, encode_image
from colmap_ihe.photographs.exif.blocks import put_together
from colmap_ihe.photographs.exif.metadata import Metadata, describe
from colmap_ihe.photographs.known_cameras import DIAGONAL_35MM, filled_in, focal_px, pattern_of
from colmap_ihe.photographs.png import encode_png
from colmap_ihe.pipeline.warnings.colmap_sensors import knows_sensor
from colmap_ihe.project.options import CamerasOptions, ConvertOptions

FORMATS: tuple[Format, ...] = get_args(Format)
SIZE = (1500, 1000)
DIAGONAL = math.hypot(*SIZE)
GREEN = Weights(0, 1, 0, method="file")
FULL_FRAME: dict[str, Any] = {"focal_length": 24, "sensor_width": 36}


def cameras(**patterns: Mapping[str, Any]) -> CamerasOptions:
    return CamerasOptions.model_validate(
        {name.replace("all", "*"): known for name, known in patterns.items()}
    )


def by_exif(make: str = "", model: str = "", **lengths: Any) -> Metadata:
    """`focal`, `f35` in mm; `plane` in pixels per mm."""
    numbers = {"focal": 0x920A, "f35": 0xA405}
    shot = {numbers[k]: R(v) if k == "focal" else v for k, v in lengths.items() if k in numbers}
    if "plane" in lengths:
        shot |= {0xA20E: R(round(lengths["plane"] * 1e6), 10**5), 0xA210: 3}
    return describe(put_together({0x010F: make, 0x0110: model} if make else {}, shot, {}))


def inferred(
    metadata: Metadata, folder: Path, file_format: Format = "png", size: tuple[int, int] = SIZE
) -> Any:
    """COLMAP's camera for a grey image with this EXIF."""
    file = folder / f"grey{SUFFIXES[file_format]}"
    file.write_bytes(encode_image(np.zeros(size[::-1], np.uint8), metadata.exif, file_format))
    return pycolmap.infer_camera_from_image(file)


@pytest.mark.parametrize("file_format", FORMATS)
@pytest.mark.parametrize("size", [SIZE, (1000, 1500), (1311, 873)], ids=str)
@pytest.mark.parametrize("focal, width", [(24, 36), (8.8, 13.2), (4.38, 6.17), (152.4, 230)])
def test_colmap_finds_the_focal_length_that_is_given(
    tmp_path: Path, file_format: Format, size: tuple[int, int], focal: float, width: float
) -> None:
    known = cameras(all={"focal_length": focal, "sensor_width": width})
    found = filled_in(Metadata(), known, "a.jpg", *size)
    camera = inferred(found, tmp_path, file_format, size)
    assert camera.has_prior_focal_length
    assert camera.params[0] == pytest.approx(focal / width * max(size), rel=1e-5)
    assert focal_px(found, *size) == pytest.approx(camera.params[0], rel=1e-6)


PLANE = SIZE[0] / 36
BY_35 = DIAGONAL / DIAGONAL_35MM


ZOOM = {"focal_length": 24, "focal_length_35mm": 36}
OVERRIDE = {"override": True}
FILLED_IN: dict[str, tuple[dict[str, Any], dict[str, Any], float]] = {
    "only the equivalent": ({}, {"focal_length_35mm": 28}, 28 * BY_35),
    "both": ({}, {"focal_length": 24, "focal_length_35mm": 36}, 36 * BY_35),
    "the sensor is more exact": ({}, FULL_FRAME | {"focal_length_35mm": 25}, 24 * PLANE),
    "the sensor only": ({"focal": 50}, {"sensor_width": 36}, 50 * PLANE),
    "EXIF knows the focal length": ({"focal": 50}, FULL_FRAME, 50 * PLANE),
    "EXIF knows the plane": ({"plane": PLANE}, FULL_FRAME | {"sensor_width": 9}, 24 * PLANE),
    "a zoom lens, whole": ({"focal": 50}, ZOOM, 75 * BY_35),
    "a zoom lens": ({"focal": 51}, ZOOM, 76.5 * BY_35),
    "plane and equivalent": ({"plane": PLANE}, {"focal_length_35mm": 28}, 28 * BY_35),
    "EXIF knows all": ({"focal": 50, "plane": PLANE}, {"focal_length_35mm": 9}, 50 * PLANE),
    "EXIF knows the equivalent": ({"f35": 30}, FULL_FRAME, 30 * BY_35),
    "override": ({"f35": 30}, FULL_FRAME | {"override": True}, 24 * PLANE),
    "override the lens": ({"focal": 50, "f35": 75}, {"focal_length": 10, "override": True}, 15 * BY_35),
    "override sensor": ({"focal": 50, "plane": 9}, {"sensor_width": 36, "override": True}, 50 * PLANE),
    "override 35": ({"focal": 8.8, "f35": 99}, {"focal_length_35mm": 24, "override": True}, 24 * BY_35),
    "override the name": ({"focal": 50, "f35": 75}, {"model": "other", "override": True}, 75 * BY_35),
}


@pytest.mark.parametrize(("said", "known", "expected_px"), FILLED_IN.values(), ids=FILLED_IN)
def test_it_fills_in_what_exif_does_not_say(
    tmp_path: Path, said: dict[str, Any], known: dict[str, Any], expected_px: float
) -> None:
    found = filled_in(by_exif("Foo", "Bar", **said), cameras(all=known), "a.jpg", *SIZE)
    camera = inferred(found, tmp_path)
    assert camera.has_prior_focal_length
    assert camera.params[0] == pytest.approx(expected_px, rel=1e-4)
    assert focal_px(found, *SIZE) == pytest.approx(expected_px, rel=1e-4)


def test_what_exif_says_stays_unless_overridden() -> None:
    said = by_exif("Foo", "Bar", focal=50, f35=75)
    known = {"make": "Other", "model": "One", "focal_length": 24, "sensor_width": 36}
    assert filled_in(said, cameras(all=known), "a.jpg", *SIZE) == said
    over = filled_in(said, cameras(all=known | {"override": True}), "a.jpg", *SIZE)
    assert (over.make, over.model, over.focal_mm, over.focal_35mm) == ("Other", "One", 24, 0)


def test_make_and_model_are_filled_in_so_that_photographs_share_a_camera() -> None:
    known = cameras(**{"drone/*": {"make": "DJI", "model": "Mini é"}, "all": FULL_FRAME})
    drone = filled_in(by_exif("Foo", ""), known, "drone/a.jpg", *SIZE)
    assert (drone.make, drone.model, drone.focal_mm) == ("Foo", "Mini é", 0)
    other = filled_in(Metadata(), known, "a.jpg", *SIZE)
    assert (other.make, other.model) == ("unknown", "camera of *")
    assert filled_in(Metadata(), cameras(**{"b*": FULL_FRAME}), "a.jpg", *SIZE) == Metadata()


def test_the_first_pattern_that_fits_counts() -> None:
    known = cameras(**{"a/*.JPG": FULL_FRAME, "a/*": FULL_FRAME, "all": FULL_FRAME})
    names = ["a/b/c.JPG", "a/c.jpg", "c.JPG"]
    assert [pattern_of(known, name) for name in names] == ["a/*.JPG", "a/*", "*"]
    assert pattern_of(cameras(), "c.JPG") is None
    backslashed = cameras(**{"a\\*.JPG": FULL_FRAME})
    assert pattern_of(backslashed, "a/1.JPG") == "a\\*.JPG"
    assert pattern_of(backslashed, "b/1.JPG") is None


def photographs(folder: Path, *names: str, metadata: Metadata | None = None) -> Path:
    for seed, name in enumerate(names):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        pixels = np.random.default_rng(seed).integers(0, 256, (72, 108, 3), np.uint8)
        (folder / name).write_bytes(encode_png(pixels, metadata.exif if metadata else b""))
    return folder


def convert(images: Path, out: Path, known: CamerasOptions, **options: Any) -> list[str]:
    told = Told()
    convert_folder(images, out, weights=GREEN, cameras=known, progress=told, **options)
    return told.warnings


@pytest.mark.parametrize("file_format", FORMATS)
def test_photographs_without_exif_become_the_cameras_that_took_them(
    tmp_path: Path, file_format: Format
) -> None:
    names = ["a/1.png", "a/2.png", "b/1.png", "b/2.png", "c/1.png", "c/2.png"]
    images = photographs(tmp_path / "images", *names)
    known = cameras(**{"a/*": FULL_FRAME, "b/*": FULL_FRAME | {"focal_length": 35}})
    colour, options = tmp_path / "colour", ConvertOptions(format=file_format)
    assert convert(images, tmp_path / "out", known, colour=colour, options=options) == []
    for folder in ("out", "colour"):
        database = tmp_path / f"{folder}.db"
        pycolmap.Database.open(database).close()
        grey = [str(Path(name).with_suffix(SUFFIXES[file_format])) for name in names]
        pycolmap.import_images(
            database, tmp_path / folder, camera_mode=pycolmap.CameraMode.AUTO, image_names=grey
        )
        with pycolmap.Database.open(database) as opened:
            found = {c.camera_id: c for c in opened.read_all_cameras()}
            of_image = {i.name: i.camera_id for i in opened.read_all_images()}
        ids = [of_image[name] for name in grey]
        assert ids[0] == ids[1] != ids[2] == ids[3]
        assert len(set(ids)) == 4  # those of c, of which nothing is known, have one each
        assert [found[i].has_prior_focal_length for i in ids] == [True] * 4 + [False] * 2
        assert found[ids[0]].params[0] == pytest.approx(24 / 36 * 108, rel=1e-5)
        assert found[ids[2]].params[0] == pytest.approx(35 / 36 * 108, rel=1e-5)


def test_other_cameras_make_other_grey_images_and_the_same_ones_none(tmp_path: Path) -> None:
    images = photographs(tmp_path / "images", "a/1.png", "b/1.png")
    known = cameras(**{"a/*": FULL_FRAME, "b/*": FULL_FRAME})
    convert(images, tmp_path / "out", known)
    first = {p: p.stat().st_mtime_ns for p in sorted((tmp_path / "out").rglob("*.png"))}
    convert(images, tmp_path / "out", known)
    assert {p: p.stat().st_mtime_ns for p in first} == first
    other = cameras(**{"a/*": FULL_FRAME, "b/*": FULL_FRAME | {"focal_length": 50}})
    convert(images, tmp_path / "out", other)
    assert [p.stat().st_mtime_ns == first[p] for p in first] == [True, False]


def test_a_pattern_that_fits_nothing_is_told(tmp_path: Path) -> None:
    images = photographs(tmp_path / "images", "north/1.png")
    told = convert(images, tmp_path / "out", cameras(**{"North/*": FULL_FRAME, "all": FULL_FRAME}))
    assert len(told) == 1
    assert "'North/*' fits no photograph" in told[0]
    assert "'north/1.png'" in told[0]


@pytest.mark.parametrize(
    ("known", "said", "missing"),
    [
        ({"focal_length": 24}, {}, "width of the sensor"),
        ({"focal_length": 8.8, "make": "Unheard", "model": "Of"}, {}, "width of the sensor"),
        ({"sensor_width": 36}, {}, "focal length"),
        ({"sensor_width": 36}, {"make": "Foo", "model": "Bar"}, "focal length"),
    ],
)
def test_what_is_still_missing_is_an_error(
    tmp_path: Path, known: dict[str, Any], said: dict[str, Any], missing: str
) -> None:
    images = photographs(tmp_path / "images", "1.png", metadata=by_exif(**said))
    with pytest.raises(OptionError, match=f"the {missing} of 1.png is neither given nor in EXIF") as caught:
        convert(images, tmp_path / "out", cameras(all=known))
    assert "focal_length and sensor_width" in caught.value.hint
    assert not (tmp_path / "out").exists()


def test_what_is_missing_of_some_is_a_warning(tmp_path: Path) -> None:
    images = photographs(tmp_path / "images", "1.png", metadata=by_exif("Foo", "Bar", focal=50))
    photographs(images, "scan.png")
    told = convert(images, tmp_path / "out", cameras(all={"sensor_width": 36}))
    assert len(told) == 1
    assert "focal length of scan.png is neither given nor in EXIF, 1 of 2" in told[0]


def test_a_focal_length_is_enough_where_colmap_knows_the_sensor(tmp_path: Path) -> None:
    assert knows_sensor("NIKON CORPORATION", "NIKON D70")
    assert not knows_sensor("unknown", "camera of *")
    images = photographs(tmp_path / "images", "1.png", metadata=by_exif("NIKON CORPORATION", "NIKON D70"))
    assert convert(images, tmp_path / "out", cameras(all={"focal_length": 50})) == []
    camera = pycolmap.infer_camera_from_image(tmp_path / "out/1.png")
    assert camera.has_prior_focal_length
    assert camera.params[0] == pytest.approx(50 / 23.7 * 108, rel=0.001)  # 23.7 mm, the maker's figure


def test_sensors_that_colmap_would_mix_are_told(tmp_path: Path) -> None:
    said = by_exif("Foo", "Bar", focal=50)
    images = photographs(tmp_path / "images", "full/1.png", "dx/1.png", metadata=said)
    known: dict[str, dict[str, Any]] = {"full/*": {"sensor_width": 36}, "dx/*": {"sensor_width": 24}}
    told = convert(images, tmp_path / "out", cameras(**known))
    assert len(told) == 1
    assert "sensors of several widths" in told[0]
    known["dx/*"] |= {"model": "Bar DX", "override": True}
    assert convert(images, tmp_path / "out", cameras(**known)) == []


def test_a_focal_length_that_colmap_refuses_is_told(tmp_path: Path) -> None:
    """As of a photograph that was made a thumbnail by a program that left the focal plane alone."""
    said = by_exif("Foo", "Bar", focal=135, plane=175)
    images = photographs(tmp_path / "images", "1.png", metadata=said)
    told = convert(images, tmp_path / "out", cameras())
    assert len(told) == 1
    assert "1.png (2.2e+02)" in told[0]
    known = cameras(all={"sensor_width": 22.2, "override": True})
    assert convert(images, tmp_path / "out", known) == []
    found = pycolmap.infer_camera_from_image(tmp_path / "out/1.png").params[0]
    assert found == pytest.approx(135 / 22.2 * 108, rel=1e-5)
