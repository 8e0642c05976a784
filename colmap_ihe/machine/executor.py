"""Work on one image at a time, on any `concurrent.futures.Executor`, with a bound on what is in flight.

Threads share our memory; the workers of any other executor may be anywhere: what they are given and return is
pickled, so it is a function of a module, or `partial` of one, and plain values and paths.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from threading import Event
from typing import TypeVar

from colmap_ihe.errors import Cancelled
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.machine.progress import SILENT, Progress, Silent, stoppable, stopped
from colmap_ihe.machine.threads import local_workers, one_blas_thread

_TICK_SECONDS = 0.2  # how long Ctrl-C may take to be noticed while a photograph is worked on

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@contextmanager
def local_executor() -> Iterator[ThreadPoolExecutor]:
    """Give one thread a core. Threads, for photographs are decoded and counted in processes anyway."""
    try:
        with ThreadPoolExecutor(local_workers(), thread_name_prefix="image") as executor:
            yield executor
    finally:
        decoders.release_memory()


def shares_memory(executor: Executor) -> bool:
    """Tell whether its workers are threads of this process."""
    return isinstance(executor, ThreadPoolExecutor)


def width_of(executor: Executor) -> int:
    """Return how many tasks an executor works on at a time; for those that do not say, as many as there are cores."""
    width: int = getattr(executor, "width", 0)
    return width or local_workers()


@contextmanager
def threads_of(executor: Executor) -> Iterator[Executor]:
    """Give threads of this process, the executor's own if it has such, for results too large to be sent."""
    with one_blas_thread():
        if shares_memory(executor):
            yield executor
        else:
            with local_executor() as own:
                yield own


class TaskProgress(Silent):
    """Follow what a worker does: raise `Cancelled` as soon as its result is no longer needed."""

    def check(self) -> None:
        if stopped():
            raise Cancelled


def in_order(
    executor: Executor,
    function: Callable[[_Item], _Result],
    items: Iterable[_Item],
    at_once: int | None = None,
    progress: Progress = SILENT,
) -> Generator[_Result, None, None]:
    """Yield `function` of every item, in order. Keeps at most `workers + 1` results in memory, and at most `at_once`
    begun and not yet fetched. What `function` raises is raised here, and so is `Cancelled` by `progress`, after what
    is in flight has ended; reads of photographs end at once then. Where workers are not threads, two results a worker
    wait, for it takes time to send another."""
    local, over = shares_memory(executor), Event()

    def until_over(item: _Item) -> _Result:
        with stoppable(over):
            return function(item)

    work = until_over if local else function
    waiting: deque[Future[_Result]] = deque()
    try:
        for item in items:
            waiting.append(executor.submit(work, item))
            # asked each time: workers of a cluster come and go
            if len(waiting) >= (at_once or (width_of(executor) + 1 if local else 2 * width_of(executor))):
                yield _fetched(waiting, progress)
        while waiting:
            yield _fetched(waiting, progress)
    finally:
        over.set()
        for future in waiting:
            future.cancel()
        for future in waiting:
            if not future.cancelled():
                future.exception()


def _fetched(waiting: deque[Future[_Result]], progress: Progress) -> _Result:
    while not wait([waiting[0]], _TICK_SECONDS).done:
        progress.check()
    return waiting.popleft().result()
