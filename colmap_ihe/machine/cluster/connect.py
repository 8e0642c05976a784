"""From what the user says of a cluster to an executor: connected, its workers there and checked."""

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
from typing import TYPE_CHECKING, Any

from colmap_ihe.errors import CapabilityError, ClusterError, OptionError
from colmap_ihe.machine.cluster.lease import end_lease, end_old_leases, has_leases, new_lease
from colmap_ihe.machine.cluster.task import Terms, check_terms, environment
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT, Progress, RunProgress

if TYPE_CHECKING:
    from distributed import Client

    from colmap_ihe.machine.cluster.executor import ClusterExecutor
    from colmap_ihe.project.folder import Project
    from colmap_ihe.project.options import ClusterOptions

_CONNECT_SECONDS = 30.0
_POLL_SECONDS = 0.2


@contextmanager
def workers_for(
    options: ClusterOptions, project: Project, needs: Sequence[Path], progress: RunProgress
) -> Iterator[Executor]:
    """The executor for per-image work: threads here, or the workers of the cluster that `options` names.

    `needs`: paths besides the project's folder that every worker must see. Raises `ClusterError`,
    `CapabilityError` without Dask, `OptionError` for an address that is none, `Cancelled`.
    """
    if options.address is None:
        if has_leases(project.records):
            with progress.stage("cluster") as stage_progress:
                end_old_leases(project.records, stage_progress)
        with local_executor() as threads:
            yield threads
        return
    with connected(options, project.records, (project.root, *needs), progress) as executor:
        yield executor


@contextmanager
def connected(
    options: ClusterOptions, records: Path, needs: Sequence[Path], progress: RunProgress
) -> Iterator[ClusterExecutor]:
    """An executor over a cluster. `records`: a folder that all workers see, for its lease and log. When it is left,
    no task runs any more. Raises as `workers_for`."""
    address = options.address or ""
    count = local_count(address)
    try:
        from colmap_ihe.machine.cluster import local as workers
        from colmap_ihe.machine.cluster.executor import ClusterExecutor
    except ImportError as error:
        raise CapabilityError(
            f"a cluster needs Dask: {error}", hint="in the clone of colmap-ihe: pip install '.[cluster]'"
        ) from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters of it we say ourselves
    with ExitStack() as stack:
        with progress.stage("cluster") as stage_progress:
            records.mkdir(parents=True, exist_ok=True)
            end_old_leases(records, stage_progress)
            if count:
                address = stack.enter_context(workers.local_workers(count, records / "workers.log"))
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
            stack.callback(executor.shutdown, cancel_futures=True)
            _await_workers(executor, count or 1, options, stage_progress)
            _check_workers(executor.client, terms)
        yield executor


def local_count(address: str) -> int:
    """N of `local:N`, 0 for another address. Raises `OptionError`."""
    if not address.startswith("local"):
        return 0
    found = re.fullmatch(r"local:([1-9]\d{0,3})", address)
    if found is None:
        raise OptionError(
            f"cluster.address is {address!r}, wanted local:N with a number of workers",
            hint="as local:4; or the address of a scheduler, as tcp://login1:8786",
        )
    return int(found[1])


def _client(address: str, timeout: float) -> Client:
    from distributed import Client

    where: dict[str, Any] = {"address": address}
    if address.endswith(".json"):
        where = {"scheduler_file": address}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of versions, which we compare ourselves
        return Client(**where, timeout=timeout, set_as_default=False, name="colmap-ihe")


def _await_workers(
    executor: ClusterExecutor, count: int, options: ClusterOptions, progress: Progress
) -> None:
    """Until `count` workers are there, or one and patience is at its end."""
    progress.start(count, "workers")
    end, seen = time.monotonic() + options.patience, 0
    while seen < count:
        there = min(count, len(executor.client.nthreads()))
        progress.advance(max(0, there - seen))
        seen = max(seen, there)
        if seen < count and time.monotonic() > end:
            raise ClusterError(
                f"{options.address}: {seen} workers came within {options.patience:.0f} s, wanted {count}",
                hint="start workers with `dask worker ADDRESS`, or give them longer with cluster.patience",
            )
        progress.check()
        time.sleep(_POLL_SECONDS)


def _check_workers(client: Client, terms: Terms) -> None:
    """Raises `ClusterError` for the first worker that cannot keep the terms."""
    for worker, found in client.run(check_terms, terms, on_error="return").items():
        if isinstance(found, ClusterError):
            raise found
        if isinstance(found, BaseException):
            raise ClusterError(
                f"worker {worker}: {_first_line(found)}",
                hint="install the same environment on every worker; see docs/cluster.md",
            ) from found


def _first_line(error: BaseException) -> str:
    words = str(error).strip().splitlines()
    return words[0] if words else type(error).__name__
