"""Connect to the cluster that the user names, and check its workers."""

from __future__ import annotations

import logging
import re
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from colmap_ihe.errors import CapabilityError, ClusterError, OptionError
from colmap_ihe.machine import system
from colmap_ihe.machine.cluster.lease import end_lease, end_old_leases, new_lease
from colmap_ihe.machine.cluster.task import SAME_ENVIRONMENT, Terms, check_terms, environment
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT, Progress, RunProgress

if TYPE_CHECKING:
    from distributed import Client

    from colmap_ihe.machine.cluster.executor import ClusterExecutor
    from colmap_ihe.project.folder import Project
    from colmap_ihe.project.option_sections import ClusterOptions

_CONNECT_SECONDS = 30.0
_POLL_SECONDS = 0.2


@contextmanager
def workers_for(
    options: ClusterOptions, project: Project, needs: Sequence[Path], progress: RunProgress
) -> Iterator[Executor]:
    """Give the executor for work on single images: threads here, or workers of the cluster that `options` name.

    `needs`: paths besides the project's folder that every worker must see. Raises `ClusterError`,
    `CapabilityError` without Dask, `OptionError` for a wrong address, `Cancelled`.
    """
    if options.address is None:
        end_old_leases(project.records, progress)
        with local_executor() as threads:
            yield threads
    else:
        with connected(options, project.records, (project.root, *needs), progress) as executor:
            yield executor


@contextmanager
def connected(
    options: ClusterOptions, records: Path, needs: Sequence[Path], progress: RunProgress
) -> Iterator[ClusterExecutor]:
    """Give an executor over a cluster; when it is left, no task runs any more. `records`: a folder that all workers
    see, for the lease and the log. Raises as `workers_for`."""
    if not system.SHARES_LOCKS:
        raise CapabilityError(
            "a cluster needs locks that several processes share, which this system has not",
            hint="leave out --cluster, or run on Linux or macOS",
        )
    address = options.address or ""
    count = local_count(address)
    try:
        from colmap_ihe.machine.cluster.executor import ClusterExecutor, local_workers
    except ImportError as error:
        raise CapabilityError(
            f"a cluster needs Dask: {error}", hint="in the clone of colmap-ihe: pip install '.[cluster]'"
        ) from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # our own messages say what matters of it
    end_old_leases(records, progress)
    with ExitStack() as stack:
        with progress.stage("cluster") as stage_progress:
            records.mkdir(parents=True, exist_ok=True)
            if count:
                address = stack.enter_context(local_workers(count, records / "workers.log"))
            lease = new_lease(records)
            stack.callback(end_lease, lease, SILENT)
            terms = Terms(lease, tuple(needs), environment())
            connect = partial(_client, address, min(_CONNECT_SECONDS, options.patience))
            try:
                executor = ClusterExecutor(connect, terms, options.patience, progress.warn)
            except (OSError, ValueError, ImportError) as error:
                raise ClusterError(
                    f"{options.address}: no scheduler answers there ({_first_line(error)})",
                    hint="start one with `dask scheduler`; see docs/cluster.md",
                ) from error
            stack.callback(executor.close)
            _await_workers(executor.client, count or 1, options, stage_progress)
            _check_workers(executor.client, terms)
        yield executor


def local_count(address: str) -> int:
    """Return N of `local:N`, 0 for the address of a scheduler. Raises `OptionError`."""
    if not address.startswith("local"):
        return 0
    parts = re.fullmatch(r"local:([1-9]\d{0,3})", address)
    if parts is None:
        raise OptionError(
            f"cluster.address is {address!r}, expected local:N with a number of workers",
            hint="as local:4; or the address of a scheduler, as tcp://login1:8786",
        )
    return int(parts[1])


def _client(address: str, timeout: float) -> Client:
    from distributed import Client

    keyword = "scheduler_file" if address.endswith(".json") else "address"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of versions, which `Terms` compare
        return Client(**{keyword: address}, timeout=timeout, set_as_default=False, name="colmap-ihe")


def _await_workers(client: Client, count: int, options: ClusterOptions, progress: Progress) -> None:
    """Wait for `count` workers. Raises `ClusterError` when patience has ended."""
    progress.start(count, "workers")
    end, seen = time.monotonic() + options.patience, 0
    while seen < count:
        present = min(count, len(client.nthreads()))
        progress.advance(max(0, present - seen))
        seen = max(seen, present)
        if seen < count and time.monotonic() > end:
            raise ClusterError(
                f"{options.address}: {seen} workers came within {options.patience:.0f} s, expected {count}",
                hint="start workers with `dask worker ADDRESS`, or give them longer with cluster.patience",
            )
        progress.check()
        time.sleep(_POLL_SECONDS)


def _check_workers(client: Client, terms: Terms) -> None:
    """Raise `ClusterError` for the first worker that does not keep the terms."""
    for worker, error in client.run(check_terms, terms, on_error="return").items():
        if isinstance(error, ClusterError):
            raise error
        if isinstance(error, BaseException):
            raise ClusterError(f"worker {worker}: {_first_line(error)}", hint=SAME_ENVIRONMENT) from error


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__
