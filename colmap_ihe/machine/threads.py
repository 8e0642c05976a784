"""Limits on the threads that a run computes with: its own, and those of the libraries under it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import cv2
from threadpoolctl import LibController, ThreadpoolController

from colmap_ihe.machine.system import cores as cores

_ENVIRONMENT = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_limits: list[int] = []
_sharing: list[None] = []
_lock = threading.Lock()


def limit() -> int | None:
    """Return the most threads that may compute now, None without a limit."""
    return min(_limits, default=None)


def local_workers() -> int:
    """Return how many cores this process may use, or as many of them as a run is limited to."""
    return min(cores(), limit() or cores())


@contextmanager
def limited(most: int | None) -> Iterator[None]:
    """Limit the threads of this package, OpenCV and BLAS to `most`, in all of this process; None limits nothing.
    Nested limits: the smallest wins. COLMAP's threads are for `native` to limit."""
    if most is None:
        yield
        return
    with _lock:
        _limits.append(most)
        _tell_libraries()
    try:
        yield
    finally:
        with _lock:
            _limits.remove(most)
            _tell_libraries()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Have BLAS compute with one thread, in all of this process, while several threads of it work: its own would wait
    for cores that those have, for ten times as long as small products take."""
    with _lock:
        _sharing.append(None)
        _tell_libraries()
    try:
        yield
    finally:
        with _lock:
            _sharing.pop()
            _tell_libraries()


@contextmanager
def limit_openmp_of_this_thread() -> Iterator[None]:
    """Limit OpenMP, which counts its threads by the thread that calls into a library, for this thread."""
    most = limit()
    if most is None:
        yield
        return
    with _pools().select(user_api="openmp").limit(limits=most):
        yield


def environment(most: int | None = None) -> dict[str, str]:
    """Return environment variables that limit the libraries of a process to `most` threads, or to those of a run."""
    most = most or limit()
    return {} if most is None else dict.fromkeys(_ENVIRONMENT, str(most))


@cache
def _pools() -> ThreadpoolController:
    return ThreadpoolController()


@cache
def _usual() -> tuple[int, ...]:
    return (cv2.getNumThreads(), *(pool.num_threads for pool in _blas()))


def _blas() -> list[LibController]:
    return list(_pools().select(user_api="blas").lib_controllers)


def _tell_libraries() -> None:
    usual, most = _usual(), limit()
    counts = [count if most is None else min(count, most) for count in usual]
    cv2.setNumThreads(counts[0])
    for pool, count in zip(_blas(), counts[1:], strict=True):
        pool.set_num_threads(1 if _sharing else count)


def blas_libraries() -> list[str]:
    """Return the libraries for linear algebra, each with the kind of processor that it takes this one for."""
    infos = [pool.info() for pool in _blas()]
    return sorted(f"{i['prefix']} {i['version']} {i.get('architecture', '')}".strip() for i in infos)
