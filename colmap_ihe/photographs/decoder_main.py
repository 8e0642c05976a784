"""Program of a decoder: it answers one question at a time about a photograph. `machine.decoder_pool` starts it."""

from __future__ import annotations

import fcntl
import os
import resource
import socket
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
from numpy.typing import NDArray

from colmap_ihe.errors import KnownError
from colmap_ihe.machine import decoder_wire
from colmap_ihe.machine.child_process import die_with_parent
from colmap_ihe.machine.decoder_process import BROKEN
from colmap_ihe.machine.decoder_wire import (
    Message,
    SharedArrayWriter,
    call_from_plain,
    receive,
    send,
    to_plain,
)
from colmap_ihe.photographs import colour_counts
from colmap_ihe.photographs.exif import metadata  # noqa: F401  so that no question waits for its import

_STDERR = 2
_COUNTING = (colour_counts.count_photograph, colour_counts.hand_over_counts)


def main() -> None:
    """Answer on the socket whose number is the first argument, until its other end is closed."""
    warnings.simplefilter("ignore")  # of broken photographs, which we name ourselves
    cv2.setNumThreads(1)
    fcntl.fcntl(_STDERR, fcntl.F_SETFL, fcntl.fcntl(_STDERR, fcntl.F_GETFL) | os.O_APPEND)
    with suppress(OSError):  # if memory runs out after all, then a decoder goes and not the run
        Path("/proc/self/oom_score_adj").write_text("900", encoding="ascii")
    die_with_parent()
    decoder_wire.answer_memory = memory = SharedArrayWriter()
    with socket.socket(fileno=int(sys.argv[1])) as sock, suppress(ConnectionError):
        send(sock, {"ready": True})
        while (received := receive(sock)) is not None:
            _answer(sock, received[0], memory)


def _answer(sock: socket.socket, request: Message, memory: SharedArrayWriter) -> None:
    os.ftruncate(_STDERR, 0)
    if not request["free"]:  # what was sent before is still in use
        memory.leave()
    answer: Message
    fd = None
    try:
        function, arguments = call_from_plain(request)
        if function not in _COUNTING:
            colour_counts.free_counter()
        with _memory_limit(request["memory"]):
            arrays: list[NDArray[Any]] = []
            answer = {"value": to_plain(function(*arguments), arrays)}
            if arrays:
                about, fd = memory.put(arrays)
                answer |= about
    except KnownError as error:
        answer = {"error": type(error).__name__, "message": str(error), "hint": error.hint}
    except MemoryError:
        message = f"{request['name']}: not enough memory to decode it"
        answer = {"error": "PhotographError", "message": message, "hint": "free memory, or take it out"}
    except Exception as error:  # noqa: BLE001  whatever a broken file brings a decoder to raise is about that file
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        answer = {
            "error": "PhotographError",
            "message": f"{request['name']}: cannot be read ({reason})",
            "hint": BROKEN,
            "traceback": traceback.format_exc(),
        }
    send(sock, answer, fd)
    if fd is not None:
        memory.sent()


@contextmanager
def _memory_limit(size: int) -> Iterator[None]:
    """Within, let this process take `size` more bytes; further ones are a MemoryError, or a native decoder's."""
    held = _data_bytes()
    if held is None:
        yield
        return
    before, hard = resource.getrlimit(resource.RLIMIT_DATA)
    soft = held + size if before == resource.RLIM_INFINITY else min(held + size, before)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (before, hard))


def _data_bytes() -> int | None:
    """Return the bytes that count for RLIMIT_DATA, which only Linux keeps to."""
    try:
        pages = int(Path("/proc/self/statm").read_bytes().split()[5])
    except (OSError, ValueError, IndexError):
        return None
    return pages * resource.getpagesize()
