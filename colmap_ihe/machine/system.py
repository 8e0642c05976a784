"""Ask the operating system for what not every one has. Each function says what happens where it has not.

Nothing else in the package imports a module, or calls a function, that only some systems have.
"""

from __future__ import annotations

import ctypes
import hashlib
import mmap
import os
import socket
import struct
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import reduction
from pathlib import Path
from typing import Any


def _module(name: str) -> Any:
    """Return a module of the standard library, None where this system has none of that name."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        return None


fcntl, resource, msvcrt = _module("fcntl"), _module("resource"), _module("msvcrt")

AT_ONCE = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Flags of os.open: never wait for the other end of a pipe, and read bytes as they are."""
SENDS_MEMORY = hasattr(os, "memfd_create")
"""Whether a process can send another one memory that has no name; else they share a file."""
SHARES_LOCKS = fcntl is not None
"""Whether several processes can hold a lock that keeps out others."""
_TEMPORARY = getattr(os, "O_TEMPORARY", 0) | getattr(os, "O_SHORT_LIVED", 0) | getattr(os, "O_BINARY", 0)
KILLED = 9
"""SIGKILL, on systems that have it."""
PROC = Path("/proc")
_FOLDER = getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_NOFOLLOW", 0)
_SEALABLE = getattr(os, "MFD_CLOEXEC", 0) | getattr(os, "MFD_ALLOW_SEALING", 0)
_LOCKED_AT = 1 << 40  # of a file that Windows locks: no byte that anybody reads


def has_lock(descriptor: int, shared: bool = False) -> bool:
    """Lock an open file until it is closed, if that can be done at once; tell whether. Windows has no shared locks:
    each is one process's there. Raises OSError."""
    if fcntl is not None:
        try:
            fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
    os.lseek(descriptor, _LOCKED_AT, os.SEEK_SET)
    try:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    except PermissionError:
        return False
    return True


def open_to_lock(folder: Path) -> int:
    """Return a descriptor by which this folder, and no link to one, is locked: its own, or where folders cannot be
    opened, that of a file in the system's folder for temporary files. Raises OSError."""
    if _FOLDER:
        return os.open(folder, os.O_RDONLY | _FOLDER)
    digest = hashlib.blake2b(os.path.normcase(os.path.realpath(folder)).encode(), digest_size=12).hexdigest()
    file = Path(tempfile.gettempdir()) / f"colmap-ihe-lock-{digest}"
    return os.open(file, os.O_RDWR | os.O_CREAT | _TEMPORARY, 0o600)


def anonymous_file() -> int:
    """Return the descriptor of a file in memory, or where the system has none, of one on disk that goes with the last
    process that has it open. Raises OSError."""
    if hasattr(os, "memfd_create"):
        return int(os.memfd_create("colmap-ihe", _SEALABLE))
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def open_shared(path: Path, new: bool = False) -> int:
    """Return the descriptor of a file that two processes map, which Windows removes with the last of them. Raises
    OSError."""
    return os.open(path, os.O_RDWR | _TEMPORARY | (os.O_CREAT | os.O_EXCL if new else 0), 0o600)


def send_file(channel: Any, descriptor: int) -> None:
    """Send an open file through a channel between processes, where the system `SENDS_MEMORY`. Raises OSError."""
    reduction.send_handle(channel, descriptor, 0)


def receive_file(channel: Any) -> int:
    """Return the descriptor of the file that comes next through a channel. Raises OSError, EOFError, and ValueError if
    another thing comes, or a file that this process is not allowed to open."""
    try:
        return reduction.recv_handle(channel)
    except (RuntimeError, AssertionError) as error:
        raise ValueError(f"no file came: {error}") from error


def seal(descriptor: int) -> None:
    """Let a file in memory never shrink: reading from what is gone would end this process with SIGBUS. Raises
    OSError."""
    if hasattr(fcntl, "F_ADD_SEALS"):
        fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)


def give_back(mapped: mmap.mmap) -> None:
    """Let the system have the memory of a shared mapping until it is used again. Only Linux does it."""
    if hasattr(mapped, "madvise") and hasattr(mmap, "MADV_REMOVE"):
        mapped.madvise(mmap.MADV_REMOVE)


def cores() -> int:
    """Return the number of cores that this process may use, or where the system does not say, of the machine."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def is_of_another_user(path: Path) -> bool:
    """Tell whether a folder, or the link at its place, is another user's. Windows gives each user a folder of his own
    for temporary files. Raises OSError."""
    return hasattr(os, "getuid") and path.lstat().st_uid != os.getuid()


def bound_reads(descriptor: int, seconds: float) -> None:
    """Let no read of a socket wait longer, which is a BlockingIOError then. What is no socket, as the pipes of
    Windows, gives a message at once or not at all."""
    if hasattr(socket, "AF_UNIX"):
        with socket.socket(fileno=os.dup(descriptor)) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("ll", int(seconds), 0))


def kill(process: int) -> None:
    """Kill a process that leads a session of its own with all in it; where there are no sessions, with its children
    and theirs."""
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):
            os.killpg(process, KILLED)
        return
    import psutil

    with suppress(psutil.Error):
        parent = psutil.Process(process)
        for child in (*parent.children(recursive=True), parent):
            with suppress(psutil.Error):
                child.kill()


def offer_to_be_killed(score: int) -> None:
    """Have Linux end this process rather than others when memory runs out, by 0 to 1000 points."""
    with suppress(OSError):
        (PROC / "self/oom_score_adj").write_text(str(score), encoding="ascii")


def machine_memory() -> tuple[int, int]:
    """Return the bytes of this machine's memory, and of them those that are free, by psutil; 0 if it does not say."""
    import psutil

    with suppress(psutil.Error, OSError, RuntimeError):
        memory = psutil.virtual_memory()
        return int(memory.total), int(memory.available)
    return 0, 0


def taken_memory(process: int | None) -> tuple[int, int]:
    """Return the bytes of memory that a process, None for this one, holds, and the most that it held or what it holds
    where only that is known; by psutil, 0 if it does not say."""
    import psutil

    with suppress(psutil.Error, OSError):
        sizes = psutil.Process(process).memory_info()
        return sizes.rss, getattr(sizes, "peak_wset", sizes.rss)
    return 0, 0


def most_of_children() -> int:
    """Return the most bytes of memory that one of the processes held which this one started and which have ended; 0
    where the system does not say. Linux counts in kilobytes, macOS in bytes."""
    if resource is None:
        return 0
    most = int(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
    return most if sys.platform == "darwin" else 1024 * most


def limits() -> dict[str, int]:
    """Return the bytes that this process is limited to (`ulimit -v` and `-d`), by Linux's name of what is used."""
    if resource is None:
        return {}
    soft = {
        "VmSize": resource.getrlimit(resource.RLIMIT_AS)[0],
        "VmData": resource.getrlimit(resource.RLIMIT_DATA)[0],
    }
    return {name: size for name, size in soft.items() if size != resource.RLIM_INFINITY}


@contextmanager
def data_limited(size: int) -> Iterator[None]:
    """Within, let this process take `size` more bytes; further ones are a MemoryError, or a native library's. Only
    Linux keeps to it."""
    try:
        held = int((PROC / "self/statm").read_bytes().split()[5]) * resource.getpagesize()
    except (OSError, ValueError, IndexError, AttributeError):
        yield
        return
    before, hard = resource.getrlimit(resource.RLIMIT_DATA)
    soft = held + size if before == resource.RLIM_INFINITY else min(held + size, before)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, hard))


def mallopt(option: int, value: int) -> None:
    """Set an option of glibc's malloc, as malloc.h has them; other C libraries have none."""
    with suppress(OSError, AttributeError, TypeError):  # on Windows CDLL(None) is a TypeError
        ctypes.CDLL(None).mallopt(option, value)
