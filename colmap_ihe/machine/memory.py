"""Memory that is free, and the number of photographs that may be worked on at a time within it."""

from __future__ import annotations

import ctypes
import errno
import logging
import os
import re
import resource
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Protocol

from colmap_ihe.errors import ShortOfMemoryError

logger = logging.getLogger(__name__)

_PROC, _CGROUP = Path("/proc"), Path("/sys/fs/cgroup")
_KEPT_FREE = 0.1  # of what is available, for all else
_UNLIMITED = 1 << 60  # cgroup v1 says "no limit" by a number near 2^63
_SIZE = re.compile(r"^(\w+):\s*(\d+) kB$", re.MULTILINE)
_LIMITS = {
    resource.RLIMIT_AS: "VmSize",
    resource.RLIMIT_DATA: "VmData",
}  # and what the system calls what is used
_RESERVED = 150_000_000  # bytes of addresses that are never used: stacks of threads that libraries start
_SPARING = {"MALLOC_ARENA_MAX": "1", "OPENBLAS_NUM_THREADS": "1"}
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt, as malloc.h has them
_KEPT = 1 << 26  # bytes of a heap: as far as glibc goes by itself, once an array of half of that was freed
_SHORT = ("std::bad_alloc", "Insufficient memory", "can't start new thread", "Cannot allocate memory")
RAW_BYTES, JPEG_BYTES, OTHER_BYTES = 60, 30, 50
"""A pixel, decoder and run together, at the most: LibRaw's mosaic and channels, CMYK, or 16 bits on their way to
8; then the photograph, and what is made from it. Measured, with some to spare: docs/decisions/0008."""


class _Photograph(Protocol):
    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def pixels(self) -> int: ...


_share = 0


def keep_within(share: int) -> None:
    """Limit this process to `share` bytes in all, since others run beside it; 0 for no limit."""
    global _share  # noqa: PLW0603  of the process, as memory is
    _share = share


def available() -> int:
    """Return the bytes that this process may still take: of the machine, of its container where that has fewer, within
    its own limits (`ulimit -v` and `-d`), or of its own share. 0 if the system does not say."""
    machine = _sizes("meminfo").get("MemAvailable")
    rooms = [*([] if machine is None else [machine]), *_cgroup_rooms(), *_limit_rooms()]
    if _share:
        rooms.append(_share - taken("self")[0])
    return max(1, min(rooms)) if rooms else 0


def taken(process: int | str) -> tuple[int, int]:
    """Return the bytes of memory that a process holds, and the most that it held; 0 if the system does not say."""
    sizes = _sizes(f"{process}/status")
    return (sizes["VmRSS"], sizes["VmHWM"]) if {"VmRSS", "VmHWM"} <= sizes.keys() else (0, 0)


def most_taken() -> int:
    """Return the most bytes that this process, or one that it started and that has ended, held; 0 if the system does
    not say."""
    own = taken("self")[1]
    return max(own, 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) if own else 0


def begin_sparing() -> None:
    """Begin this process anew as one that reserves little, where its address space or data are limited: else each
    thread has a heap of 64 MB, and each core a part of BLAS, from the loading of libraries on."""
    missing = {name: value for name, value in _SPARING.items() if name not in os.environ}
    if missing and any(_limit_of(kind) is not None for kind in _LIMITS):
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | missing)


@cache
def keep_freed() -> None:
    """Have glibc keep what this process frees for what it takes next. Else an array of megabytes goes back to the
    system at once, which makes and clears pages for the next one: a third of the time of writing a PNG."""
    with suppress(OSError, AttributeError):  # other C libraries
        libc = ctypes.CDLL(None)
        libc.mallopt(_MMAP_THRESHOLD, _KEPT // 2)
        libc.mallopt(_TRIM_THRESHOLD, _KEPT)


def needed(photographs: Sequence[_Photograph]) -> int:
    """Return the bytes for the photograph that takes most, 0 if nothing is known of any."""
    return max((p.pixels * _bytes_a_pixel(p) for p in photographs), default=0)


def _bytes_a_pixel(photograph: _Photograph) -> int:
    if photograph.kind == "raw":
        return RAW_BYTES
    return JPEG_BYTES if photograph.name.lower().endswith((".jpg", ".jpeg", ".jpe")) else OTHER_BYTES


def at_once(photographs: Sequence[_Photograph], workers: int) -> int:
    """Return how many of these may be worked on at a time: `workers`, or what memory allows, at least one."""
    return most_at_once(needed(photographs), available(), workers)


def most_at_once(need: int, room: int, workers: int) -> int:
    """Return how many of `workers` may take `need` bytes each out of `room`, at least one; all where either is 0."""
    if not need or not room:
        return workers
    return max(1, min(workers, int(room * (1 - _KEPT_FREE)) // need))


def workers_for(what: str, need: int, workers: int) -> int:
    """Return how many of `workers` there is memory for if each takes `need` bytes; log it where they are fewer."""
    room = available()
    count = most_at_once(need, room, workers)
    if count < workers:
        logger.info(
            "%s: %d of %d threads, for each takes up to %s of memory and %s are free",
            what,
            count,
            workers,
            in_bytes(need),
            in_bytes(room),
        )
    return count


@contextmanager
def said_when_short(what: str) -> Iterator[None]:
    """Turn what libraries raise where memory runs out while doing `what` into one `ShortOfMemoryError`."""
    free = available()
    try:
        yield
    except Exception as error:
        short = isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM)
        if not short and not any(words in str(error) for words in _SHORT):
            raise
        raise ShortOfMemoryError(
            f"{what}: memory ran out; {in_bytes(free)} were free when it began",
            hint="close other programs, allow more (ulimit -v), or set features.max_image_size or"
            " dense.max_image_size lower; the same command goes on from here",
        ) from error


def in_words(photographs: Sequence[_Photograph], count: int) -> str:
    """Tell how many at a time, and why, for the log."""
    words, need = f"{count} photographs at a time", needed(photographs)
    if need:
        words += f": the largest takes up to {in_bytes(need)} of memory while it is worked on"
        words += f", and {in_bytes(available())} are free"
    return words


def in_bytes(count: int) -> str:
    """Return a number of bytes in words."""
    return f"{count / 1e9:.1f} GB" if count >= 10**9 else f"{count / 1e6:.0f} MB"


def _sizes(file: str) -> dict[str, int]:
    """Return the bytes by name in a file below /proc, which has them in kB; empty if it cannot be read."""
    with suppress(OSError):
        text = (_PROC / file).read_text(encoding="utf-8", errors="replace")
        return {name: int(kilobytes) * 1024 for name, kilobytes in _SIZE.findall(text)}
    return {}


def _limit_rooms() -> Iterator[int]:
    """Yield the bytes that this process may still take within limits of its own."""
    sizes = _sizes("self/status")
    for kind, name in _LIMITS.items():
        most = _limit_of(kind)
        if most is not None and name in sizes:
            yield max(0, most - sizes[name] - _RESERVED)


def _limit_of(kind: int) -> int | None:
    soft, _ = resource.getrlimit(kind)
    return None if soft == resource.RLIM_INFINITY else soft


def _cgroup_rooms() -> Iterator[int]:
    """Yield the bytes that the groups of this process leave it, of both versions of cgroups, up to the root."""
    try:
        lines = (_PROC / "self/cgroup").read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return
    for line in lines:
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if not controllers:
            root, limit, usage = _CGROUP, "memory.max", "memory.current"
        elif "memory" in controllers.split(","):
            root, limit, usage = _CGROUP / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        inside = root / path.lstrip("/")
        for group in (inside, *inside.parents):
            if not group.is_relative_to(root):
                break
            most, used = _number(group / limit), _number(group / usage)
            if most is not None and used is not None and most < _UNLIMITED:
                yield max(0, most - used + _reclaimable(group / "memory.stat"))


def _number(file: Path) -> int | None:
    try:
        return int(file.read_text(encoding="ascii"))
    except (OSError, ValueError):  # there is none, or it says "max"
        return None


def _reclaimable(file: Path) -> int:
    """Return the bytes of file cache, which count as used and are given up when memory is needed."""
    try:
        values = dict(line.split(maxsplit=1) for line in file.read_text(encoding="ascii").splitlines())
        return int(values.get("total_inactive_file", values.get("inactive_file", 0)))
    except (OSError, ValueError):
        return 0
