"""The lease of a run: a file in the shared folder that says whether what its tasks make is still wanted.

A task holds a lock on it while it works, wherever it runs, and looks into it now and then. So a run that ends, or
one that comes after another was killed, can wait until nobody writes into the project any more.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from colmap_ihe.errors import Cancelled, ClusterError
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress

_PATTERN = "cluster-*.lease"
_RUNNING, _OVER = b"running", b"is over"  # of one length: written in place, for the lock is on the file
_LOOK_SECONDS = 0.5
_POLL_SECONDS = 0.1
END_SECONDS = 600.0
"""How long a run waits for tasks that nobody wants any more, at most; each ends by itself in seconds."""


def new_lease(records: Path) -> Path:
    """A lease of its own in the folder of records of a project."""
    path = records / f"cluster-{secrets.token_hex(8)}.lease"
    write_bytes(path, _RUNNING)
    return path


def end_lease(path: Path, progress: Progress, seconds: float = END_SECONDS) -> None:
    """Says that the run is over, waits for its tasks and removes the lease. Raises `ClusterError` if one does not
    end, `Cancelled`; the lease then stays for the next run to wait for."""
    with path.open("r+b") as handle:
        handle.write(_OVER)
        handle.flush()
        os.fsync(handle.fileno())
        end = time.monotonic() + seconds
        while True:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                progress.check()
            if time.monotonic() > end:
                raise ClusterError(
                    f"{path}: a worker still works on what nobody wants any more",
                    hint="end the workers of the cluster; the same command then goes on from here",
                )
            time.sleep(_POLL_SECONDS)
        path.unlink(missing_ok=True)


def has_leases(records: Path) -> bool:
    """Whether a run was killed whose tasks may go on."""
    return any(records.glob(_PATTERN))


def end_old_leases(records: Path, progress: Progress) -> None:
    """Ends what runs have left that were killed. Raises as `end_lease`."""
    for path in sorted(records.glob(_PATTERN)):
        end_lease(path, progress)


class Over:
    """Whether the run of a lease is over, looked up twice a second at the most."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._is_over, self._until = False, 0.0

    def is_set(self) -> bool:
        now = time.monotonic()
        if not self._is_over and now >= self._until:
            self._is_over, self._until = _is_over(self._path), now + _LOOK_SECONDS
        return self._is_over


@contextmanager
def held(path: Path) -> Iterator[Over]:
    """For a task, while it works. Raises `Cancelled` where the run is over, OSError without a lease."""
    with path.open("rb") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Cancelled from None
        over = Over(path)
        if over.is_set():
            raise Cancelled
        yield over


def _is_over(path: Path) -> bool:
    try:
        return path.read_bytes() == _OVER
    except FileNotFoundError:
        return True
    except OSError:  # a network folder that stumbles has not said that the run is over
        return False
