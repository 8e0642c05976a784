"""Every control of the viewer does something, by mouse, by touch and by keyboard."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from browser import chromium
from synthetic import synthetic_contents

from colmap_ihe.report.page import render_page

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

pytestmark = pytest.mark.skipif(chromium() is None, reason="no Chromium is installed")

MODES = ["texture", "clay", "normals", "height", "points", "grey"]
CONTROLS = "#viewer :is(button, input, select, textarea, summary, canvas)"
STATE = """(one) => {
  const canvas = document.querySelector(".stage canvas"), gl = canvas.getContext("webgl2");
  const read = new Uint8Array(4 * canvas.width * canvas.height);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, read);
  let sum = canvas.width;
  for (let i = 0; i < read.length; i += 97) sum = (31 * sum + read[i]) | 0;
  const all = [...document.querySelectorAll("#viewer *")];
  const shown = document.querySelector("[data-part=control-picture]");
  return [sum, one.checked, one.value, one.ariaPressed, all.filter((e) => e.open || e.hidden).length,
    document.querySelector("#viewer").innerText, location.hash, document.fullscreenElement?.id,
    shown.width > 300 ? shown.toDataURL().length : 0].join();
}"""


UNFOLDED = "document.querySelectorAll('#viewer details').forEach((d) => { d.open = true })"


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("controls") / "page.html"
    path.write_text(render_page(synthetic_contents(3000, 4)), encoding="utf-8")
    return path.as_uri()


def prepared(browser: Browser, address: str, touch: bool) -> tuple[Page, list[str]]:
    """The page with all of it unfolded, a distance measured, two notes set, and the list of its errors."""
    page = browser.new_page(
        viewport={"width": 720, "height": 480},
        reduced_motion="reduce",
        has_touch=touch,
        accept_downloads=True,
    )
    page.set_default_timeout(10_000)
    errors: list[str] = []
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(address)
    page.locator(".stage canvas").wait_for()
    page.evaluate(UNFOLDED)
    page.locator("[data-part=cameras]").uncheck()
    for tool, places in (("distance", (0.35, 0.6)), ("note", (0.5,)), ("note", (0.4,))):
        page.locator(f"[data-tool={tool}]").click()
        for x in places:
            page.locator(".stage canvas").click(position={"x": x * 680, "y": 190})
    page.locator("[data-part=control-name]").fill("N1")
    page.locator("[data-part=control-photograph]").select_option("0")
    page.locator("[data-part=control-set]").click()
    page.wait_for_timeout(300)
    return page, errors


def used(page: Page, control: Locator, kind: str) -> None:
    """Use a control as a person does who has only a mouse, only fingers or only keys."""
    tag, type_ = control.evaluate("(one) => [one.tagName, one.type]")
    if tag == "SELECT":
        if kind != "keyboard":  # the list that unfolds is the browser's own
            control.select_option(index=control.evaluate("(one) => (one.selectedIndex + 1) % one.length"))
            return
        control.focus()
        page.keyboard.press("ArrowDown")
    elif type_ in ("text", "number", "textarea"):
        (control.focus if kind == "keyboard" else control.tap if kind == "touch" else control.click)()
        page.keyboard.press("Control+a")
        page.keyboard.type("2.5")
        page.keyboard.press("Tab")
    elif type_ == "range":
        high = control.evaluate("(one) => one.value - one.min > (one.max - one.min) / 2")
        if kind == "keyboard":
            control.focus()
            for _ in range(3):
                page.keyboard.press("PageDown" if high else "PageUp")
            return
        box = control.bounding_box()
        assert box is not None
        x, y = box["width"] * (0.3 if high else 0.7), box["height"] / 2
        (control.tap if kind == "touch" else control.click)(position={"x": x, "y": y})
    elif kind == "keyboard":
        control.focus()
        page.keyboard.press("ArrowLeft" if tag == "CANVAS" else "Space" if tag == "INPUT" else "Enter")
    elif tag == "CANVAS" and kind == "mouse":
        control.scroll_into_view_if_needed()
        box = control.bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 300, box["y"] + 200)
        page.mouse.down()
        page.mouse.move(box["x"] + 360, box["y"] + 220, steps=4)
        page.mouse.up()
    else:
        (control.tap if kind == "touch" else control.click)()


def does_something(page: Page, control: Locator, kind: str) -> bool:
    before = control.evaluate(STATE)
    used(page, control, kind)
    for _ in range(60):
        if not control.count() or control.evaluate(STATE) != before:  # what removes itself did something
            return True
        page.wait_for_timeout(25)
    return False


IN_MODE = """(mode) => new Promise((done) => {
  const canvas = document.querySelector(".stage canvas");
  const look = document.querySelector(`[data-mode=${mode}]`);
  if (look.checked) document.querySelector(`[data-mode=${mode === "clay" ? "grey" : "clay"}]`).click();
  const drawn = ({ detail }) => {
    if (!detail.whole) return;
    canvas.removeEventListener("drawn", drawn);
    done();
  };
  canvas.addEventListener("drawn", drawn);
  look.click();
})"""
NEXT = """(controls) => {
  const all = [...document.querySelectorAll(controls)];
  document.querySelector("[data-part=size-field]").hidden = false; // shown with points only
  const one = all.find((e) => !e.dataset.tried && e.checkVisibility());
  if (!one) return null;
  one.dataset.tried = "now";
  const { mode, side, tool, part, copies } = one.dataset;
  return mode || side || tool || part || copies || one.ariaLabel || one.textContent;
}"""


def each_tried(page: Page, kind: str, first: int) -> tuple[list[str], list[str]]:
    """Try every control once, in the looks in turn from the `first`; return which, and which did nothing."""
    tried: list[str] = []
    idle: list[str] = []
    while (name := page.evaluate(NEXT, CONTROLS)) is not None:
        mode = MODES[(len(tried) + first) % len(MODES)]
        another = "clay" if mode == "grey" else "grey"  # what is chosen already does nothing
        mode = "points" if name == "size" else another if name == mode else mode
        page.evaluate(IN_MODE, mode)
        control = page.locator("[data-tried=now]")
        if kind == "touch" and name.endswith("in three dimensions"):  # fingers turn it in another test
            page.evaluate("document.querySelector('[data-tool=point]').click()")
        if name in ("picture", "export"):
            with page.expect_download():
                used(page, control, kind)
        elif not does_something(page, control, kind):
            idle.append(f"{name} in {mode}")
        if control.count():
            control.evaluate("(one) => { one.dataset.tried = 'done' }")
        if page.evaluate("Boolean(document.fullscreenElement)"):
            page.evaluate("document.exitFullscreen()")
        page.evaluate(UNFOLDED)
        tried.append(name)
    return tried, idle


@pytest.mark.parametrize("first", [0, *(pytest.param(n, marks=pytest.mark.slow) for n in range(1, 6))])
@pytest.mark.parametrize("kind", ["mouse", "touch", "keyboard"])
def test_every_control_does_something(browser: Browser, address: str, kind: str, first: int) -> None:
    page, errors = prepared(browser, address, kind == "touch")
    tried, idle = each_tried(page, kind, first)
    assert not idle and not errors
    untried = page.locator(f"{CONTROLS}:not([data-tried])").evaluate_all(
        "(all) => all.map((e) => e.outerHTML)"
    )
    assert not untried and len(tried) > 50
    page.close()
