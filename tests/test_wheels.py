"""What `scripts/wheels` refuses of a compiled library, and the tag of a wheel that is built here."""

from __future__ import annotations

import platform
import re
import sys
from types import ModuleType

import lief
import pytest
from programs import program
from small_demo import ROOT

LIBRARY = ROOT / "colmap_ihe/grey/libkernels.so"
linux = pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64" or platform.libc_ver()[0] != "glibc",
    reason="the library here is of another system",
)


@pytest.fixture(scope="module")
def wheels() -> ModuleType:
    return program("scripts/wheels")


@linux
def test_the_library_here_is_what_its_tag_says(wheels: ModuleType) -> None:
    library = lief.parse(str(LIBRARY))
    assert wheels.faults(library, "x86_64-linux-gnu.2.17") == []
    assert wheels.faults(library, "aarch64-linux-gnu.2.17") == ["is for X86_64"]
    assert wheels.faults(library, "x86_64-linux-musl") == ["loads libc.so.6"]
    assert wheels.faults(library, "x86_64-windows-gnu")[:2] == ["is ELF", "loads libc.so.6"]


@linux
def test_what_a_library_lacks_or_needs_too_much_is_told(
    wheels: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = lief.parse(str(LIBRARY))
    monkeypatch.setattr(wheels, "CALLED", re.compile(r"^class (Table)\b", re.MULTILINE))
    monkeypatch.setattr(wheels, "GLIBC", (2, 2))
    found = wheels.faults(library, "x86_64-linux-gnu.2.17")
    assert found[0] == "does not export Table"
    assert found[1].startswith("needs version (2, ")


@pytest.mark.parametrize(
    ("system", "libc", "machine", "tag"),
    [
        ("linux", "glibc", "x86_64", "manylinux_2_17_x86_64"),
        ("linux", "", "aarch64", "musllinux_1_2_aarch64"),
        ("darwin", "", "arm64", "macosx_11_0_arm64"),  # of a Python of both architectures too
        ("win32", "", "AMD64", "win_amd64"),
        ("win32", "", "ARM64", "win_arm64"),
    ],
)
def test_a_wheel_has_the_tag_of_its_library(
    monkeypatch: pytest.MonkeyPatch, system: str, libc: str, machine: str, tag: str
) -> None:
    hook = program("hatch_build.py")
    monkeypatch.setattr(hook.sys, "platform", system)
    monkeypatch.setattr(hook.platform, "libc_ver", lambda: (libc, ""))
    monkeypatch.setattr(hook.platform, "machine", lambda: machine)
    assert hook.this_platform() == tag
    assert tag in hook.TARGETS
