"""Whatever text comes to a page, in whatever place, it stays text: all three pages, every string of each at once."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from batch_contents import contents as batch_contents
from html_elements import Elements
from synthetic import synthetic_contents

from colmap_ihe.batch.folder import BatchFolder
from colmap_ihe.batch.state import BatchState, project_state, publish
from colmap_ihe.project.folder import Project
from colmap_ihe.report import pictures
from colmap_ihe.report.contents import Comparison, Contents, MethodFigures, Picture
from colmap_ihe.report.page import render_batch, render_comparison, render_page
from colmap_ihe.report.tables import Table

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Dialog

PAYLOADS = (
    '"><script>window.ran=1</script><img src=x onerror=window.ran=2>',
    "' onmouseover='window.ran=3' x='",
    "</script><script>window.ran=4</script>",
    "</title></style></svg></textarea><svg onload=window.ran=5>",
    "<!--<script>",
    "\u2028window.ran=6\u2029//",
    "{{window.ran=7}}{% include 'x' %}${window.ran=7}",
    "javascript:window.ran=8",
    "data:text/html,<script>window.ran=9</script>",
    "url(javascript:window.ran=10);}*{display:none}",
    "&#60;script&#62;window.ran=11&#60;/script&#62;",
    "\u202egpj.exe\u0000\x1b[31m",
)
ALL = "".join(PAYLOADS)


def spoilt(value: Any, payload: str) -> Any:
    """The same with the payload behind every text, but for what our own code chooses among."""
    if isinstance(value, str):
        return value + payload
    if isinstance(value, Picture):
        return dataclasses.replace(value, alt=value.alt + payload)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = {field.name for field in dataclasses.fields(value)} - {
            "kind",
            "page",
            "log",
            "lenses",
            "address",
        }
        changed = {name: spoilt(getattr(value, name), payload) for name in names}
        if isinstance(value, Contents):  # of a lens only what EXIF says is another's text
            lenses = [lens | {"exif": lens["exif"] | {"model": payload}} for lens in map(dict, value.lenses)]
            changed["lenses"] = lenses
        return dataclasses.replace(value, **changed)
    if isinstance(value, Mapping):
        return {spoilt(k, payload): spoilt(v, payload) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(spoilt(v, payload) for v in value)
    return value


def comparison() -> Comparison:
    shown = pictures.picture(np.full((60, 90, 3), 90, np.uint8), "a picture", 90)
    rows = [("ihe", "1,234"), ("rec709", "1,230, which is no more")]
    table = Table("points", "Points", ("method", "points"), rows)
    figures = [MethodFigures(name, shown, shown, shown, shown) for name in ("ihe", "rec709")]
    command = "colmap-ihe compare church"
    return Comparison("church: 2 greys", ["ihe has more."], [table], figures, command, "The paper")


PAGES: dict[str, Callable[[str], str]] = {
    "project": lambda payload: render_page(spoilt(synthetic_contents(500, 6), payload)),
    "comparison": lambda payload: render_comparison(spoilt(comparison(), payload)),
    "batch": lambda payload: render_batch(spoilt(batch_contents(), payload)),
}


def skeleton(html: str) -> list[tuple[str, tuple[str, ...]]]:
    return [(tag, tuple(sorted(attributes))) for tag, attributes in Elements(html).tags]


@pytest.mark.parametrize(
    ("page", "payload"),
    [("project", ALL), *((page, text) for page in ("comparison", "batch") for text in (*PAYLOADS, ALL))],
)
def test_text_makes_no_element_and_no_attribute(page: str, payload: str) -> None:
    plain, odd = PAGES[page]("x" * len(payload)), PAGES[page](payload)
    assert skeleton(odd) == skeleton(plain)
    assert len(Elements(odd).scripts) == len(Elements(plain).scripts)
    assert odd.encode()
    for kind, text in Elements(odd).scripts:
        if kind == "application/json":
            assert not set("<>&\u2028\u2029") & set(text)
            json.loads(text)
    for _, attributes in Elements(odd).tags:
        for name in ("href", "src", "style"):
            assert "window.ran" not in (attributes.get(name) or "")


def test_every_text_is_shown() -> None:
    """Else the test above would test nothing."""
    for page, render in PAGES.items():
        assert render("needle").count("needle") > 12, page


@pytest.mark.parametrize("page", PAGES)
def test_each_page_has_a_policy_that_lets_its_own_scripts_run_alone(page: str) -> None:
    elements = Elements(PAGES[page](" "))
    (policy,) = [a for _, a in elements.tags if a.get("http-equiv") == "Content-Security-Policy"]
    rules = {rule.split()[0]: rule.split()[1:] for rule in (policy["content"] or "").split(";")}
    assert rules["default-src"] == rules["base-uri"] == rules["form-action"] == ["'none'"]
    assert rules["img-src"] == ["data:"]
    digests = [hashlib.sha256(text.encode()).digest() for kind, text in elements.scripts if kind is None]
    assert len(digests) == (2 if page == "project" else 0)
    hashes = [f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests]
    assert rules["script-src"] == (hashes or ["'none'"])


@pytest.mark.parametrize("page", PAGES)
def test_nothing_is_loaded(page: str) -> None:
    html = PAGES[page](ALL)
    for tag, attributes in Elements(html).tags:
        assert tag not in {"link", "iframe", "object", "embed", "base", "form"}
        assert not any(name.startswith("on") for name in attributes)
        for name in ("src", "srcset", "poster", "action"):
            assert (attributes.get(name) or "data:image/").startswith("data:image/")
    style = re.search("<style>(.*?)</style>", html, re.S)
    assert style and "url(" not in style[1] and "@import" not in style[1]


def test_addresses_in_the_page_of_a_batch_stay_within(tmp_path: Path) -> None:
    root = tmp_path / "root"
    for name in ("javascript:window.ran=1", 'a"onclick="window.ran=2', "b<c>?#%2e", "http:"):
        for part in ("images", "report", "records"):
            (root / name / part).mkdir(parents=True)
        (root / name / "report/index.html").write_text("its own")
        (root / name / "records/batch.log").write_text("its log")
    folder = BatchFolder.at(root)
    folder.make()
    found = map(Project.at, folder.projects(pytest.fail))
    rows = [project_state(folder, project, "crashed", reason="why") for project in found]
    publish(folder, BatchState(str(root), "finished", rows, "now"), {})
    links = [a["href"] or "" for tag, a in Elements(folder.page_file.read_text()).tags if tag == "a"]
    own = [link for link in links if not link.startswith("#")]
    assert len(own) == 8
    assert all(link.startswith("../") and ":" not in link and '"' not in link for link in own)


@pytest.mark.parametrize("page", PAGES)
def test_nothing_of_it_runs_in_a_browser(browser: Browser, tmp_path: Path, page: str) -> None:
    """Also where the escaping were to fail: what stands in the page unescaped is stopped by its policy."""
    hole = (
        '<div id="hole"><img src=x onerror="window.ran=20"><a href="javascript:window.ran=21">x</a>'
        "<script>window.ran=22</script><script src='data:text/javascript,window.ran=23'></script>"
        "<iframe srcdoc='<script>top.ran=24</script>'></iframe></div>"
    )
    html = PAGES[page](ALL).replace("<main", hole + "<main", 1)
    (tmp_path / "page.html").write_text(html, encoding="utf-8")
    opened = browser.new_page()
    dialogs: list[str] = []

    def dismissed(dialog: Dialog) -> None:
        dialogs.append(dialog.message)
        dialog.dismiss()

    opened.on("dialog", dismissed)
    opened.goto((tmp_path / "page.html").as_uri())
    opened.locator("#hole a").click()
    opened.wait_for_timeout(200)
    assert opened.evaluate("window.ran === undefined")
    assert not dialogs
    opened.close()
