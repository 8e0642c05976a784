"""Hold the lease of a run: a file in the shared folder that its tasks lock while they work, wherever they run.

Dask does not end a task that runs. So a run that ends, and the next one after a run was killed, on a cluster or not,
empty the lease, which tells its tasks that the run is over, and wait until none of them holds it any more.
"""

from __future__ import annotations

import os
import secrets
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from colmap_ihe.errors import Cancelled, ClusterError
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress, RunProgress
from colmap_ihe.machine.system import has_lock

_PATTERN = "cluster-*.lease"
_LOOK_SECONDS = 0.5
_POLL_SECONDS = 0.1
END_SECONDS = 600.0
"""The longest that a run waits for tasks of a run that is over; each ends by itself in seconds."""


def new_lease(records: Path) -> Path:
    """Write a lease in the folder of records of a project."""
    path = records / f"cluster-{secrets.token_hex(8)}.lease"
    write_bytes(path, b"running")
    return path


def end_lease(path: Path, progress: Progress, seconds: float = END_SECONDS) -> None:
    """Tell the tasks of a lease that their run is over, wait for them and remove it. Raises `ClusterError` if one does
    not end, and `Cancelled`; the lease then stays for the next run to wait for."""
    with path.open("r+b") as handle:
        handle.truncate()  # in place, for the lock is on the file
        os.fsync(handle.fileno())
        end = time.monotonic() + seconds
        while not has_lock(handle.fileno()):
            progress.check()
            if time.monotonic() > end:
                raise ClusterError(
                    f"{path}: a worker still works for a run that is over",
                    hint="end the workers of the cluster; the same command then goes on from here",
                )
            time.sleep(_POLL_SECONDS)
        path.unlink(missing_ok=True)


def end_old_leases(records: Path, progress: RunProgress) -> None:
    """Wait for the tasks of runs that were killed. Raises as `end_lease`."""
    for path in sorted(records.glob(_PATTERN)):
        with progress.stage("cluster") as stage_progress:
            end_lease(path, stage_progress)


@contextmanager
def held(path: Path) -> Iterator[RunOver]:
    """Lock the lease while a task works. Raises `Cancelled` where the run is over, OSError without a lease."""
    with path.open("rb") as handle:
        over = RunOver(path)
        if not has_lock(handle.fileno(), shared=True) or over.is_set():
            raise Cancelled
        yield over


class RunOver:
    """Tell whether the run of a lease is over, by a look twice a second at most."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._is_over, self._until = False, 0.0

    def is_set(self) -> bool:
        """Return whether the run is over; a network folder that stumbles has not said so."""
        now = time.monotonic()
        if not self._is_over and now >= self._until:
            self._until = now + _LOOK_SECONDS
            with suppress(OSError):
                self._is_over = not self._path.exists() or not self._path.read_bytes()
        return self._is_over
