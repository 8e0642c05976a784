"""A headless Chromium that draws in software, for whoever has one."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Browser

_ARGUMENTS = [
    "--no-sandbox", "--disable-gpu", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update",
    "--disable-sync",
]  # fmt: skip
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def chromium() -> str | None:
    """Where a Chromium is installed, if one is."""
    return next((found for name in _NAMES if (found := shutil.which(name))), None)


@contextmanager
def headless() -> Iterator[Browser]:
    """The browser. Raises ImportError without playwright, RuntimeError without Chromium."""
    from playwright.sync_api import sync_playwright

    if (where := chromium()) is None:
        raise RuntimeError("no Chromium is installed")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=where, args=_ARGUMENTS)
        try:
            yield browser
        finally:
            browser.close()
