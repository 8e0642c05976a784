"""The README and the pages of docs/ name files, commands and messages that are there."""

from __future__ import annotations

import re
from collections import defaultdict
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path

import pytest
import yaml
from small_demo import ROOT

import colmap_ihe
from colmap_ihe.commandline.arguments import CommandFunction, parser_of
from colmap_ihe.project.options import KnownCamera, Options

PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]
TABLES = sorted((ROOT / "benchmarks").glob("*.md"))
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


@pytest.mark.parametrize("page", [*PAGES, *TABLES], ids=lambda page: str(page.relative_to(ROOT)))
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


def test_options_names_every_option_with_its_default() -> None:
    text = (ROOT / "docs/options.md").read_text(encoding="utf-8")
    defaults = yaml.safe_load(text.partition("```yaml")[2].partition("```")[0])
    assert defaults == Options().as_yaml()
    of_a_camera = text.partition("| key | is |")[2].partition("\n\n")[0]
    assert set(re.findall(r"`(\w+)`", of_a_camera)) >= KnownCamera.model_fields.keys()


def test_the_python_page_names_every_public_name() -> None:
    named = re.findall(r"^::: colmap_ihe\.(\w+)$", (ROOT / "docs/api.md").read_text(encoding="utf-8"), re.M)
    assert sorted(named) == sorted(set(colmap_ihe.__all__) - {"__version__"})


def statements_of(text: str) -> list[str]:
    """Return the sentences of a page in plain words: no code blocks, headings, pictures, links or marks."""
    text = re.sub(r"^```.*?^```|^#.*?$|^!\[.*?$", "", text, flags=re.M | re.S)
    text = re.sub(r"\[([^]]+)\]\([^)]+\)", r"\1", text).replace("**", "").replace("`", "")
    parts = re.split(r"\n\s*\n|^(?:-|\d\.) ", text, flags=re.M)
    sentences = [
        s for part in parts for s in re.split(r"(?<=\.) (?=[A-Z]|colmap-ihe)", " ".join(part.split()))
    ]
    return [sentence for sentence in sentences if sentence.endswith((".", ",", ";", ".)"))]


def test_a_test_or_a_benchmark_stands_behind_each_of_the_first_statements() -> None:
    """Whoever changes the README changes the table of docs/measured.md, and so looks what shows the new sentence."""
    table = (ROOT / "docs/measured.md").read_text(encoding="utf-8").partition("| shown by |\n|---|---|\n")[2]
    rows = re.findall(r"^\| (.+?) \| (.+?) \|$", table, re.M)
    assert len(rows) >= 20
    statements = statements_of((ROOT / "README.md").read_text(encoding="utf-8"))
    for statement, (beginning, shown) in zip(statements, rows, strict=False):
        assert statement.startswith(beginning), f"{beginning!r} is said to begin {statement!r}"
        assert re.search(r"`(?:python )?(?:tests|benchmarks|scripts)/", shown), statement


def test_every_test_that_a_page_names_exists() -> None:
    for page in TODAY:
        for file, name in re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page.read_text(encoding="utf-8")):
            assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8"), f"{page.name}: {file}::{name}"


def test_the_citation_is_of_this_version_and_of_the_paper_that_the_readme_names() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for key in ("version", "license"):
        assert f'\n{key} = "{citation[key]}"' in project
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    paper = re.search(r"\*(Intensity histogram equalisation, [^*]+)\* \((\d{4})\)", readme)
    assert paper is not None
    assert f'"{paper[1]}" ({paper[2]})' in citation["message"]
