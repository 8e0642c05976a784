"""Control points are clicked on the page: what it expects is what COLMAP's lens shows."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from browser import chromium
from numpy.typing import NDArray
from synthetic import coded, facade_cloud, facade_picture

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.pipeline.model_view import ModelView
from colmap_ihe.report.contents import CameraPose, Contents
from colmap_ihe.report.page import render_page
from colmap_ihe.survey.control_files import read_control

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed")

LENSES = {
    "OPENCV": [900.0, 905, 640, 480, -0.21, 0.07, 0.002, -0.001],
    "SIMPLE_RADIAL": [900.0, 640, 480, 0.11],
    "OPENCV_FISHEYE": [520.0, 520, 640, 480, 0.01, -0.004, 0.0, 0.0],
}
PLACE = np.array([0.2, -0.1, 4.0])
SLOW_DECODING = """(() => {
  const { decode } = HTMLImageElement.prototype;
  HTMLImageElement.prototype.decode = async function () {
    await decode.call(this);
    await new Promise((done) => setTimeout(done, 100));
  };
})()"""  # as on a machine under load: what is typed meanwhile must not be written over
EYES = [(-0.8, 0, 0), (-0.3, 0.2, 0.1), (0.3, 0, 0), (0.9, -0.2, 0.3)]


@pytest.fixture
def model(request: pytest.FixtureRequest) -> pycolmap.Reconstruction:
    """Four cameras side by side, turned a little, of one lens."""
    made = pycolmap.Reconstruction()
    lens = getattr(request, "param", "OPENCV")
    made.add_camera_with_trivial_rig(
        pycolmap.Camera(model=lens, width=1280, height=960, params=LENSES[lens], camera_id=1)
    )
    for number, eye in enumerate(EYES, start=1):
        turn = pycolmap.Rotation3d(np.array([0.1 * number - 0.2, 0.15 * eye[0], 0.02]))
        pose = pycolmap.Rigid3d(turn, turn * -np.array(eye))
        made.add_image_with_trivial_frame(
            pycolmap.Image(name=f"{number}.png", camera_id=1, image_id=number), pose
        )
    for point in np.random.default_rng(0).uniform([-2, -1, 3], [2, 1, 5], (50, 3)):
        made.add_point3D(point, pycolmap.Track(), np.zeros(3, np.uint8))
    return made


def seen(model: pycolmap.Reconstruction) -> NDArray[np.float64]:
    """(4, 2): the pixels at which COLMAP has the place."""
    camera = model.cameras[1]
    poses = [model.images[n].cam_from_world() for n in range(1, 5)]
    return np.concatenate([np.asarray(camera.img_from_cam((pose * PLACE)[None])) for pose in poses])


@pytest.fixture
def page(browser: Browser, model: pycolmap.Reconstruction, tmp_path: Path) -> Iterator[Page]:
    model.write(tmp_path)
    views = [ModelView(tmp_path).camera(f"{n}.png") for n in range(1, 5)]
    small = coded(facade_picture(320, 240), "a photograph")
    names = ["1.png", 'a,"b.png', "3.png", "4.png"]
    cameras = [
        CameraPose(name, v.centre, v.corners, v.box, v.grid, small, v.size)
        for name, v in zip(names, views, strict=True)
    ]
    contents = Contents(
        "Wall", "", [], None, [], cloud=facade_cloud(500), cameras=cameras, point_names=["N1", "<b>"]
    )
    (tmp_path / "page.html").write_text(render_page(contents), encoding="utf-8")
    it = browser.new_page(viewport={"width": 1000, "height": 900})
    it.add_init_script(SLOW_DECODING)
    it.goto((tmp_path / "page.html").as_uri())
    it.locator(".control summary").click()
    it.locator("[data-part=control-name]").fill("N1")
    yield it
    it.close()


def looked_at(page: Page, number: int) -> str:
    """Show a photograph; what is said of the point there."""
    page.locator("[data-part=control-said]").evaluate("(said) => { said.textContent = '' }")
    page.locator("[data-part=control-photograph]").select_option(str(number))
    said = page.locator("[data-part=control-said]")
    while not said.inner_text():  # the policy of the page lets no function wait in it
        page.wait_for_timeout(20)
    return said.inner_text()


def set_at(page: Page, number: int, pixel: NDArray[np.float64]) -> None:
    looked_at(page, number)
    for axis, value in zip("xy", pixel, strict=True):
        page.locator(f"[data-part=control-{axis}]").fill(f"{value:.6f}")
        page.locator(f"[data-part=control-{axis}]").press("Tab")
    page.locator("[data-part=control-set]").press("Enter")


def expected_at(said: str) -> list[float]:
    found = re.search(r"at (\d+\.\d), (\d+\.\d)", said)
    assert found is not None, said
    return [float(value) for value in found.groups()]


@pytest.mark.parametrize("model", LENSES, indirect=True)
def test_the_expected_place_is_that_of_the_lens(page: Page, model: pycolmap.Reconstruction) -> None:
    pixels = seen(model)
    assert ((pixels > 0) & (pixels < (1280, 960))).all()
    assert looked_at(page, 0).startswith("Click where it is. A pixel of this picture is 4.0 of")
    set_at(page, 0, pixels[0])
    assert looked_at(page, 1).startswith("It is on the line.")
    set_at(page, 3, pixels[3])
    for number in (1, 2):
        assert expected_at(looked_at(page, number)) == pytest.approx(list(pixels[number]), abs=0.11)
    set_at(page, 1, pixels[1] + (3, 4))
    assert re.search(r"Set at .*, (4\.9|5\.0|5\.1) px from", looked_at(page, 1))


def test_what_is_typed_stays_while_the_name_is_taken(page: Page) -> None:
    looked_at(page, 0)
    page.locator("[data-part=control-name]").fill("N2")
    page.locator("[data-part=control-x]").fill("700.5")  # leaves the field of the name
    page.locator("[data-part=control-x]").press("Tab")
    page.wait_for_timeout(200)  # longer than a picture takes to be decoded
    assert page.locator("[data-part=control-x]").input_value() == "700.5"


def test_lines_are_read_as_they_were_clicked(page: Page, tmp_path: Path) -> None:
    """A click in a picture that is magnified, and keys."""
    looked_at(page, 1)
    canvas = page.locator("[data-part=control-picture]")
    box = canvas.bounding_box()
    assert box is not None
    page.locator("[data-part=control-magnify]").fill("16")
    canvas.click(position={"x": box["width"] / 4, "y": box["height"] / 2})
    middle = 640 - 1280 / 16 / 4, 480.0  # a sixteenth of the picture is seen, its middle in the middle
    looked_at(page, 0)
    canvas.focus()
    for key in ("ArrowRight", "Shift+ArrowUp", "Enter"):
        page.keyboard.press(key)  # 4 / 16 of a pixel of the photograph, and twenty times that
    (tmp_path / "observations.csv").write_text(
        "image,name,x_px,y_px\n" + page.locator("#control-lines").inner_text(), encoding="utf-8"
    )
    first, second = read_control(tmp_path).sights
    assert (first.image, first.name, second.image, second.name) == ('a,"b.png', "N1", "1.png", "N1")
    assert (first.x_px, first.y_px) == pytest.approx(middle, abs=0.1)
    assert (second.x_px, second.y_px) == pytest.approx((640.25, 475), abs=0.01)
    looked_at(page, 0)
    page.locator("[data-part=control-remove]").click()
    assert page.locator("#control-lines").inner_text().count("\n") == 0


def test_what_was_clicked_is_there_after_a_reload(page: Page) -> None:
    set_at(page, 2, np.array([700.5, 400.25]))
    lines = page.locator("#control-lines")
    assert lines.inner_text() == "3.png,N1,700.50,400.25"
    assert "keeps them" in page.locator("[data-part=control-kept]").inner_text()
    page.reload()
    page.locator("[data-part=control-remove]").wait_for(state="attached")
    page.locator("#control-lines").wait_for()
    assert lines.inner_text() == "3.png,N1,700.50,400.25"
    page.locator("[data-part=control-name]").fill("N1")
    assert looked_at(page, 2).startswith("Set at 700.5, 400.3")
    page.locator("[data-part=control-remove]").click()
    page.reload()
    page.wait_for_timeout(500)
    assert not page.locator("[data-part=control-done]").is_visible()


def test_a_point_needs_a_name_and_names_are_offered(page: Page) -> None:
    assert page.locator("#control-names option").evaluate_all("(all) => all.map((o) => o.value)") == [
        "N1",
        "<b>",
    ]
    page.locator("[data-part=control-name]").fill(" ")
    looked_at(page, 0)
    page.locator("[data-part=control-set]").click()
    assert page.locator("[data-part=control-said]").inner_text() == "Give the point its name first."
    assert not page.locator("[data-part=control-done]").is_visible()
    page.locator("[data-part=control-next]").click()
    assert (
        page.locator("[data-part=control-said]").inner_text().startswith("Pick the point on the model first")
    )
