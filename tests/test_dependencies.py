"""What is installed, what pyproject.toml asks for, and what docs/dependencies.md says of it."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from programs import program
from small_demo import ROOT

PAGE = ROOT / "docs" / "dependencies.md"


@pytest.fixture(scope="module")
def licences() -> Any:
    return program("scripts/licences")


@pytest.fixture(scope="module")
def packaging_script() -> Any:
    return program("scripts/test-packaging")


def run_licences(page: Path) -> tuple[int, str, str]:
    command = [sys.executable, str(ROOT / "scripts" / "licences"), "--docs", str(page)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def test_every_dependency_is_listed_with_its_licence() -> None:
    status, table, failures = run_licences(PAGE)
    assert (status, failures) == (0, "")
    assert "| pycolmap | BSD-3-Clause | base* |" in table


def test_a_line_that_is_missing_or_wrong_is_told(tmp_path: Path) -> None:
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    changed = [line.replace("| MIT |", "| ISC |") for line in lines if not line.startswith("| numpy |")]
    (tmp_path / "page.md").write_text("\n".join(changed), encoding="utf-8")
    status, _, failures = run_licences(tmp_path / "page.md")
    assert status == 1
    assert "numpy: page.md says nothing, its metadata BSD-3-Clause" in failures
    assert "rich: page.md says ISC, its metadata MIT" in failures
    assert "tifffile" not in failures


def test_every_dependency_has_a_line_installed_or_not(licences: Any) -> None:
    told = licences.documented(PAGE)
    asked = {licences.canonicalize_name(one.name) for one, _ in licences.direct()}
    assert {"pycolmap", "distributed", "xatlas", "hatchling", "tomli"} <= asked <= set(told)
    assert [licence for licence in told.values() if not licences.goes_with_ours(licence)] == []


def test_which_licences_go_with_ours(licences: Any) -> None:
    good = ["MIT", "BSD-3-Clause AND MIT", "Apache-2.0 OR GPL-3.0-only", "(MIT OR GPL-2.0-only)"]
    others = ["MIT AND GPL-3.0-or-later", "GPL-3.0-or-later", "unknown"]
    assert [one for one in (*good, *others) if licences.goes_with_ours(one)] == good


def test_a_licence_is_read_from_words_of_all_kinds(licences: Any) -> None:
    read = [licences.spdx(words) for words in ("mit", "BSD License", "Apache-2.0 OR MIT", "my own", "")]
    assert read == ["MIT", "BSD-3-Clause", "Apache-2.0 OR MIT", None, None]
    bsd = "Redistribution and use in source and binary forms ...\n Neither the\n name"
    texts = ((ROOT / "LICENSE").read_text(encoding="utf-8"), bsd, "All rights reserved")
    assert [licences.spdx_of_text(text) for text in texts] == ["Apache-2.0", "BSD-3-Clause", None]


def test_every_python_has_one_lower_bound_of_every_dependency(packaging_script: Any) -> None:
    listed = packaging_script.direct(*packaging_script.EXTRAS, "test")
    names = {Requirement(line).name for line in listed} - {"colmap-ihe", "tomli"}
    assert packaging_script.PYTHONS == ["3.10", "3.11", "3.12", "3.13"]
    for python in packaging_script.PYTHONS:
        pins = [Requirement(pin) for pin in packaging_script.minimum(listed, python)]
        assert sorted(pin.name for pin in pins if pin.name != "tomli") == sorted(names)
    with pytest.raises(packaging_script.Failed, match="0 lower bounds"):
        packaging_script.minimum(["numpy<3"], "3.12")


@pytest.mark.parametrize(
    "more", ["tests/data.npz", "colmap_ihe/photograph.JPG", "colmap_ihe/report/viewer/main.js"]
)
def test_a_wheel_with_what_does_not_belong_there_is_refused(
    packaging_script: Any, tmp_path: Path, more: str
) -> None:
    about = "colmap_ihe-1.dist-info"
    good = [*packaging_script.WHEEL_HOLDS, f"{about}/METADATA", f"{about}/licenses/LICENSE"]

    def wheel(names: list[str]) -> Path:
        with zipfile.ZipFile(tmp_path / "a.whl", "w") as archive:
            for name in names:
                archive.writestr(name, "")
        return tmp_path / "a.whl"

    packaging_script.check_wheel(wheel(good))
    with pytest.raises(packaging_script.Failed, match=more.rpartition("/")[2]):
        packaging_script.check_wheel(wheel([*good, more]))
    with pytest.raises(packaging_script.Failed, match=r"libkernels\.so"):
        packaging_script.check_wheel(wheel([n for n in good if "libkernels" not in n]))
