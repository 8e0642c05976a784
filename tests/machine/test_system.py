"""What not every system has, as it is where the system has it and where not."""

from __future__ import annotations

import mmap
import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
from processes import is_gone, soon

from colmap_ihe.machine import system


def test_a_folder_is_locked_by_one_at_a_time(tmp_path: Path) -> None:
    first, second = system.open_to_lock(tmp_path), system.open_to_lock(tmp_path)
    assert system.has_lock(first)
    assert not system.has_lock(second)
    assert not list(tmp_path.iterdir())  # nothing of ours in the user's folder
    os.close(first)
    assert system.has_lock(second)
    os.close(second)


def test_a_process_is_killed_with_what_it_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """By psutil where there are no sessions."""
    monkeypatch.delattr(os, "killpg", raising=False)
    code = "import subprocess, time; print(subprocess.Popen(['sleep', '99']).pid, flush=True); time.sleep(99)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        grandchild = int(process.stdout.readline())
        system.kill(process.pid)
        assert process.wait() < 0
    assert soon(lambda: is_gone(grandchild))
    system.kill(process.pid)  # which is no more


def test_memory_is_known_without_proc() -> None:
    held, most = system.taken_memory(None)
    assert held == pytest.approx(psutil.Process().memory_info().rss, rel=0.2)
    assert most >= held
    assert system.taken_memory(2**22 + 1) == (0, 0)
    total, free = system.machine_memory()
    assert 0 < free < total == psutil.virtual_memory().total


def test_a_file_in_memory_and_a_shared_one_are_mapped(tmp_path: Path) -> None:
    for descriptor in (system.anonymous_file(), system.open_shared(tmp_path / "1", new=True)):
        os.ftruncate(descriptor, 4096)
        mapped = mmap.mmap(descriptor, 4096)
        os.close(descriptor)
        mapped[:4] = b"pixe"
        system.give_back(mapped)
        mapped.close()
    with pytest.raises(FileExistsError):
        system.open_shared(tmp_path / "1", new=True)


@pytest.mark.posix
def test_no_more_data_than_is_allowed() -> None:
    with system.data_limited(1 << 28), pytest.raises(MemoryError):
        bytearray(1 << 29)
    assert len(bytearray(1 << 29)) == 1 << 29
