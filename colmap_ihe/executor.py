"""Work on one image at a time, on any `concurrent.futures.Executor`, with a bound on what is in flight."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

from colmap_ihe.captures import decoders
from colmap_ihe.progress import SILENT, Watch

_TICK_SECONDS = 0.2  # how long Ctrl-C may take to be noticed while a photograph is worked on

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def local_workers() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def local_executor() -> Iterator[ThreadPoolExecutor]:
    """One thread a core. Threads, for photographs are decoded and counted in processes anyway."""
    try:
        with ThreadPoolExecutor(local_workers(), thread_name_prefix="image") as executor:
            yield executor
    finally:
        decoders.relax()


def in_order(
    executor: Executor,
    function: Callable[[_Item], _Result],
    items: Iterable[_Item],
    at_once: int | None = None,
    watch: Watch = SILENT,
) -> Iterator[_Result]:
    """`function` of every item, in order; no more results wait than there are workers and one, so memory does
    not grow with the set, and never more than `at_once` are begun and not yet fetched. What `function` raises
    is raised here, and so is `Cancelled` by `watch`, after what is in flight has ended; reads of photographs end
    at once then, those of this process. For an executor of processes `function` has to be one that can be
    pickled."""
    most = at_once or local_workers() + 1
    over = decoders.Stop()
    run = partial(_run, function, over)
    waiting: deque[Future[_Result]] = deque()
    try:
        for item in items:
            waiting.append(executor.submit(run, item))
            if len(waiting) >= most:
                yield _fetched(waiting, watch)
        while waiting:
            yield _fetched(waiting, watch)
    finally:
        over.set()
        for future in waiting:
            future.cancel()
        for future in waiting:
            if not future.cancelled():
                future.exception()


def _run(function: Callable[[_Item], _Result], over: decoders.Stop, item: _Item) -> _Result:
    with decoders.stoppable(over):
        return function(item)


def _fetched(waiting: deque[Future[_Result]], watch: Watch) -> _Result:
    while not wait([waiting[0]], _TICK_SECONDS).done:
        watch.check()
    return waiting.popleft().result()
