"""Measure the size of a page, the time until its model is drawn, the frames a second as it turns, and how much it looks
like its photographs, in a Chromium that draws in software.

    python benchmarks/page.py [--points 200000] [--page church/report/index.html]

Frames are counted while a key turns the model at every frame for five seconds; each is read back, so that it is counted
when it is drawn and not when it was asked for. The difference of colour is the mean, over the pixels that the mesh
covers, between a photograph laid over the model and the model, in levels of 255: in the exposure of the texture, in
that of the photograph as the page shows it, and after the gain and offset for each channel that least squares find.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/scenes"))

from browser import headless
from synthetic import synthetic_contents

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.report.page import render_page

if TYPE_CHECKING:
    from playwright.sync_api import Page

Rows = list[tuple[str, str]]

_TURN = """(seconds) => new Promise((done) => {
  const canvas = document.querySelector(".stage canvas");
  const gl = canvas.getContext("webgl2");
  const drawn = [];
  const pixel = new Uint8Array(4);
  canvas.addEventListener("drawn", (e) => {
    drawn.push(e.detail);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  });
  const start = performance.now();
  const step = () => {
    canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
    if (performance.now() - start < 1000 * seconds) requestAnimationFrame(step);
    else done([drawn.length / (performance.now() - start) * 1000, drawn.at(-1).points, drawn.at(-1).faces]);
  };
  step();
})"""
_LOADED = "() => performance.getEntriesByType('navigation')[0].loadEventEnd"
_WATCH = """addEventListener('drawn', (e) => {
  const gl = e.target.getContext("webgl2");
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
  window.first ??= performance.now();
  if (e.detail.whole) window.whole ??= performance.now();
}, true)"""
_FADED = """(opacity) => new Promise((done) => {
  const fade = document.querySelector("[data-part=fade]");
  addEventListener("drawn", function drawn({ detail }) {
    if (!detail.whole) return;
    removeEventListener("drawn", drawn, true);
    done();
  }, true);
  fade.value = opacity;
  fade.dispatchEvent(new Event("input"));
})"""
_BARS = 60  # pixels at the top and at the bottom of the canvas, where buttons stand


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=200_000, help="of a made-up facade (default 200,000)")
    parser.add_argument("--page", type=Path, help="measure this page instead")
    parser.add_argument("--seconds", type=float, default=5.0, help="of turning (default 5)")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path, rows = given.page, []
        if path is None:
            path = Path(folder) / "page.html"
            rows = _made_up(path, given.points)
        print_table("page", rows + _measured(path.resolve(), given.seconds))


def _made_up(path: Path, points: int) -> Rows:
    # a tenth of the points of the made-up facade stand in the sky and are dropped
    contents = synthetic_contents(round(points / 0.88))
    began = time.perf_counter()
    path.write_text(render_page(contents), encoding="utf-8")
    return [("rendered in", f"{time.perf_counter() - began:.2f} s")]


def _measured(path: Path, seconds: float) -> Rows:
    with headless() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
        page.add_init_script(_WATCH)
        page.goto(path.as_uri())
        while not page.evaluate("window.whole"):
            page.wait_for_timeout(50)
        rows = [
            ("page", f"{path.stat().st_size / 1e6:.1f} MB"),
            ("loaded after", f"{page.evaluate(_LOADED) / 1000:.2f} s"),
            ("first picture after", f"{page.evaluate('window.first') / 1000:.2f} s"),
            ("all of it drawn after", f"{page.evaluate('window.whole') / 1000:.2f} s"),
        ]
        for mode in ("texture", "points"):
            if page.locator(f"[data-mode={mode}]").count():
                page.locator(f"[data-mode={mode}]").check()
                page.wait_for_timeout(1000)
                frames, points, faces = page.evaluate(_TURN, seconds)
                drawn = f"{faces:,.0f} triangles" if faces else f"{points:,} points"
                rows.append((f"turning, {mode}", f"{frames:.0f} frames/s of {drawn}"))
        return rows + (_likeness(page) if page.locator("[data-mode=texture]").count() else [])


def _likeness(page: Page) -> Rows:
    rows = []
    for view in range(page.locator("[data-part=from] option").count() - 1):
        page.locator("[data-mode=texture]").check()
        page.locator("[data-part=from]").select_option(str(view))
        page.locator("[data-part=alike]").wait_for()  # once the photograph lies over the model
        photograph = _seen(page, "1")
        alike = _seen(page, "0")
        page.locator("[data-part=alike]").uncheck()
        mesh = _seen(page, "0")
        page.locator("[data-part=alike]").check()
        page.locator("[data-mode=clay]").check()
        covered = np.abs(_seen(page, "0") - mesh).max(axis=2) > 8
        covered &= np.abs(photograph - mesh).max(axis=2) > 0
        one, other = photograph[covered], mesh[covered]
        away = [np.abs(one - colours).mean() for colours in (other, alike[covered], _fitted(other, one))]
        words = "{:.1f} levels, {:.1f} in its exposure, {:.1f} by least squares".format(*away)
        rows.append((f"difference from photograph {view + 1}", words))
    return rows


def _fitted(colours: NDArray[np.int64], goal: NDArray[np.int64]) -> NDArray[np.float64]:
    """(N, 3): colours (N, 3), with a gain and an offset for each channel, as near to `goal` as they come."""
    channels = []
    for own, other in zip(colours.T, goal.T, strict=True):
        gain, offset = np.polyfit(own, other, 1)
        channels.append(gain * own + offset)
    return np.stack(channels, axis=1)


def _seen(page: Page, opacity: str) -> NDArray[np.int64]:
    """(H, W, 3): the canvas with the photograph over the model, between the buttons."""
    page.evaluate(_FADED, opacity)
    picture = Image.open(io.BytesIO(page.locator(".stage canvas").screenshot())).convert("RGB")
    return np.asarray(picture)[_BARS:-_BARS].astype(np.int64)


if __name__ == "__main__":
    main()
