"""Draw the pictures of the documentation site from a finished demo: what the page's viewer shows, and the photographs.

    python benchmarks/site_pictures.py DEMO_FOLDER [-o docs/images]

Writes looks.jpg (the model in four looks), cameras.jpg (the model with its cameras) and set.jpg (the photographs).
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/scenes"))

from browser import headless

if TYPE_CHECKING:
    from playwright.sync_api import Page

LOOKS = ("Texture", "Clay", "Height", "Points")
_SETTLE_MS = 2500
_BARE = """for (const e of document.querySelector("canvas").parentElement.children)
  if (e.tagName != "CANVAS") e.style.visibility = "hidden";"""
_PRESS = """(words) => [...document.querySelectorAll("button, label")]
  .find((e) => e.textContent.trim() == words).click()"""


def canvas_of(page: Page) -> Image.Image:
    page.wait_for_timeout(_SETTLE_MS)
    picture = page.locator("canvas").first.screenshot()
    return Image.open(io.BytesIO(picture)).convert("RGB")


def tiles(pictures: list[Image.Image], width: int, columns: int) -> Image.Image:
    """Return pictures of one shape in rows, each `width` pixels wide."""
    height = round(width * pictures[0].height / pictures[0].width)
    rows = -(-len(pictures) // columns)
    sheet = Image.new("RGB", (columns * width, rows * height), "white")
    for number, picture in enumerate(pictures):
        small = picture.resize((width, height), Image.Resampling.LANCZOS)
        sheet.paste(small, (number % columns * width, number // columns * height))
    return sheet


def views_of(page_file: Path) -> tuple[list[Image.Image], Image.Image]:
    """Return the model in each look, and from the front with its cameras."""
    with headless() as browser:
        page = browser.new_page(viewport={"width": 1000, "height": 1000})
        page.goto(page_file.resolve().as_uri())
        page.wait_for_timeout(2 * _SETTLE_MS)
        page.evaluate(_BARE)
        looks = []
        for look in LOOKS:
            page.evaluate(_PRESS, look)
            looks.append(canvas_of(page))
        page.evaluate(_PRESS, "Texture")
        page.evaluate(_PRESS, "Front")
        page.wait_for_timeout(_SETTLE_MS)
        return looks, canvas_of(page)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("demo", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/images"))
    given = parser.parse_args()
    looks, cameras = views_of(given.demo / "report/index.html")
    photographs = [Image.open(file).convert("RGB") for file in sorted((given.demo / "images").glob("*.jpg"))]
    sheets = {"looks": tiles(looks, 500, 2), "cameras": cameras, "set": tiles(photographs, 180, 5)}
    given.output.mkdir(parents=True, exist_ok=True)
    for name, sheet in sheets.items():
        sheet.save(given.output / f"{name}.jpg", quality=75, optimize=True, progressive=True)


if __name__ == "__main__":
    main()
