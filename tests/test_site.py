"""The documentation site: how its pages are laid out, and what its check finds."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml
from programs import program
from small_demo import ROOT


@pytest.fixture(scope="module")
def site() -> Any:
    """Return scripts/docs as a module."""
    return program("scripts/docs")


def test_links_lead_from_the_clone_to_the_site(site: Any) -> None:
    where = site.places()
    cases = {
        ("README.md", "[a](docs/raw.md#calibration-frames)"): "[a](raw.md#calibration-frames)",
        ("README.md", "[a](docs/decisions/)"): "[a](decisions/index.md)",
        ("docs/raw.md", "[a](../benchmarks/develop.md)"): "[a](benchmarks/develop.md)",
        (
            "docs/decisions/0007-noise-guard.md",
            "[a](../../benchmarks/guard.md)",
        ): "[a](../benchmarks/guard.md)",
        ("benchmarks/auto.md", "[a](../docs/method.md)"): "[a](../method.md)",
        ("CHANGELOG.md", "![a](docs/images/page.jpg)"): "![a](images/page.jpg)",
        (
            "docs/faq.md",
            "[a](#here) [b](https://colmap.github.io)",
        ): "[a](#here) [b](https://colmap.github.io)",
        ("docs/faq.md", "[a](../scripts/docs)"): "[a](../scripts/docs)",
    }
    assert {key: site.moved_links(key[1], Path(key[0]), where) for key in cases} == cases


def test_every_page_is_in_the_navigation_or_on_a_list() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = {p.relative_to(ROOT / "docs").as_posix() for p in (ROOT / "docs").rglob("*.md")}
    missing = {page for page in pages if f": {page}\n" not in navigation}
    assert {page.partition("/")[0] for page in missing} <= {"decisions", "use-with"}
    assert yaml.safe_load(navigation)["theme"]["font"] is False


def test_what_is_wrong_with_a_built_site_is_told(site: Any, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "index.html").write_text(
        '<a href="a/b.html#there">1</a><a href="a/b.html#gone">2</a><a href="c.html">3</a><img src="d.png">'
        '<a href="https://colmap.github.io">4</a><script src="//elsewhere.example/x.js"></script><a href="a/">5</a>'
    )
    (tmp_path / "a/index.html").write_text('<a href="../index.html">1</a>')
    (tmp_path / "a/b.html").write_text('<h2 id="there">1</h2>')
    (tmp_path / "alone.html").write_text('<a href="alone.html">1</a>')
    assert site.faults(tmp_path) == [
        "index.html loads //elsewhere.example/x.js",
        "index.html leads to a/b.html#gone, which is no place on that page",
        "index.html leads to c.html, which is not there",
        "index.html leads to d.png, which is not there",
        "alone.html: no page leads there",
    ]


@pytest.mark.slow
@pytest.mark.skipif(find_spec("zensical") is None, reason="needs the extra docs")
def test_the_site_is_built() -> None:
    subprocess.run([sys.executable, str(ROOT / "scripts/docs")], check=True)
    page = (ROOT / "build/site/api.html").read_text(encoding="utf-8")
    assert "Make a model in <code>project/workspace</code>" in page
