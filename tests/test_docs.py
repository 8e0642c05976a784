"""The README and the pages of docs/ name files, commands and messages that are there."""

from __future__ import annotations

import re
from collections import defaultdict
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path

import pytest
from small_demo import ROOT

from colmap_ihe.commandline.arguments import CommandFunction, parser_of

PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
# A decision keeps the names of the day on which it was made.
TODAY = [page for page in PAGES if "decisions" not in page.parts]
FOLDERS = "benchmarks|colmap_ihe|docker|docs|scripts|tests"
ROOMS = [folder.name for folder in (ROOT / "colmap_ihe").iterdir() if (folder / "__init__.py").is_file()]


def code_of(page: Path) -> list[str]:
    """Return the code spans and the lines of code blocks of a page, each on one line."""
    text = page.read_text(encoding="utf-8")
    fenced = re.compile(r"^ *```.*?^ *```", re.M | re.S)
    blocks = [line for block in fenced.findall(text) for line in block.splitlines()[1:-1]]
    indented = re.findall(r"^    \S.*", text, re.M)
    spans = re.findall(r"`([^`]+)`", fenced.sub("", text))
    return [" ".join(piece.split()) for piece in blocks + indented + spans]


def heading_anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_a_page_leads_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        assert file.exists(), f"{page.name} links to {target}"
        assert not anchor or anchor in heading_anchors(file), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", TODAY, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_file_that_a_page_names_exists(page: Path) -> None:
    for code in code_of(page):
        for path in re.findall(rf"(?:^|\s)((?:{FOLDERS})/[\w./-]*\w)", code):
            assert (ROOT / path).exists(), f"{page.name} names {path}"
        for path in re.findall(rf"(?:^|\s)((?:{'|'.join(ROOMS)})/[\w/]+\.(?:py|c))", code):
            assert (ROOT / "colmap_ihe" / path).exists(), f"{page.name} names {path}"


@pytest.fixture(scope="module")
def help_texts() -> dict[str, str]:
    """Return the help of each command by its name."""
    asked: defaultdict[str, CommandFunction] = defaultdict(lambda: lambda *_: None)
    parser = parser_of(asked)
    helps = {name: StringIO() for name in asked}
    for name, text in helps.items():
        with redirect_stdout(text), suppress(SystemExit):
            parser.parse_args([name, "--help"])
    return {name: text.getvalue() for name, text in helps.items()} | {"help": ""}


@pytest.mark.parametrize("page", TODAY, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_command_that_a_page_gives_exists(page: Path, help_texts: dict[str, str]) -> None:
    for code in code_of(page):
        for name, rest in re.findall(r"(?:^|\s)colmap-ihe ([a-z]\w+)([^#|;&]*)", code):
            assert name in help_texts, f"{page.name}: {code}"
            for option in re.findall(r"(?<=\s)--[a-z][\w-]*", rest):
                assert option in help_texts[name], f"{page.name}: {code}"
