"""The page in a real browser: it draws, its workings work, and nothing of a name runs."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from synthetic import coded, facade_surface, synthetic_contents

from colmap_ihe.report.page import render_page

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Dialog, Locator, Page

HOSTILE = '"><script>window.ran=1;alert(1)</script><img src=x onerror="window.ran=2;alert(2)">'


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("page") / "page.html")


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(tmp_path_factory.mktemp("page") / "page.html", HOSTILE)


def written(path: Path, hostile: str = "") -> str:
    path.write_text(render_page(synthetic_contents(6000, 12, hostile)), encoding="utf-8")
    return path.as_uri()


class Opened:
    """A page and what went on in it."""

    def __init__(self, browser: Browser, address: str, width: int = 1100, height: int = 800) -> None:
        self.page: Page = browser.new_page(
            viewport={"width": width, "height": height}, reduced_motion="reduce"
        )
        self.page.set_default_timeout(20_000)
        self.errors: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self.page.on("pageerror", lambda e: self.errors.append(str(e)))
        self.page.on("request", lambda r: self.requests.append(r.url))
        self.page.goto(address)

    def still(self) -> None:
        """Until the viewer has drawn all points."""
        self.page.wait_for_timeout(700)


def pixels(of: Locator) -> NDArray[np.uint8]:
    return np.asarray(Image.open(io.BytesIO(of.screenshot())).convert("RGB"))


@pytest.fixture
def page(browser: Browser, address: str) -> Iterator[Page]:
    it = Opened(browser, address)
    it.still()
    yield it.page
    assert not it.errors
    it.page.close()


def test_nothing_is_loaded_and_nothing_of_a_name_runs(browser: Browser, address: str, hostile: str) -> None:
    for where in (address, hostile):
        it = Opened(browser, where)
        it.still()
        loads = [url for url in it.requests if not url.startswith("data:")]
        assert len(loads) == 1 and loads[0].startswith("file:")
        assert not it.errors
        assert it.page.evaluate("window.ran") is None
        assert it.page.locator("script").count() == 5
        it.page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("mode", ["texture", "points"])
def test_the_model_is_drawn(page: Page, scheme: str, mode: str) -> None:
    page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
    page.locator(f"[data-mode={mode}]").check()
    page.wait_for_timeout(500)
    drawn = pixels(page.locator(".stage canvas"))
    background = drawn[200, 4]
    assert (np.abs(drawn.astype(int) - background).max(axis=2) > 20).mean() > 0.03
    assert (background > 128).all() == (scheme == "light")


def test_keys_and_choices_change_the_picture(page: Page) -> None:
    canvas = page.locator(".stage canvas")
    canvas.focus()
    seen = {"": pixels(canvas)}
    acts: dict[str, Callable[[], object]] = {
        "left": lambda: page.keyboard.press("ArrowLeft"),
        "nearer": lambda: page.keyboard.press("+"),
        "front": lambda: page.locator("[data-side=front]").click(),
        **{
            m: partial(page.locator(f"[data-mode={m}]").check)
            for m in ("clay", "normals", "height", "grey", "points")
        },
        "larger": lambda: page.locator("[data-part=size]").fill("8"),
        "home": lambda: page.locator("[data-side=home]").click(),
        "flat": lambda: page.locator("[data-part=flat]").check(),
        "top": lambda: page.locator("[data-side=top]").click(),
        "photograph": lambda: page.locator("[data-part=from]").select_option("3"),
        "faded": lambda: page.locator("[data-part=fade]").fill("0"),
    }
    for name, act in acts.items():
        act()
        page.wait_for_timeout(400)
        before, seen[name] = list(seen.values())[-1], pixels(canvas)
        assert (seen[name] != before).any(), name
    inside = {name: picture[100:280, 400:600].astype(int) for name, picture in seen.items()}
    assert np.ptp(inside["grey"], axis=2).max() == 0 and np.ptp(inside["front"], axis=2).max() > 40
    # a plane that faces the viewer has one normal: turned to +z it is (0.5, 0.5, 1)
    assert np.abs(inside["normals"] - [127, 127, 255]).max() <= 2


def test_home_comes_back(page: Page) -> None:
    canvas = page.locator(".stage canvas")
    canvas.focus()
    before = pixels(canvas)
    for key in ("ArrowLeft", "ArrowUp", "-", "Home"):
        page.keyboard.press(key)
    page.wait_for_timeout(500)
    assert (np.abs(pixels(canvas).astype(int) - before).max(axis=2) > 20).mean() < 0.002


def test_nothing_is_drawn_while_nothing_changes(page: Page) -> None:
    page.evaluate(
        "window.drawn = 0; document.querySelector('.stage canvas').addEventListener('drawn', () => { window.drawn++ })"
    )
    page.wait_for_timeout(600)
    assert page.evaluate("window.drawn") == 0


def picked(page: Page, *places: tuple[float, float]) -> None:
    """Click places of the canvas, in shares of it."""
    canvas = page.locator(".stage canvas")
    box = canvas.bounding_box()
    assert box is not None
    for x, y in places:
        canvas.click(position={"x": x * box["width"], "y": y * box["height"]})


def open_tools(page: Page) -> None:
    page.locator("[data-part=cameras]").uncheck()
    page.locator("[data-side=front]").click()
    page.wait_for_timeout(450)
    page.locator(".tools details").evaluate_all("(all) => all.forEach((one) => { one.open = true })")


def saved(page: Page) -> dict[str, Any]:
    with page.expect_download() as download:
        page.locator("[data-part=export]").click()
    content: dict[str, Any] = json.loads(Path(download.value.path()).read_text())
    return content


def test_what_is_measured_is_right_and_is_saved(page: Page) -> None:
    """The mesh is the plane z = 0 of the viewer, which is z = 30 of the model, turned half about x."""
    open_tools(page)
    page.locator("[data-tool=area]").click()
    picked(page, (0.4, 0.3), (0.6, 0.3), (0.6, 0.5), (0.4, 0.5))
    page.locator("[data-part=finish]").click()
    page.locator("[data-tool=distance]").click()
    picked(page, (0.35, 0.5), (0.6, 0.5))
    page.locator("[data-tool=point]").click()
    page.keyboard.press("Enter")  # what is at the cross, in the middle
    page.locator("[data-tool=note]").click()
    picked(page, (0.55, 0.5))
    page.locator("[data-part=notes] textarea").fill("<b>loose</b> stone")
    assert page.locator(".pin").inner_text() == "1"
    area, distance, point, note = saved(page)["items"]
    assert [item["kind"] for item in (area, distance, point, note)] == ["area", "distance", "point", "note"]
    assert note["text"] == "<b>loose</b> stone"
    places = np.array(area["points"])
    assert places[:, 2] == pytest.approx(30, abs=1e-3) and (np.abs(places[:, 0] - 10) < 6).all()
    x, y = (places[:, :2] - places[0, :2]).T
    shoelace = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    assert float(area["in_words"].split()[1]) == pytest.approx(shoelace, rel=1e-3)
    length = np.linalg.norm(np.diff(distance["points"], axis=0))
    assert distance["in_words"].startswith("Distance: ") and 1 < length < 12
    assert float(distance["in_words"].split()[1]) == pytest.approx(length, rel=1e-3)
    assert point["in_words"].startswith(f"Point: X {point['points'][0][0]:.4g}"[:11])


def test_a_known_distance_gives_the_scale_and_the_address_keeps_it(page: Page) -> None:
    from playwright.sync_api import expect  # as the browser, only where it is there

    open_tools(page)
    page.locator("[data-tool=distance]").click()
    picked(page, (0.35, 0.5), (0.6, 0.5))
    assert page.locator("[data-part=measured] li").inner_text().endswith("model units")
    units = np.linalg.norm(np.diff(saved(page)["items"][0]["points"], axis=0))
    page.locator("[data-part=known-length]").fill("2,5")
    page.locator("[data-part=known-set]").click()
    assert page.locator("[data-part=measured] li").inner_text().startswith("Distance: 2.500 m")
    assert page.locator("[data-part=known-line]").inner_text() == "A,B,2.5"
    page.locator("nav a").first.click()
    expect(page).to_have_url(re.compile("metres_per_unit="))
    page.reload()
    page.wait_for_timeout(700)
    assert "metres_per_unit=" in page.url
    assert page.locator("[data-part=measured] li").inner_text().startswith("Distance: 2.500 m")
    assert saved(page)["metres_per_unit"] == pytest.approx(2.5 / units, rel=1e-4)


def test_notes_are_there_after_a_reload_until_they_are_removed(page: Page) -> None:
    open_tools(page)
    page.locator("[data-tool=note]").click()
    picked(page, (0.55, 0.5))
    page.locator("[data-part=notes] textarea").fill("<b>loose</b> stone")
    before = saved(page)["items"]
    page.reload()
    page.locator("[data-part=notes] textarea").wait_for()
    assert saved(page)["items"] == before and before[0]["text"] == "<b>loose</b> stone"
    page.locator("[data-part=notes] button").click()
    page.reload()
    page.wait_for_timeout(500)
    assert not page.locator("[data-part=notes] textarea").count()


def test_where_the_browser_keeps_nothing_leaving_asks_first(browser: Browser, address: str) -> None:
    it = browser.new_page(viewport={"width": 1100, "height": 800}, reduced_motion="reduce")
    it.add_init_script("Storage.prototype.setItem = () => { throw new DOMException('refused') }")
    asked: list[str] = []

    def leave(dialog: Dialog) -> None:
        asked.append(dialog.type)
        dialog.accept()

    it.on("dialog", leave)
    it.goto(address)
    it.wait_for_timeout(700)
    it.reload()
    assert not asked
    open_tools(it)
    it.locator("[data-tool=note]").click()
    picked(it, (0.55, 0.5))
    it.locator("[data-part=notes] textarea").fill("loose")
    it.reload()
    assert asked == ["beforeunload"]
    it.close()


def test_a_metric_model_is_measured_in_metres(browser: Browser, tmp_path: Path) -> None:
    """No scale can be entered, and none is taken from the address: it has one."""
    made = synthetic_contents(3000, 4)
    assert made.frame is not None
    metric = dataclasses.replace(made, frame=dataclasses.replace(made.frame, metric=True))
    (tmp_path / "page.html").write_text(render_page(metric), encoding="utf-8")
    it = Opened(browser, f"{(tmp_path / 'page.html').as_uri()}#metres_per_unit=7")
    open_tools(it.page)
    it.page.locator("[data-tool=distance]").click()
    picked(it.page, (0.35, 0.5), (0.6, 0.5))
    it.page.locator("[data-tool=area]").click()
    picked(it.page, (0.4, 0.3), (0.6, 0.3), (0.6, 0.5))
    it.page.locator("[data-part=finish]").click()
    it.page.locator("[data-tool=point]").click()
    picked(it.page, (0.5, 0.5))
    distance, area, point = it.page.locator("[data-part=measured] li").all_inner_texts()
    content = saved(it.page)
    length = np.linalg.norm(np.diff(content["items"][0]["points"], axis=0))
    assert distance.startswith("Distance: ") and f"{length:.4g}"[:4] in distance and " m, height" in distance
    assert " m², around it " in area and re.fullmatch(r"Point: X .*, Y .*, Z 30(\.0+)? m", point)
    assert content["metres_per_unit"] == 1
    assert not it.page.locator("[data-part=known]").is_visible()
    assert "Lengths are in metres." in it.page.locator("section.wide").inner_text()
    assert not it.errors
    it.page.close()


def test_the_section_box_cuts_the_model_and_what_is_picked(page: Page) -> None:
    canvas = page.locator(".stage canvas")
    open_tools(page)
    before = pixels(canvas).astype(int)

    def changed() -> NDArray[np.bool_]:
        page.wait_for_timeout(500)
        return np.asarray(np.abs(pixels(canvas).astype(int) - before).max(axis=2) > 25)[60:350]

    page.locator("[data-part=cut-right]").fill("500")
    cut = changed()
    middle = cut.shape[1] // 2
    assert cut[:, middle + 20 :].mean() > 0.25 > 0.05 > cut[:, : middle - 20].mean()
    page.locator("[data-part=section-reset]").click()
    assert changed().mean() < 0.01
    page.locator("[data-part=cut-right]").fill("500")
    page.locator("[data-tool=point]").click()
    picked(page, (0.7, 0.4))
    assert page.locator("[data-part=reading]").inner_text().startswith("Nothing there")
    picked(page, (0.4, 0.4))
    assert page.locator("[data-part=reading]").inner_text().startswith("Point: ")


def test_a_click_on_a_camera_flies_there(page: Page) -> None:
    """In the front view photographs stand below the facade; the mesh does not hide them."""
    page.locator("[data-side=front]").click()
    page.wait_for_timeout(450)
    picked(page, (0.45, 0.7))
    assert page.locator("[data-part=from]").input_value()
    assert page.locator("[data-part=fade-field]").is_visible()
    page.wait_for_timeout(450)
    page.keyboard.press("ArrowLeft")
    assert not page.locator("[data-part=from]").input_value()
    assert not page.locator("[data-part=fade-field]").is_visible()


def test_a_picture_is_saved_and_the_screen_is_filled(page: Page) -> None:
    with page.expect_download() as download:
        page.locator("[data-part=picture]").click()
    picture = np.asarray(Image.open(download.value.path()).convert("RGB"))
    assert picture.shape[0] > 300 and picture.std() > 20
    page.locator("[data-part=screen]").click()
    page.wait_for_timeout(600)
    box = page.locator(".stage canvas").bounding_box()
    assert (
        box is not None and box["width"] > 1000 and page.evaluate("document.fullscreenElement.id") == "viewer"
    )
    assert page.locator("[data-part=screen]").get_attribute("aria-pressed") == "true"


def test_without_a_mesh_points_are_drawn(browser: Browser, tmp_path: Path) -> None:
    contents = dataclasses.replace(synthetic_contents(6000, 4), surface=None)
    (tmp_path / "page.html").write_text(render_page(contents), encoding="utf-8")
    it = Opened(browser, (tmp_path / "page.html").as_uri())
    it.still()
    assert it.page.locator("[data-mode]").count() == 3
    drawn = pixels(it.page.locator(".stage canvas")).astype(int)
    assert (np.abs(drawn - drawn[200, 4]).max(axis=2) > 60).mean() > 0.1
    open_tools(it.page)
    it.page.locator("[data-tool=point]").click()
    picked(it.page, (0.5, 0.5))
    assert it.page.locator("[data-part=reading]").inner_text().startswith("Point: ")
    assert not it.errors
    it.page.close()


def test_vertex_colours_are_drawn_as_they_are(browser: Browser, tmp_path: Path) -> None:
    surface = facade_surface()
    colours = np.full(surface.positions.shape, (200, 60, 20), np.uint8)
    coloured = dataclasses.replace(surface, texture=None, uv=None, colours=colours)
    contents = dataclasses.replace(synthetic_contents(6000, 4), surface=coloured)
    (tmp_path / "page.html").write_text(render_page(contents), encoding="utf-8")
    it = Opened(browser, (tmp_path / "page.html").as_uri())
    it.page.locator("[data-side=front]").click()
    it.page.wait_for_timeout(500)
    drawn = pixels(it.page.locator(".stage canvas")).astype(int)[250:350, 400:600]
    assert np.abs(drawn - [200, 60, 20]).max() <= 3
    it.page.locator(".stage canvas").focus()
    for _ in range(8):
        it.page.keyboard.press("ArrowLeft")  # 37 degrees aside: no light is put on what is photographed
    it.page.wait_for_timeout(500)
    drawn = pixels(it.page.locator(".stage canvas")).astype(int)[250:350, 500:600]
    assert np.abs(drawn - [200, 60, 20]).max() <= 1
    assert not it.errors
    it.page.close()


def test_the_mesh_looks_like_the_photograph_from_its_camera(page: Page) -> None:
    """Mean difference of colour, where the mesh is; half a percent of the picture aside more than doubles it."""
    canvas = page.locator(".stage canvas")
    page.locator("[data-part=from]").select_option("3")
    page.locator("[data-part=fade]").fill("1")
    page.wait_for_timeout(500)
    photograph = pixels(canvas).astype(int)[60:-80]
    page.locator("[data-part=fade]").fill("0")
    page.wait_for_timeout(500)
    mesh = pixels(canvas).astype(int)[60:-80]
    page.locator("[data-mode=clay]").check()
    page.wait_for_timeout(500)
    covered = np.abs(pixels(canvas).astype(int)[60:-80] - mesh).max(axis=2) > 8
    covered &= np.abs(photograph - mesh).max(axis=2) > 0
    assert covered.mean() > 0.25
    assert np.abs(photograph - mesh)[covered].mean() < 6


def test_the_model_takes_the_exposure_of_the_photograph_that_is_looked_from(
    browser: Browser, tmp_path: Path
) -> None:
    """The photograph is half as bright, and flare lies on its red; a third of it shows something else."""
    contents = synthetic_contents(6000, 4)
    camera = contents.cameras[1]
    assert camera.picture is not None
    shown = np.asarray(Image.open(io.BytesIO(camera.picture.jpeg))).astype(float)
    dark = np.clip(0.5 * shown + [60, 0, 0], 0, 255).astype(np.uint8)
    dark[:, :150] = 255
    cameras = [dataclasses.replace(camera, picture=coded(dark, "a photograph"))]
    contents = dataclasses.replace(contents, cameras=cameras)
    (tmp_path / "page.html").write_text(render_page(contents), encoding="utf-8")
    it = Opened(browser, (tmp_path / "page.html").as_uri())
    it.page.locator("[data-part=cameras]").uncheck()
    canvas, middle = it.page.locator(".stage canvas"), np.s_[200:300, 500:650]
    drawn = {}
    it.page.locator("[data-part=from]").select_option("0")
    it.page.locator("[data-part=alike]").wait_for()
    for name, fade, alike in (("photograph", "1", True), ("alike", "0", True), ("model", "0", False)):
        it.page.locator("[data-part=fade]").fill(fade)
        it.page.locator("[data-part=alike]").set_checked(alike)
        it.still()
        drawn[name] = pixels(canvas).astype(float)[middle]
    medians = {name: np.median(picture, axis=(0, 1)) for name, picture in drawn.items()}
    assert medians["photograph"] == pytest.approx(0.5 * medians["model"] + [60, 0, 0], abs=6)
    assert medians["alike"] == pytest.approx(medians["photograph"], abs=6)
    it.page.locator("[data-part=alike]").check()
    it.page.locator("[data-side=front]").click()
    it.still()
    assert not it.page.locator("[data-part=alike]").is_visible()
    assert np.median(pixels(canvas)[middle], axis=(0, 1)) == pytest.approx(medians["model"], abs=12)
    assert not it.errors
    it.page.close()


def test_the_first_view_leaves_out_what_stands_far_behind(browser: Browser, tmp_path: Path) -> None:
    """Four percent of the points stand ten times as far, on one side; the facade fills the picture all the same."""
    spans = []
    for far in (0, 240):
        contents = synthetic_contents(6000, 4)
        assert contents.cloud is not None
        positions = contents.cloud.positions.copy()
        positions[:far] += np.array([90, 40, -60], np.float32)
        cloud = dataclasses.replace(contents.cloud, positions=positions)
        contents = dataclasses.replace(contents, cloud=cloud)
        (tmp_path / "page.html").write_text(render_page(contents), encoding="utf-8")
        it = Opened(browser, (tmp_path / "page.html").as_uri())
        it.page.locator("[data-part=cameras]").uncheck()
        it.page.locator("[data-mode=clay]").check()
        it.still()
        drawn = pixels(it.page.locator(".stage canvas")).astype(int)[280:300]
        columns = np.flatnonzero((np.ptp(drawn, axis=2) > 14).any(axis=0))
        spans.append([columns[0], columns[-1]])
        it.page.close()
    assert spans[1] == pytest.approx(spans[0], abs=12) and np.ptp(spans[0]) > 400


def test_before_and_after_by_keys_and_by_pointer(page: Page) -> None:
    group = page.locator("[data-compare]").first
    slider, shown = group.locator("input"), group.locator(".compare")
    slider.focus()
    before = pixels(shown)
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    assert slider.input_value() == "70"
    assert (pixels(shown) != before).mean() > 0.02
    box = shown.bounding_box()
    assert box is not None
    slider.click(position={"x": 0.2 * box["width"], "y": 0.5 * box["height"]})
    assert abs(int(slider.input_value()) - 20) <= 1


def test_methods_are_copied(page: Page) -> None:
    button = page.locator("[data-copies=methods]")
    button.click()
    page.wait_for_timeout(300)
    assert button.inner_text() == "Copied"


def test_one_photograph_at_a_time(page: Page) -> None:
    page.locator("#choose-sliders").select_option(index=2)
    assert [page.locator("[data-compare]").nth(i).is_visible() for i in range(3)] == [False, False, True]


def test_phone_has_nothing_beside_the_screen(browser: Browser, address: str, hostile: str) -> None:
    for where in (address, hostile):
        it = Opened(browser, where, 360, 740)
        it.page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true })")
        assert it.page.evaluate("document.documentElement.scrollWidth") <= 360
        it.page.close()


def test_paper_shows_what_is_folded(page: Page) -> None:
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.locator("details:not([open])").count() == 0
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.locator("details[open]").count() == 0
    assert page.pdf().startswith(b"%PDF")


def test_paper_is_filled_and_shows_the_charts(page: Page) -> None:
    pdfium = pytest.importorskip("pypdfium2", reason="pypdfium2 is not installed")
    with closing(pdfium.PdfDocument(page.pdf(format="A4", prefer_css_page_size=True))) as document:
        sheets = [sheet.render(scale=0.5).to_numpy()[..., :3] for sheet in document]
    assert 5 < len(sheets) < 20
    edge = 16 / 297  # the margin of @page
    for sheet in sheets[:-1]:
        last = np.flatnonzero((sheet < 200).any(axis=(1, 2))).max() / len(sheet)
        assert (last - edge) / (1 - 2 * edge) > 0.5
    page.emulate_media(media="print")
    assert page.locator(".chart rect.bar:visible").count() > 10
    page.emulate_media(media="screen")


def test_paper_shows_every_photograph_and_pair(page: Page) -> None:
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.locator("[data-of]").count() == page.locator("[data-of]:visible").count() > 3
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.locator("[data-of]:visible").count() == page.locator("select[data-shows]").count()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_stands_in_the_way_of_anyone(page: Page, scheme: str) -> None:
    """The rules of WCAG that axe can check, contrast of colours among them."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
    page.evaluate("document.querySelectorAll('details').forEach((d) => { d.open = true })")
    for width in (390, 1024, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        found = axe.Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
        assert len(found.response["passes"]) > 20


def test_fingers_turn_and_pinch(browser: Browser, address: str) -> None:
    context = browser.new_context(
        viewport={"width": 360, "height": 740}, has_touch=True, is_mobile=True, reduced_motion="reduce"
    )
    page = context.new_page()
    page.goto(address)
    page.wait_for_timeout(700)
    canvas = page.locator(".stage canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    fingers = context.new_cdp_session(page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        places = [{"x": x + dx, "y": y + dy, "id": i} for i, (dx, dy) in enumerate(points)]
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

    seen = [pixels(canvas)]
    for begin, end in (([(0, 0)], [(70, 10)]), ([(-20, 0), (20, 0)], [(-90, 0), (90, 0)])):
        touch("touchStart", *begin)
        for step in (0.3, 0.6, 1.0):
            ways = zip(begin, end, strict=True)
            touch("touchMove", *((a + step * (c - a), b + step * (d - b)) for (a, b), (c, d) in ways))
        touch("touchEnd")
        page.wait_for_timeout(500)
        seen.append(pixels(canvas))
        assert (np.abs(seen[-1].astype(int) - seen[-2]).max(axis=2) > 20).mean() > 0.01
    page.locator("[data-mode=clay]").tap()
    page.locator(".tools summary").first.tap()
    page.locator("[data-tool=point]").tap()
    page.locator("[data-part=cameras]").tap()
    page.locator("[data-side=front]").tap()
    page.wait_for_timeout(450)
    canvas.tap(position={"x": box["width"] / 2, "y": 0.45 * box["height"]})
    assert page.locator("[data-part=measured] li").inner_text().startswith("Point: ")
    context.close()


def test_without_webgl_a_sentence_stands_there(browser: Browser, address: str) -> None:
    it = Opened(browser, "about:blank")
    it.page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    it.page.goto(address)
    assert "WebGL is missing" in it.page.locator("#no-viewer").inner_text()
    assert not it.page.locator(".stage canvas").is_visible()
    assert not it.errors
    it.page.close()
