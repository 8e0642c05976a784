"""What goes between a run and its decoders: JSON with its length in front, and arrays in memory that both share.

Nothing is unpickled: a decoder that a hostile photograph took over can answer nonsense, but run nothing here.
"""

from __future__ import annotations

import base64
import fcntl
import json
import math
import mmap
import numbers
import os
import socket
import struct
import tempfile
import weakref
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

Message = dict[str, Any]

_LENGTH = struct.Struct(">I")
_MOST_BYTES = 1 << 28  # of one message, whose largest parts are EXIF and a colour profile
_MOST_MAPPED = 64  # arrays, each with an open file that Python keeps for its memory
_mapped: list[weakref.ref[NDArray[np.uint8]]] = []
_DTYPES = {"uint8": np.uint8, "uint16": np.uint16}


def send(sock: socket.socket, message: Message, fd: int | None = None) -> None:
    """Sends a message, and with it the file of a shared array. Raises OSError."""
    body = json.dumps(message, default=_plain).encode()
    packed = memoryview(_LENGTH.pack(len(body)) + body)
    sent = socket.send_fds(sock, [packed], [] if fd is None else [fd])
    sock.sendall(packed[sent:])


def receive(sock: socket.socket) -> tuple[Message, int | None] | None:
    """The next message, and the file that came with it, which is the caller's to close; None if the other end
    is gone. Raises OSError, ValueError for what is no message."""
    head, fds, _, _ = socket.recv_fds(sock, _LENGTH.size, 1)
    try:
        (length,) = _LENGTH.unpack(head + _exactly(sock, _LENGTH.size - len(head)))
        if length > _MOST_BYTES:
            raise ValueError(f"a message of {length} bytes, expected {_MOST_BYTES} at most")
        message = _message(_exactly(sock, length))
        if not isinstance(message, dict):
            raise ValueError(f"a message that is a {type(message).__name__}, expected an object")
    except BaseException as error:
        for fd in fds:
            os.close(fd)
        if isinstance(error, EOFError):
            return None
        raise
    return message, fds[0] if fds else None


def _message(body: bytes) -> Any:
    try:
        return json.loads(body, object_hook=_unplain)
    except (TypeError, RecursionError) as error:
        raise ValueError(f"a message that is none: {error}") from error


def _exactly(sock: socket.socket, count: int) -> bytes:
    parts = bytearray()
    while len(parts) < count:
        part = sock.recv(min(count - len(parts), 1 << 20))
        if not part:
            raise EOFError
        parts += part
    return bytes(parts)


def _plain(value: object) -> object:
    if isinstance(value, bytes):
        return {"base64": base64.b64encode(value).decode("ascii")}
    if isinstance(value, numbers.Rational):  # Pillow's, in EXIF
        return float(value)
    raise TypeError(f"{type(value).__name__}, expected what JSON holds, or bytes")


def _unplain(value: dict[str, Any]) -> Any:
    return base64.b64decode(value["base64"]) if set(value) == {"base64"} else value


class SharedArrayWriter:
    """A decoder's side of the memory for one array, without a name in any file system. It is used again while
    the array before is no longer wanted, for making pages takes as long as decoding into them."""

    def __init__(self) -> None:
        self._fd: int | None = None  # until it was sent
        self._memory: mmap.mmap | None = None

    def array(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """An array that lies in it, with anything in it; takes the place of the one before."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if self._memory is None or len(self._memory) < size:
            self.leave()
            self._fd = anonymous_file()
            os.ftruncate(self._fd, size)
            self._memory = mmap.mmap(self._fd, size)
        return np.frombuffer(self._memory, dtype, math.prod(shape)).reshape(shape)

    def put(self, array: NDArray[Any]) -> tuple[Message, int | None]:
        """Shape and kind of an array, which is copied into the room unless it lies there; and the room's file if
        the other side does not have it yet, to be sent before `sent`."""
        inside = self.array(array.shape, array.dtype)
        if array.__array_interface__["data"] != inside.__array_interface__["data"]:
            inside[...] = array
        is_new = self._fd is not None
        return {"shape": list(array.shape), "dtype": str(array.dtype), "is_new": is_new}, self._fd

    def sent(self) -> None:
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

    def leave(self) -> None:
        """Leaves the memory to the other side."""
        self.sent()
        self._memory = None


class SharedArrayReader:
    """The other side of a `SharedArrayWriter`: arrays that are mapped and not copied, unless very many are held."""

    def __init__(self) -> None:
        self._memory: mmap.mmap | None = None
        self._array: weakref.ref[NDArray[np.uint8]] | None = None  # on whose memory every view is

    @property
    def is_free(self) -> bool:
        """Whether no view is left of the last array, so that another may take its place."""
        return self._array is None or self._array() is None

    def array(self, about: Message, fd: int | None) -> NDArray[Any]:
        """The array that `Room.put` told of; closes `fd`. Raises ValueError or KeyError if the memory is not what
        the message says."""
        if fd is not None:
            try:
                if hasattr(fcntl, "F_ADD_SEALS") and hasattr(os, "memfd_create"):
                    # Were it to shrink, reading from it would end this process with SIGBUS.
                    fcntl.fcntl(fd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
                self._memory = mmap.mmap(fd, os.fstat(fd).st_size)
            finally:
                os.close(fd)
        if about["is_new"] != (fd is not None):  # a process that has no room for another open file gets none
            raise ValueError("the file of an array was lost on the way")
        shape, dtype = tuple(int(n) for n in about["shape"]), np.dtype(_DTYPES[about["dtype"]])
        size = math.prod(shape) * dtype.itemsize
        if self._memory is None or min(shape) < 1 or len(self._memory) < size:
            raise ValueError(f"{shape=} {dtype=} in {len(self._memory or b'')} bytes")
        whole = np.frombuffer(self._memory, np.uint8, size)
        found = whole.view(dtype).reshape(shape)
        _mapped[:] = [array for array in _mapped if array() is not None]
        if len(_mapped) >= _MOST_MAPPED:
            return found.copy()
        self._array = weakref.ref(whole)
        _mapped.append(self._array)
        return found

    def empty(self) -> None:
        """Gives the memory back to the system until it is used again, if it is free."""
        if self.is_free and self._memory is not None and hasattr(mmap, "MADV_REMOVE"):
            self._memory.madvise(mmap.MADV_REMOVE)


def anonymous_file() -> int:
    """A file in memory, or where the system has none, one on disk without a name."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create("colmap-ihe", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())
