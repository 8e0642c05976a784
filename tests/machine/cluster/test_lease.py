"""The lease of a run: tasks hold it, and its end waits for them."""

from __future__ import annotations

import threading
import time
from pathlib import Path

import pytest

from colmap_ihe.errors import Cancelled, CapabilityError, ClusterError
from colmap_ihe.machine import system
from colmap_ihe.machine.cluster.connect import connected
from colmap_ihe.machine.cluster.lease import end_lease, end_old_leases, held, new_lease
from colmap_ihe.machine.progress import SILENT, Silent
from colmap_ihe.project.option_sections import ClusterOptions


def test_its_end_waits_for_the_tasks(tmp_path: Path) -> None:
    lease = new_lease(tmp_path)
    begun, done = threading.Event(), []

    def work() -> None:
        with held(lease) as over:
            begun.set()
            while not over.is_set():
                time.sleep(0.01)
            done.append(True)

    task = threading.Thread(target=work)
    task.start()
    assert begun.wait(10)
    assert done == []
    end_lease(lease, SILENT, 10)
    assert done == [True]
    assert not lease.exists()
    task.join()


def test_a_task_that_comes_late_does_nothing(tmp_path: Path) -> None:
    lease, progress = new_lease(tmp_path), Silent()
    with held(lease):
        with pytest.raises(ClusterError, match="still works for a run that is over"):
            end_lease(lease, SILENT, 0.2)
        with pytest.raises(Cancelled), held(lease):
            pytest.fail("the run is over")
        progress.cancelled = True
        with pytest.raises(Cancelled):
            end_lease(lease, progress)
    assert lease.exists()  # for the next run to wait for
    end_old_leases(tmp_path, SILENT)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(FileNotFoundError), held(lease):
        pytest.fail("there is no such run")


def test_without_shared_locks_there_is_no_cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "SHARES_LOCKS", False)
    options = ClusterOptions(address="local:2")
    with (
        pytest.raises(CapabilityError, match="a cluster needs locks"),
        connected(options, tmp_path, (), SILENT),
    ):
        pass
