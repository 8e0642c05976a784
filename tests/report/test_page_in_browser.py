"""The page in a real browser: it draws, its workings work, and nothing of a name runs."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from synthetic import synthetic_contents

from colmap_ihe.report.page import render_page

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

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
        self.page: Page = browser.new_page(viewport={"width": width, "height": height})
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
        assert it.page.locator("script").count() == 3
        it.page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_cloud_is_drawn(page: Page, scheme: str) -> None:
    page.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
    drawn = pixels(page.locator("canvas"))
    background = drawn[4, 4]
    assert (np.abs(drawn.astype(int) - background).max(axis=2) > 20).mean() > 0.03
    assert (background > 128).all() == (scheme == "light")


def test_keys_and_choices_change_the_picture(page: Page) -> None:
    canvas = page.locator("canvas")
    canvas.focus()
    seen = [pixels(canvas)]
    for act in (
        lambda: page.keyboard.press("ArrowLeft"),
        lambda: page.keyboard.press("+"),
        lambda: page.locator("[data-part=mode]").select_option("grey"),
        lambda: page.locator("[data-part=mode]").select_option("height"),
        lambda: page.locator("[data-part=cameras]").uncheck(),
        lambda: page.locator("[data-part=size]").fill("8"),
        lambda: page.locator("[data-part=from]").select_option("3"),
    ):
        act()
        page.wait_for_timeout(400)
        seen.append(pixels(canvas))
        assert (seen[-1] != seen[-2]).any()
    grey = seen[3].astype(int)[50:-50, 50:-50]
    assert np.ptp(grey[grey.min(axis=2) < 150], axis=1).mean() < np.ptp(seen[2].astype(int), axis=2).max() / 2


def test_home_comes_back(page: Page) -> None:
    canvas = page.locator("canvas")
    canvas.focus()
    before = pixels(canvas)
    for key in ("ArrowLeft", "ArrowUp", "-", "Home"):
        page.keyboard.press(key)
    page.wait_for_timeout(500)
    assert (np.abs(pixels(canvas).astype(int) - before).max(axis=2) > 20).mean() < 0.002


def test_nothing_is_drawn_while_nothing_changes(page: Page) -> None:
    page.evaluate(
        "window.drawn = 0; document.querySelector('canvas').addEventListener('drawn', () => { window.drawn++ })"
    )
    page.wait_for_timeout(600)
    assert page.evaluate("window.drawn") == 0


def test_a_distance_is_read(page: Page) -> None:
    page.locator("[data-part=measure]").click()
    canvas = page.locator("canvas")
    drawn = pixels(canvas).astype(int)
    rows, columns = np.nonzero(np.abs(drawn - drawn[4, 4]).max(axis=2) > 60)
    for which in (len(rows) // 4, 3 * len(rows) // 4):
        canvas.click(position={"x": float(columns[which]), "y": float(rows[which])})
    reading = page.locator("[data-part=reading]").inner_text()
    assert reading.startswith("Distance: ") and reading.endswith(" model units")
    assert 0 < float(reading.split()[1]) < 20


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
    found = axe.Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
    assert len(found.response["passes"]) > 20


def test_fingers_turn_and_pinch(browser: Browser, address: str) -> None:
    context = browser.new_context(viewport={"width": 360, "height": 740}, has_touch=True, is_mobile=True)
    page = context.new_page()
    page.goto(address)
    page.wait_for_timeout(700)
    canvas = page.locator("canvas")
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
    context.close()


def test_without_webgl_a_sentence_stands_there(browser: Browser, address: str) -> None:
    it = Opened(browser, "about:blank")
    it.page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    it.page.goto(address)
    assert "WebGL is missing" in it.page.locator("#no-viewer").inner_text()
    assert not it.page.locator("canvas").is_visible()
    assert not it.errors
    it.page.close()
