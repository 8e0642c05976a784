"""Locks on folders, and disks that have none."""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path

import pytest

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.locks import acquire_lock
from colmap_ihe.pipeline.output_folder import opened
from colmap_ihe.project.folder import Project


def test_one_at_a_time(tmp_path: Path) -> None:
    lock = acquire_lock(tmp_path / "records/lock")
    assert lock is not None
    assert acquire_lock(tmp_path / "records/lock") is None
    lock.close()
    with acquire_lock(tmp_path / "records/lock") as again:  # type: ignore[union-attr]
        assert again is not None


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS])
def test_a_disk_without_locks_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuse)
    (tmp_path / "project/images").mkdir(parents=True)
    project = Project.at(tmp_path / "project")
    with (
        pytest.raises(ProjectError, match=r"project/records: its disk has no locks \(") as raised,
        project.locked(),
    ):
        pass
    assert "a folder on a disk of this machine" in raised.value.hint
    with pytest.raises(ProjectError, match=r"grey: its disk has no locks \("), opened(tmp_path / "grey"):
        pass
