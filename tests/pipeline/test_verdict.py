"""Whether a machine is enough: said of a project, and of photographs in general."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable
from pathlib import Path

import pytest

from colmap_ihe.machine import memory
from colmap_ihe.pipeline import verdict
from colmap_ihe.pipeline.estimates import needs_of
from colmap_ihe.pipeline.resource_needs import PhotoSetSize
from colmap_ihe.project.options import Options

GB = 10**9
SET = PhotoSetSize(12, 72_000_000, 6_000_000, 0, 0, 180_000_000)
NEEDS = needs_of(Options(), SET)
Usage = namedtuple("Usage", "free")
Machine = Callable[..., None]


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    def of(memory_gb: float, disk_gb: float, cores: int = 2) -> None:
        monkeypatch.setattr(memory, "available", lambda: round(memory_gb * GB))
        monkeypatch.setattr(verdict, "local_workers", lambda: cores)
        monkeypatch.setattr("colmap_ihe.pipeline.estimates.local_workers", lambda: cores)
        monkeypatch.setattr(
            "colmap_ihe.pipeline.verdict.shutil.disk_usage", lambda _: Usage(round(disk_gb * GB))
        )

    return of


def test_of_a_project(machine: Machine, tmp_path: Path) -> None:
    def said(memory_gb: float, disk_gb: float) -> str:
        machine(memory_gb, disk_gb)
        return verdict.of_project(NEEDS, 2 * GB, 125, tmp_path)

    assert said(16, 50) == (
        "enough: up to 4.1 GB of memory of 16.0 GB free, 2.0 GB of 50.0 GB free on the disk, about 2.1 h"
    )
    assert said(2, 50).startswith("not enough: mesh takes up to 2.")
    assert "fewer mesh.faces helps" in said(2, 50)
    assert said(16, 2.2) == ("not enough: the stages write about 2.0 GB, and 2.2 GB are free on the disk")


def test_in_general(machine: Machine, tmp_path: Path) -> None:
    def counts(memory_gb: float, disk_gb: float) -> str:
        machine(memory_gb, disk_gb)
        return verdict.in_general(tmp_path)

    assert "(the disk is the limit)" in counts(64, 5)
    assert "(memory for mesh is the limit)" in counts(8, 500)
    assert counts(1, 500).startswith(
        "not enough for photographs of 12 megapixels: 1.0 GB of memory and 500.0 GB"
    )
    small, large = (int(counts(64, disk).split()[6].replace(",", "")) for disk in (5, 50))
    assert 9 < large / small < 11


def test_time_goes_by_cores(machine: Machine) -> None:
    machine(16, 50)
    two = verdict.minutes_of(Options(), SET)
    machine(16, 50, cores=8)
    eight = verdict.minutes_of(Options(), SET)
    assert {"fit", "features", "matches", "sparse", "dense", "mesh", "page"} <= set(two)
    assert two["dense"] == pytest.approx(4 * eight["dense"])
    assert (
        verdict.about(0) == ""
        and verdict.about(0.2) == ", about 1 min"
        and verdict.about(90) == ", about 1.5 h"
    )
