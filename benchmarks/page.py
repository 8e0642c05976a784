"""Measure the size of a page, the time until it opens and the frames a second of its cloud, in a Chromium that draws in
software.

    python benchmarks/page.py [--points 200000]

Frames are counted while a key turns the cloud at every frame for five seconds; each is read back, so that it is
counted when it is drawn and not when it was asked for. A second count is without reading back.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/scenes"))

from browser import headless
from synthetic import synthetic_contents

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.report.page import render_page

_TURN = """([seconds, back]) => new Promise((done) => {
  const canvas = document.querySelector("canvas");
  const gl = canvas.getContext("webgl2");
  const points = [];
  const pixel = new Uint8Array(4);
  canvas.addEventListener("drawn", (e) => {
    points.push(e.detail.points);
    if (back) gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
  });
  const start = performance.now();
  const step = () => {
    canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" }));
    if (performance.now() - start < 1000 * seconds) requestAnimationFrame(step);
    else done([points.length / (performance.now() - start) * 1000, points.at(-1)]);
  };
  step();
})"""
_LOADED = "() => performance.getEntriesByType('navigation')[0].loadEventEnd"
_WATCH = "addEventListener('drawn', (e) => { window.all ??= e.detail.points >= %d ? performance.now() : null }, true)"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=200_000)
    parser.add_argument("--seconds", type=float, default=5.0, help="of turning (default 5)")
    given = parser.parse_args()
    # a tenth of the points of the made-up facade stand in the sky and are dropped
    contents = synthetic_contents(round(given.points / 0.88))
    assert contents.cloud is not None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "page.html"
        began = time.perf_counter()
        path.write_text(render_page(contents), encoding="utf-8")
        rendered = time.perf_counter() - began
        rows = [
            ("points", f"{len(contents.cloud.positions):,}"),
            ("page", f"{path.stat().st_size / 1e6:.1f} MB"),
            ("rendered in", f"{rendered:.2f} s"),
        ]
        with headless() as browser:
            page = browser.new_page(viewport={"width": 1280, "height": 900})
            page.add_init_script(_WATCH % len(contents.cloud.positions))
            page.goto(path.as_uri())
            page.wait_for_function("window.all")
            rows += [
                ("loaded after", f"{page.evaluate(_LOADED) / 1000:.2f} s"),
                ("all points drawn after", f"{page.evaluate('window.all') / 1000:.2f} s"),
            ]
            page.wait_for_timeout(1000)
            for name, back in (("read back", True), ("not read back", False)):
                frames, points = page.evaluate(_TURN, [given.seconds, back])
                rows.append((f"turning, {name}", f"{frames:.0f} frames/s of {points:,} points"))
                page.wait_for_timeout(1000)
    print_table("page", rows)


if __name__ == "__main__":
    main()
