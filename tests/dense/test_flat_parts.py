"""The part of a photograph that COLMAP is given to lay flat."""

from __future__ import annotations

import numpy as np
import pytest
from lenses import SIZE, Lens, fisheye

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.cloud import _cut_warnings
from colmap_ihe.dense.flat_parts import flat_part
from colmap_ihe.errors import MappingError


@pytest.mark.parametrize(
    ("lens", "given", "model"),
    [
        (Lens("OPENCV", (330, 333), (-0.1, 0.0, 0.0, 0.0)), True, "OPENCV"),
        (Lens("OPENCV", (330, 333), (0.0,) * 4), False, "PINHOLE"),
        (Lens("SIMPLE_RADIAL", (330, 330), (0.0,)), False, "PINHOLE"),
        (fisheye(120, "SIMPLE_RADIAL_FISHEYE", (0.0,)), False, "OPENCV_FISHEYE"),
        (fisheye(120, "FISHEYE", ()), False, "OPENCV_FISHEYE"),
    ],
)
def test_a_camera_is_handed_on_as_what_it_is(lens: Lens, given: bool, model: str) -> None:
    camera = lens.camera(7)
    part = flat_part(camera)
    assert part.is_whole
    assert part.camera.model_name == model
    assert (part.camera.params.tolist() == camera.params.tolist()) == given
    pixels = np.random.default_rng(0).uniform((0, 0), SIZE, (100, 2))
    before, after = (np.asarray(c.cam_ray_from_img(pixels)) for c in (camera, part.camera))
    assert after == pytest.approx(before, abs=1e-7)


def test_a_part_has_the_rays_of_its_pixels_in_the_photograph() -> None:
    camera = fisheye(200, distortion=(0.002, 0.0, 0.0, 0.0)).camera(7)
    part = flat_part(camera)
    size = np.array([part.camera.width, part.camera.height])
    assert not part.is_whole
    assert part.share == size.prod() / np.prod(SIZE)
    pixels = np.random.default_rng(0).uniform((0, 0), size, (100, 2))
    rays = np.asarray(camera.cam_ray_from_img(pixels + np.array([part.left, part.top])))
    assert np.asarray(part.camera.cam_ray_from_img(pixels)) == pytest.approx(rays, abs=1e-12)
    picture = np.arange(np.prod(SIZE)).reshape(SIZE[::-1]).astype(np.uint8)
    assert part.of(picture).shape == tuple(size[::-1])
    assert part.of(picture)[3, 5] == picture[part.top + 3, part.left + 5]


def test_what_is_left_out_is_said() -> None:
    whole, half = (flat_part(fisheye(degrees).camera(1)) for degrees in (120, 200))
    assert _cut_warnings({"a.png": whole}) == []
    (warning,) = _cut_warnings({"b.png": half, "a.png": whole, "c.png": half})
    assert "only the middle of 2 photographs" in warning
    assert f"{half.share:.0%} of the pixels" in warning
    assert warning.endswith("b.png, c.png")


def test_a_panorama_and_a_formula_that_holds_nowhere_are_refused() -> None:
    panorama = pycolmap.Camera.create_from_model_name(3, "EQUIRECTANGULAR", 1.0, 400, 200)
    for camera in (panorama, Lens("SIMPLE_RADIAL", (1, 1), (-0.3,)).camera(3)):
        with pytest.raises(
            MappingError, match=f"camera 3 of the model, {camera.model_name}.* laid flat"
        ) as caught:
            flat_part(camera)
        assert "--no-dense" in caught.value.hint
