"""The demo as others meet it: files whose pictures, EXIF and truth have to agree."""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import cv2
import exifread
import numpy as np
import numpy.typing as npt
import pycolmap
import pytest
import rawpy
from same_results import pixels_of
from small_demo import DEMO_SIZE, DEMO_VIEWS

from colmap_ihe.errors import Cancelled
from colmap_ihe.evaluation.demo.camera import SENSOR_GAINS
from colmap_ihe.evaluation.demo.frescoes import BORDER_M
from colmap_ihe.evaluation.demo.render import render_demo
from colmap_ihe.evaluation.demo.scene import ISOLUMINANT_PANELS
from colmap_ihe.evaluation.truth import TrueImage, Truth, pose_errors, read_truth
from colmap_ihe.machine.progress import Silent

Indices = npt.NDArray[np.intp]
REC709 = np.array((0.2126, 0.7152, 0.0722))


@pytest.fixture(scope="module")
def demo(small_demo: Path) -> Path:
    return small_demo


@pytest.fixture(scope="module")
def truth(demo: Path) -> Truth:
    return read_truth(demo / "truth")


def photograph(demo: Path, stem: str) -> Any:
    return pixels_of(demo / f"images/{stem}.jpg")


def tags_of(file: Path) -> dict[str, str]:
    with file.open("rb") as stream:
        return {name: str(value) for name, value in exifread.process_file(stream, details=False).items()}


def project(points: npt.NDArray[np.float64], image: TrueImage) -> npt.NDArray[np.float64]:
    """(N, 3) in the world -> (N, 3): x, y in pixels and depth."""
    camera = points @ image.cam_from_world[:, :3].T + image.cam_from_world[:, 3]
    pixels = camera @ image.calibration.T
    return np.column_stack((pixels[:, :2] / pixels[:, 2:], camera[:, 2]))


def seen_points(image: TrueImage) -> tuple[Indices, Indices, npt.NDArray[np.float64]]:
    """Rows and columns of a sparse set of pixels, and what they see, (N, 3) in the world."""
    depth = image.depth_m()
    rows, columns = (n.ravel() for n in np.mgrid[4 : image.height : 7, 4 : image.width : 7])
    z = depth[rows, columns].astype(np.float64)
    keep = z > 0
    pixels = np.column_stack((columns + 0.5, rows + 0.5, np.ones(rows.size)))[keep]
    camera = pixels @ np.linalg.inv(image.calibration).T * z[keep, None]
    return rows[keep], columns[keep], (camera - image.cam_from_world[:, 3]) @ image.cam_from_world[:, :3]


def test_each_shot_is_there_as_raw_jpeg_and_truth(demo: Path, truth: Truth) -> None:
    assert len(truth.images) == DEMO_VIEWS
    assert 15 < truth.extent_m < 40
    for stem, image in truth.images.items():
        assert photograph(demo, stem).shape == (320, 480, 3)
        with rawpy.imread(str(demo / "images" / f"{stem}.dng")) as raw:
            assert raw.postprocess(half_size=False, user_flip=0).shape == (320, 480, 3)
        depth = image.depth_m()
        assert depth.shape == (320, 480)
        assert 0.85 < np.mean(depth > 0) <= 1
        assert 3 < depth[depth > 0].min() < depth.max() < 30
        np.testing.assert_allclose(image.calibration[:2, 2], (240, 160))


def test_both_files_of_a_shot_carry_the_same_exif(demo: Path, truth: Truth) -> None:
    exposures = set()
    for stem in truth.images:
        raw, jpeg = (tags_of(demo / "images" / f"{stem}.{suffix}") for suffix in ("dng", "jpg"))
        for name in ("Make", "Model", "Orientation"):
            assert raw[f"Image {name}"] == jpeg[f"Image {name}"]
        for name in ("ExposureTime", "FNumber", "ISOSpeedRatings", "FocalLength", "FocalLengthIn35mmFilm"):
            assert raw[f"EXIF {name}"] == jpeg[f"EXIF {name}"]
        assert jpeg["EXIF FocalLengthIn35mmFilm"] == "30"
        assert (jpeg["EXIF ExifImageWidth"], jpeg["EXIF ExifImageLength"]) == ("480", "320")
        exposures.add(Fraction(jpeg["EXIF ExposureTime"]))
    assert len(exposures) > 1


def test_depth_of_one_view_agrees_with_the_next(truth: Truth) -> None:
    images = [truth.images[stem] for stem in sorted(truth.images)]
    for first, second in pairwise(images):
        _, _, points = seen_points(first)
        x, y, z = project(points, second).T
        inside = (x > 1) & (x < second.width - 1) & (y > 1) & (y < second.height - 1) & (z > 0)
        there = second.depth_m()[y[inside].astype(int), x[inside].astype(int)]
        ratio = there / z[inside]
        visible = np.abs(ratio - 1) < 0.02
        # The rest is occluded in the second view (nearer there), never seen through (farther there),
        # but for pixels that fall across an edge.
        assert 0.6 < visible.mean() < 1
        assert np.mean(ratio > 1.02) < 0.04
        assert abs(np.median(ratio[visible]) - 1) < 5e-4


def test_depth_puts_ground_floor_and_walls_where_they_are(truth: Truth) -> None:
    points = np.vstack([seen_points(image)[2] for image in truth.images.values()])
    x, y, z = points.T
    for name, off, nearby in (
        ("ground", z, (y < -2.15) & (z < 0.03)),
        ("floor of the passage", z - 0.48, (y > 0.1) & (y < 3.5) & (z < 0.51)),
        ("facade", y, (abs(x) < 6) & (z > 1) & (z < 4.5) & (abs(y) < 0.03)),
        ("back wall", y - 3.6, (abs(x) < 6) & (z > 0.6) & (z < 2.9) & (y > 3.59)),
    ):
        assert nearby.sum() > 50, name
        # Half a pixel is 15 mm on the facade, at this size.
        assert np.median(np.abs(off[nearby])) < 1.5e-3, name


def test_pictures_show_the_same_thing_at_the_same_place(demo: Path, truth: Truth) -> None:
    stems = sorted(truth.images)[2:4]
    first, second = (truth.images[stem] for stem in stems)
    rows, columns, points = seen_points(first)
    x, y, z = project(points, second).T
    inside = (x > 5) & (x < second.width - 5) & (y > 5) & (y < second.height - 5)
    there = second.depth_m()[y[inside].astype(int), x[inside].astype(int)]
    visible = np.flatnonzero(inside)[np.abs(there / z[inside] - 1) < 0.01]
    grey = [cv2.GaussianBlur(photograph(demo, stem) @ REC709, (0, 0), 1.0) for stem in stems]
    here = grey[0][rows[visible], columns[visible]]
    shift = [
        np.corrcoef(here, grey[1][(y[visible] + dy).astype(int), (x[visible] + dx).astype(int)])[0, 1]
        for dx, dy in ((0, 0), (4, 0), (-4, 0), (0, 4), (0, -4))
    ]
    assert shift[0] > 0.9
    assert max(shift[1:]) < shift[0] - 0.1


def test_raw_and_jpeg_show_the_same_light(demo: Path, truth: Truth) -> None:
    stem = sorted(truth.images)[1]
    with rawpy.imread(str(demo / "images" / f"{stem}.dng")) as raw:
        mosaic = (raw.raw_image.astype(np.float64) - 512) / (16383 - 512)
    jpeg = photograph(demo, stem).astype(np.float64) / 255
    light = np.where(jpeg <= 0.04045, jpeg / 12.92, ((jpeg + 0.055) / 1.055) ** 2.4)
    sites = ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2))
    for row, column, channel in sites:
        raw_light = mosaic[row::2, column::2] / SENSOR_GAINS[channel]
        difference = raw_light - light[row::2, column::2, channel]
        unclipped = light[row::2, column::2, channel] < 0.9
        assert abs(np.mean(difference[unclipped])) < 0.004
        assert 0.0005 < np.std(difference[unclipped]) < 0.03


def test_developing_the_raw_gives_the_colours_of_the_jpeg(demo: Path, truth: Truth) -> None:
    stem = sorted(truth.images)[1]
    with rawpy.imread(str(demo / "images" / f"{stem}.dng")) as raw:
        developed = raw.postprocess(use_camera_wb=True, no_auto_bright=True, gamma=(2.4, 12.92))
    difference = developed.astype(np.float64) - photograph(demo, stem)
    assert np.all(np.abs(difference.mean(axis=(0, 1))) < 1)
    assert 0.2 < np.median(np.abs(difference)) < 4


def test_isoluminant_panels_are_flat_in_rec709_and_not_in_colour(demo: Path, truth: Truth) -> None:
    image = truth.images[sorted(truth.images)[2]]
    rgb = photograph(demo, sorted(truth.images)[2]).astype(np.float64)
    for panel in ISOLUMINANT_PANELS[:2]:
        margin = BORDER_M + 0.06
        (left, bottom), (right, top) = panel.low, panel.high
        sides = product((left + margin, right - margin), (bottom + margin, top - margin))
        corners = [(x, panel.at, z) for x, z in sides]
        outline = cv2.convexHull(np.rint(project(np.array(corners), image)[:, :2] - 0.5).astype(np.int32))
        mask = np.zeros(rgb.shape[:2], np.uint8)
        cv2.fillConvexPoly(mask, outline, 1)
        pixels = rgb[mask > 0]
        assert len(pixels) > 800
        assert np.std(pixels @ REC709) < 1.5
        assert np.std(pixels[:, 0]) > 8
        assert np.std(pixels[:, 2]) > 8


def test_colmap_finds_the_true_cameras(demo: Path, truth: Truth, tmp_path: Path) -> None:
    names = [f"{stem}.jpg" for stem in sorted(truth.images)]
    database, images = tmp_path / "database.db", demo / "images"
    pycolmap.extract_features(database, images, image_names=names, camera_mode=pycolmap.CameraMode.SINGLE)
    pycolmap.match_exhaustive(database)
    models = pycolmap.incremental_mapping(database, images, tmp_path)
    assert len(models) == 1
    oriented = {i.name: i.cam_from_world().matrix() for i in models[0].images.values() if i.has_pose}
    errors = pose_errors(oriented, truth)
    assert errors.missing == ()
    assert 0 < errors.rotation_error_deg < 0.3
    assert 0 < errors.position_error_percent < 0.1


def test_a_finished_demo_is_not_rendered_again(demo: Path) -> None:
    files = sorted(p for p in demo.rglob("*") if p.is_file())
    before = [p.stat().st_mtime_ns for p in files]
    render_demo(demo, views=DEMO_VIEWS, size=DEMO_SIZE)
    assert [p.stat().st_mtime_ns for p in files] == before
    assert sorted(p for p in demo.rglob("*") if p.is_file()) == files


@pytest.mark.slow
def test_the_same_seed_gives_the_same_files_and_another_does_not(tmp_path: Path) -> None:
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        render_demo(tmp_path / name, views=2, size=(96, 64), seed=seed)
    first, again, other = ((tmp_path / n / "images" / "portico_01.dng").read_bytes() for n in "abc")
    assert first == again != other
    (tmp_path / "a" / "images" / "portico_01.dng").unlink()
    render_demo(tmp_path / "a", views=2, size=(96, 64), seed=3)
    assert (tmp_path / "a" / "images" / "portico_01.dng").read_bytes() == first


def test_a_cancelled_demo_is_incomplete_and_says_so(tmp_path: Path) -> None:
    class Impatient(Silent):
        def advance(self, count: int = 1) -> None:
            raise Cancelled

    with pytest.raises(Cancelled):
        render_demo(tmp_path, views=3, size=(96, 64), progress=Impatient())
    assert not (tmp_path / "truth" / "cameras.json").exists()
    assert not [p for p in tmp_path.rglob(".*") if p.is_file()]
    render_demo(tmp_path, views=3, size=(96, 64))
    assert len(json.loads((tmp_path / "truth" / "cameras.json").read_text())["cameras"]) == 3


def test_what_cannot_be_rendered_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"size=\(97, 64\)"):
        render_demo(tmp_path, size=(97, 64))
    with pytest.raises(ValueError, match="views=1"):
        render_demo(tmp_path, views=1)
