"""A `concurrent.futures.Executor` over the workers of a Dask scheduler, which may both come and go.

A task whose worker dies is given to another by the scheduler. Where the scheduler is lost, all that is not done is
sent again to the one that comes back. Every task may therefore run twice, and writes whole files or none.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from functools import partial
from typing import Any

from distributed import Client, KilledWorker

from colmap_ihe.errors import Cancelled, ClusterError
from colmap_ihe.machine.cluster.task import Task, Terms

_TICK_SECONDS = 0.5
_LEAVE_SECONDS = 5
_GO_ON = "the same command goes on from here"


class _Job:
    """A task that is not done. `lost` where no scheduler knows of it."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.future: Future[Any] = Future()
        self.remote: Any = None  # a distributed.Future
        self.lost = False


class ClusterExecutor(Executor):
    """Runs functions on workers. `connect` makes a client, or raises OSError; without a worker for `patience`
    seconds all that waits fails with `ClusterError`. `say` is told in a sentence what it waits for."""

    def __init__(
        self, connect: Callable[[], Client], terms: Terms, patience: float, say: Callable[[str], None]
    ) -> None:
        self.terms = terms
        self._connect, self._patience, self._say = connect, patience, say
        self._client = connect()
        self._threads = 0
        self._lock = threading.Lock()
        self._jobs: set[_Job] = set()
        self._failure: ClusterError | None = None
        self._closing = threading.Event()
        self._alone_since: float | None = None
        self._told = False
        self._look()
        self._keeper = threading.Thread(target=self._keep, name="cluster", daemon=True)
        self._keeper.start()

    @property
    def client(self) -> Client:
        return self._client

    @property
    def width(self) -> int:
        """Threads of all workers, at least one."""
        return max(1, self._threads)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As any executor; what is given and returned is pickled."""
        job = _Job(Task(self.terms, fn, args, kwargs))
        with self._lock:
            if self._failure is not None:
                raise self._failure
            if self._closing.is_set():
                raise RuntimeError("cannot schedule new futures after shutdown")
            self._jobs.add(job)
        job.future.add_done_callback(partial(self._forget, job))
        self._send(job)
        return job.future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leaves the scheduler and its workers alone."""
        with self._lock:
            waiting = [job.future for job in self._jobs]
        for future in waiting:
            if cancel_futures:
                future.cancel()
            elif wait:
                with suppress(BaseException):
                    future.exception()
        self._closing.set()
        self._keeper.join(_LEAVE_SECONDS)
        self._client.close(timeout=_LEAVE_SECONDS)

    def _send(self, job: _Job) -> None:
        client, job.lost = self._client, False
        try:
            job.remote = client.submit(job.task, pure=False)
            job.remote.add_done_callback(partial(self._ended, job))
        except Exception as error:  # noqa: BLE001  a client whose scheduler is gone says so in many ways
            if client.status != "running":
                job.lost = True
            elif job.future.set_running_or_notify_cancel():  # as a function that cannot be pickled
                job.future.set_exception(error)

    def _ended(self, job: _Job, remote: Any) -> None:
        """On a thread of Dask's: the scheduler says that a task is done, or that it knows nothing of it."""
        if job.remote is not remote:
            return
        if remote.status not in ("finished", "error"):
            job.lost = True
            return
        outcome, error = None, None
        try:
            outcome = remote.result()
        except BaseException as raised:  # noqa: BLE001  it is the caller's
            if remote.status not in ("finished", "error"):
                job.lost = True
                return
            error = _translated(raised)
        if job.future.set_running_or_notify_cancel():
            if error is None:
                job.future.set_result(outcome)
            else:
                job.future.set_exception(error)

    def _forget(self, job: _Job, _: Future[Any]) -> None:
        with self._lock:
            self._jobs.discard(job)
        remote, job.remote = job.remote, None
        if remote is not None:
            with suppress(OSError, RuntimeError, ValueError):
                remote.release()  # a task that no client wants is not begun

    def _keep(self) -> None:
        while not self._closing.wait(_TICK_SECONDS):
            if self._client.status in ("closed", "closing"):
                with suppress(OSError, RuntimeError, ValueError):
                    self._client = self._connect()
            self._look()
            with self._lock:
                jobs = list(self._jobs)
            if self._threads:
                for job in jobs:
                    if job.lost:
                        self._send(job)
            self._lose_patience(jobs)

    def _look(self) -> None:
        """How many threads the workers have; 0 also where there is no scheduler."""
        self._threads = 0
        if self._client.status == "running":
            with suppress(Exception):  # it may go at any moment, and says so in many ways
                self._threads = sum(self._client.nthreads().values())

    def _lose_patience(self, jobs: list[_Job]) -> None:
        now = time.monotonic()
        if self._threads or not jobs:
            self._alone_since, self._told = None, False
            return
        self._alone_since = self._alone_since or now
        waited = now - self._alone_since
        gone = "worker" if self._client.status == "running" else "scheduler"
        if waited > min(2.0, self._patience) and not self._told:
            self._told = True
            self._say(f"no {gone} is there any more: waiting up to {self._patience:.0f} s for one")
        if waited > self._patience:
            error = ClusterError(
                f"no {gone} was there for {self._patience:.0f} s", hint=f"start one; {_GO_ON}"
            )
            with self._lock:
                self._failure = error
            for job in jobs:
                if job.future.set_running_or_notify_cancel():
                    job.future.set_exception(error)


def _translated(error: BaseException) -> BaseException:
    if isinstance(error, Cancelled):  # nobody has asked for it here
        return ClusterError("a worker took this run for ended", hint=_GO_ON)
    if not isinstance(error, KilledWorker):
        return error
    last = getattr(error.last_worker, "name", None) or getattr(error.last_worker, "address", "unknown")
    return ClusterError(
        f"one worker after the other died of the same task, the last was {last}",
        hint=f"perhaps for want of memory: give workers more of it or fewer threads; {_GO_ON}",
    )
