"""Run tasks on the workers of a Dask scheduler, which may both come and go, as a `concurrent.futures.Executor`; start
such workers on this machine, for `local:N`.

Dask's own, `Client.get_executor()`, cancels every task when the scheduler is lost and waits for ever without a worker.
Here the scheduler gives a dead worker's task to another worker, and what a lost scheduler had not done is sent to the
one that comes back. A task may therefore run twice, and writes whole files or none.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from distributed import Client, KilledWorker, LocalCluster

from colmap_ihe.errors import Cancelled, ClusterError
from colmap_ihe.machine import system
from colmap_ihe.machine.cluster.task import GO_ON, Task, Terms
from colmap_ihe.machine.scratch import scratch_folder

_TICK_SECONDS = 0.5
_LEAVE_SECONDS = 5
_END_SECONDS = 10
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1));"  # the same modules as here
    " from distributed.cli.dask_worker import main; main()"
)
_LIMITS = ["--nthreads", "1", "--memory-limit", "0", "--no-dashboard", "--death-timeout", "60"]


class _Job:
    """Hold a task that is not done; `lost` where no scheduler knows of it any more."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self.future: Future[Any] = Future()
        self.remote: Any = None  # a distributed.Future
        self.lost = False


class ClusterExecutor(Executor):
    """Run functions on workers.

    `connect` returns a client or raises OSError. Without a worker for `patience` seconds all that waits fails with
    `ClusterError`; `warn` is told before that what it waits for.
    """

    def __init__(
        self, connect: Callable[[], Client], terms: Terms, patience: float, warn: Callable[[str], None]
    ) -> None:
        self._connect, self._terms, self._patience, self._warn = connect, terms, patience, warn
        self.client = connect()
        self._threads = _threads_of(self.client)
        self._lock = threading.Lock()
        self._jobs: set[_Job] = set()
        self._failure: ClusterError | None = None
        self._closing = threading.Event()
        self._keeper = threading.Thread(target=self._keep, name="cluster", daemon=True)
        self._keeper.start()

    @property
    def width(self) -> int:
        """Return the number of threads of all workers, at least 1."""
        return max(1, self._threads)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run `fn` on a worker; arguments and result are pickled. Raises `ClusterError` when patience has ended."""
        job = _Job(Task(self._terms, fn, args, kwargs))
        with self._lock:
            if self._failure is not None:
                raise self._failure
            self._jobs.add(job)
        job.future.add_done_callback(partial(self._forget, job))
        self._send(job)
        return job.future

    def close(self) -> None:
        """Cancel what is not done and end the connection; the scheduler and its workers go on."""
        with self._lock:
            self._failure = ClusterError("the connection to the cluster is closed")
            futures = [job.future for job in self._jobs]
        for future in futures:
            future.cancel()
        self._closing.set()
        self._keeper.join(_LEAVE_SECONDS)
        self.client.close(timeout=_LEAVE_SECONDS)

    def _send(self, job: _Job) -> None:
        client, job.lost = self.client, False
        try:
            job.remote = client.submit(job.task, pure=False)
            job.remote.add_done_callback(partial(self._end, job))
        except Exception as error:  # noqa: BLE001  a client without its scheduler raises many kinds
            job.lost = client.status != "running"
            if not job.lost:  # as for a function that cannot be pickled
                _fail(job.future, error)

    def _end(self, job: _Job, remote: Any) -> None:
        """Take over the result of `remote`, on a thread of Dask's, or forget it where its scheduler was lost."""
        if job.remote is not remote:
            return
        try:
            result = remote.result()
        except BaseException as error:  # noqa: BLE001  it is the caller's
            job.lost = remote.status not in ("finished", "error")
            if not job.lost:
                _fail(job.future, _translated(error))
        else:
            if job.future.set_running_or_notify_cancel():
                job.future.set_result(result)

    def _forget(self, job: _Job, _: Future[Any]) -> None:
        with self._lock:
            self._jobs.discard(job)
        remote, job.remote = job.remote, None
        if remote is not None:
            with suppress(OSError, RuntimeError, ValueError):
                remote.release()  # a task that no client waits for is not begun

    def _keep(self) -> None:
        """Connect and send again after the scheduler was lost; end what waits when patience has ended."""
        since, warned = time.monotonic(), False
        while not self._closing.wait(_TICK_SECONDS):
            if self.client.status in ("closed", "closing"):
                with suppress(OSError, RuntimeError, ValueError):
                    self.client = self._connect()
            self._threads = _threads_of(self.client)
            with self._lock:
                jobs = list(self._jobs)
            if self._threads or not jobs:
                since, warned = time.monotonic(), False
                for job in jobs:
                    if job.lost:
                        self._send(job)
                continue
            waited = time.monotonic() - since
            missing = "worker" if self.client.status == "running" else "scheduler"
            if waited > min(2.0, self._patience) and not warned:
                warned = True
                self._warn(f"no {missing} is there any more: waiting up to {self._patience:.0f} s for one")
            if waited > self._patience:
                self._give_up(missing)

    def _give_up(self, missing: str) -> None:
        error = ClusterError(f"no {missing} was there for {self._patience:.0f} s", hint=f"start one; {GO_ON}")
        with self._lock:
            self._failure = error
            jobs = list(self._jobs)
        for job in jobs:
            _fail(job.future, error)


def _threads_of(client: Client) -> int:
    """Return the number of threads of all workers, 0 also without a scheduler."""
    if client.status == "running":
        with suppress(Exception):  # it may go at any moment, and raises many kinds then
            return sum(client.nthreads().values())
    return 0


def _fail(future: Future[Any], error: BaseException) -> None:
    if future.set_running_or_notify_cancel():
        future.set_exception(error)


def _translated(error: BaseException) -> BaseException:
    if isinstance(error, Cancelled):  # nobody has asked for it on this machine
        return ClusterError("a worker took this run for ended", hint=GO_ON)
    if not isinstance(error, KilledWorker):
        return error
    last = getattr(error.last_worker, "name", None) or getattr(error.last_worker, "address", "unknown")
    return ClusterError(
        f"one worker after the other died of the same task, the last was {last}",
        hint=f"perhaps for want of memory: give workers more of it or fewer threads; {GO_ON}",
    )


@contextmanager
def local_workers(count: int, log: Path) -> Iterator[str]:
    """Start a scheduler in this process and `count` workers of one thread: give the scheduler's address. A worker that
    dies is started again; what they print goes into `log`.

    `distributed.LocalCluster` starts its workers with `multiprocessing`: it runs the user's script again in each of
    them unless that is guarded, and they print on our stdout. `dask worker` is a fresh Python, here in a session of its
    own, since Ctrl-C in the terminal is for us. Workers end with the scheduler, however this process ends.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    scheduler = LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0", silence_logs=50, host="127.0.0.1")
    with scratch_folder() as scratch, log.open("wb") as output, scheduler:
        address = scheduler.scheduler_address
        command = [sys.executable, "-c", _START, json.dumps(sys.path), address, "--nworkers", str(count)]
        workers = subprocess.Popen(
            [*command, *_LIMITS, "--name", "local", "--local-directory", str(scratch)],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            yield address
        finally:
            workers.terminate()
            try:
                workers.wait(_END_SECONDS)
            except subprocess.TimeoutExpired:
                system.kill(workers.pid)
                workers.wait()
