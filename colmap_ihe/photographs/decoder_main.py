"""What runs in a decoder: it answers one question at a time about a photograph. `decoders` starts it."""

from __future__ import annotations

import fcntl
import os
import re
import resource
import socket
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import KnownError, PhotographError
from colmap_ihe.machine.decoder_wire import Message, SharedArrayWriter, receive, send
from colmap_ihe.photographs import decode
from colmap_ihe.photographs import developed_cache as keep
from colmap_ihe.photographs import preview as small
from colmap_ihe.photographs.colour_counts import ColourCounter
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.exif import metadata
from colmap_ihe.photographs.raw import develop as raw
from colmap_ihe.project.recipe import recipe_from_dict

_STDERR = 2
_DAMAGED = re.compile(r"data corrupted at|unexpected end of file", re.IGNORECASE)
"""What LibRaw says of damaged data, and does not always raise."""

_Answer = tuple[Any, NDArray[Any] | None]


class _Desk:
    """What a decoder keeps from one question to the next: memory for a photograph, and what it counted."""

    def __init__(self) -> None:
        self.room = SharedArrayWriter()
        self.tally: ColourCounter | None = (
            None  # used again once it is handed over: making its pages takes long
        )


def _read(desk: _Desk, capture: Message) -> decode.DecodedPhotograph:
    """Developed as its recipe says, or found developed where its recipe keeps it."""
    one = _capture(capture)
    file = keep.kept_file(one)
    found = keep.load(file) if file else None
    if found is None:
        found = decode.read_photograph_here(one, desk.room.array)
        _refuse_damaged(one.name)
        if file:
            keep.store(file, found)
    return found


def _count(
    desk: _Desk, *, capture: Message, first: bool, contrast: bool, returned: bool, **how: Any
) -> _Answer:
    """Adds the photograph to the tally, an empty one if it is the `first`."""
    if desk.tally is None or (first and not desk.tally.may_begin(**how)):
        desk.tally = ColourCounter(**how)
    found = _read(desk, capture)
    measured = desk.tally.add(found.rgb, contrast)
    return None if measured is None else measured.as_dict(), found.rgb if returned else None


def _tally(desk: _Desk) -> _Answer:
    """Hands over what the tally holds."""
    if desk.tally is None:
        raise ValueError("nothing was counted")
    sums = desk.tally.handed_over()
    return sums.head(), np.frombuffer(sums.cells, np.uint8)


def _photograph(desk: _Desk, *, capture: Message) -> _Answer:
    found = _read(desk, capture)
    matrix = found.srgb_from_camera
    about = {
        "encoding": found.encoding,
        "matrix": None if matrix is None else matrix.tolist(),
        "profile": found.profile,
    }
    return about, found.rgb


def _size(_desk: _Desk, *, capture: Message) -> _Answer:
    return decode.read_size_here(_capture(capture)), None


def _small(_desk: _Desk, *, capture: Message, side: int) -> _Answer:
    return None, small.small_picture_here(_capture(capture), side)


def _metadata(_desk: _Desk, *, path: str, kind: str) -> _Answer:
    found = metadata.read_metadata_here(Path(path), kind)
    return {f.name: getattr(found, f.name) for f in fields(found)}, None


def _header(_desk: _Desk, *, path: str) -> _Answer:
    found = raw.read_header(Path(path))
    return [found.width, found.height, found.sensor], None


def _mosaic(_desk: _Desk, *, path: str) -> _Answer:
    found = raw.read_mosaic(Path(path))
    varies = found.black.shape == found.values.shape
    about = {
        "pattern": found.pattern.tolist(),
        "black": None if varies else found.black.tolist(),
        "white": found.white,
    }
    return about, found.values


def _black(_desk: _Desk, *, path: str) -> _Answer:
    return None, raw.read_mosaic(Path(path)).black


def _bad_pixels(_desk: _Desk, *, path: str) -> _Answer:
    return raw.bad_pixel_candidates(Path(path)).tolist(), None


TASKS: Mapping[str, Callable[..., _Answer]] = {
    "count": _count,
    "tally": _tally,
    "photograph": _photograph,
    "size": _size,
    "small": _small,
    "metadata": _metadata,
    "header": _header,
    "mosaic": _mosaic,
    "black": _black,
    "bad pixels": _bad_pixels,
}
_COUNTING = ("count", "tally")  # between others the tally's memory is given back


def _capture(values: Message) -> Capture:
    return Capture(
        **values | {"path": Path(values["path"]), "recipe": recipe_from_dict(values["recipe"])},
    )


def main() -> None:
    """Answers on the socket whose number is the first argument, until its other end is closed, or that of the socket
    whose number is the second."""
    warnings.simplefilter("ignore")  # of broken photographs, which we name ourselves
    cv2.setNumThreads(1)
    fcntl.fcntl(_STDERR, fcntl.F_SETFL, fcntl.fcntl(_STDERR, fcntl.F_GETFL) | os.O_APPEND)
    with suppress(OSError):  # if memory runs out after all, then a decoder goes and not the run
        Path("/proc/self/oom_score_adj").write_text("900", encoding="ascii")
    _die_with(int(sys.argv[2]))
    with socket.socket(fileno=int(sys.argv[1])) as sock, suppress(ConnectionError):
        send(sock, {"ready": True})
        desk = _Desk()
        while (received := receive(sock)) is not None:
            _answer(sock, received[0], desk)


def _answer(sock: socket.socket, request: Message, desk: _Desk) -> None:
    room = desk.room
    os.ftruncate(_STDERR, 0)
    if not request["free"]:  # what was sent before is still in use
        room.leave()
    if request["task"] not in _COUNTING:
        desk.tally = None
    answer: Message
    fd = None
    try:
        with _memory_limit(request["memory"]):
            value, array = TASKS[request["task"]](desk, **request["arguments"])
            answer = {"value": value}
            if array is not None:
                _refuse_damaged(request["name"])
                answer["array"], fd = room.put(array)
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
            "hint": "copy it from the card again, or take it out of the folder",
            "traceback": traceback.format_exc(),
        }
    send(sock, answer, fd)
    if fd is not None:
        room.sent()


def _refuse_damaged(name: str) -> None:
    if _DAMAGED.search(os.pread(_STDERR, 1 << 16, 0).decode("utf-8", "replace")):
        raise PhotographError(
            f"{name}: LibRaw found damaged data in it",
            hint="copy it from the card again, or take it out of the folder",
        )


def _die_with(lifeline: int) -> None:
    """The closing of its other end ends this process at once, be it deep in a native loop: by SIGIO, which would come
    of what is sent as well, and late, so nothing ever is."""
    if hasattr(fcntl, "F_SETOWN"):
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | fcntl.FASYNC)


@contextmanager
def _memory_limit(size: int) -> Iterator[None]:
    """Within, this process may take so many more bytes; further ones are a MemoryError, or a native decoder's."""
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
    """What counts for RLIMIT_DATA, which only Linux keeps to."""
    try:
        pages = int(Path("/proc/self/statm").read_bytes().split()[5])
    except (OSError, ValueError, IndexError):
        return None
    return pages * resource.getpagesize()
