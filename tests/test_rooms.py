"""The package keeps its floor plan: small modules in rooms, and tests in rooms of the same names."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from small_demo import ROOT

PACKAGE, TESTS = ROOT / "colmap_ihe", ROOT / "tests"
OUTSIDE = {"__main__", "cli", "errors"}
WITHOUT_MODULE = {
    "commandline/test_convert", "dense/stereo/test_steps", "dense/texture/test_texture",
    "evaluation/test_surface_errors", "photographs/raw/test_sensors", "pipeline/stages/test_new_stage",
    "report/test_batch_page", "report/test_control_points_in_browser", "report/test_controls_in_browser",
    "report/test_hostile_pages",
    "report/test_page_in_browser",
}  # fmt: skip
THROUGH_OTHERS = {
    "__main__", "colmap/database", "colmap/database_probe", "colmap/features_on_workers",
    "colmap/part_databases", "commandline/shared_arguments", "dense/fusion_cell_workspace",
    "dense/textured_mesh", "evaluation/demo/grid", "evaluation/demo/light", "evaluation/demo/materials",
    "evaluation/page",
    "machine/cluster/executor", "machine/cluster/task", "photographs/decoder_main",
    "photographs/raw/calibration_masters", "photographs/raw/undecoded", "pipeline/doctor",
    "pipeline/page_pairs", "pipeline/run_stages", "pipeline/stages/convert", "pipeline/stages/features",
    "pipeline/stages/matches", "pipeline/stages/sparse",
}  # fmt: skip


def names(root: Path, pattern: str) -> set[str]:
    """Paths of the modules below `root`, without suffix."""
    return {p.relative_to(root).with_suffix("").as_posix() for p in root.rglob(pattern)}


MODULES = {name for name in names(PACKAGE, "*.py") if not name.endswith("__init__")}


def imported() -> Iterator[str]:
    """Modules of the package that a test imports, or something of them."""
    for file in TESTS.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                yield from (f"{node.module}.{alias.name}" for alias in node.names)
                yield str(node.module)
            elif isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)


def test_every_module_has_a_test_of_its_name_or_is_imported_by_one() -> None:
    tested = {name.replace("test_", "") for name in names(TESTS, "test_*.py")}
    tested |= {
        name.partition(".")[2].replace(".", "/") for name in imported() if name.startswith("colmap_ihe.")
    }
    assert MODULES - tested <= THROUGH_OTHERS <= MODULES


def test_no_test_stands_for_a_module_that_is_gone() -> None:
    tests = {name for name in names(TESTS, "test_*.py") if "/" in name and not name.startswith("road/")}
    assert {name for name in tests if name.replace("test_", "") not in MODULES} <= WITHOUT_MODULE


def test_only_the_entry_lies_outside_of_the_rooms() -> None:
    assert {name for name in names(PACKAGE, "*.py") if "/" not in name} == {"__init__", *OUTSIDE}


def test_no_module_and_no_function_is_long() -> None:
    for file in PACKAGE.rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert len(text.splitlines()) <= 300, file
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef):
                start = node.body[0].end_lineno if ast.get_docstring(node) else node.body[0].lineno
                assert (node.end_lineno or 0) - (start or 0) <= 60, f"{node.name} in {file}"


def test_no_module_can_download() -> None:
    """Decoders speak through sockets of this machine, and Dask of a cluster; no library that fetches is imported."""
    fetching = {
        "aiohttp",
        "ftplib",
        "http",
        "httpx",
        "requests",
        "ssl",
        "urllib.request",
        "urllib3",
        "xmlrpc",
    }
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                names = [str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)]
            reached = {name for name in names for it in fetching if name == it or name.startswith(f"{it}.")}
            assert not reached, f"{file}: {reached}"
