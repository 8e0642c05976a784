"""Messages between a run and its decoders: JSON with its length in front, and arrays in memory that both share.

Nothing is pickled: a decoder that a hostile photograph took over can answer nonsense, but run
nothing here.
"""

from __future__ import annotations

import base64
import json
import math
import mmap
import numbers
import os
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import DTypeLike, NDArray

from colmap_ihe.machine import system
from colmap_ihe.machine.child_process import Channel

Message = dict[str, Any]

_MOST_BYTES = 1 << 28  # of one message, whose largest parts are EXIF and a colour profile
_MOST_MAPPED = 64  # arrays, each with an open file that Python keeps for its memory
_COPIED = 4096  # bytes of an array that is copied, so that holding it does not hold a photograph
_ALIGNED = 64  # bytes
_mapped: list[weakref.ref[NDArray[np.uint8]]] = []
_DTYPES = {np.dtype(kind).name: np.dtype(kind) for kind in ("u1", "u2", "i8", "f4", "f8")}


def send(channel: Channel, message: Message, fd: int | None = None) -> None:
    """Send a message, and with it the file of shared arrays. Raises OSError."""
    channel.send_bytes(json.dumps(message | {"has_file": fd is not None}).encode())
    if fd is not None:
        system.send_file(channel, fd)


def receive(channel: Channel) -> tuple[Message, int | None] | None:
    """Return the next message, and the file that came with it, which is the caller's to close; None if the other end
    is gone. Raises OSError, ValueError for what is no message."""
    try:
        message = json.loads(channel.recv_bytes(_MOST_BYTES))
        if not isinstance(message, dict):
            raise ValueError(f"a message that is a {type(message).__name__}, expected an object")
        return message, system.receive_file(channel) if message.pop("has_file", False) else None
    except EOFError:
        return None
    except RecursionError as error:
        raise ValueError(f"a message that is none: {error}") from error
    except OSError as error:
        if not channel.readable:  # more than it may be
            raise ValueError(f"a message of more than {_MOST_BYTES} bytes") from error
        if error.errno is None:  # it ended within a message
            return None
        raise


def to_plain(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return a value as JSON holds it: a dataclass by its fields, bytes as base64, an array as its place in `arrays`,
    to which it is added. `from_plain` reads it back."""
    if is_dataclass(value):
        return {f.name: to_plain(getattr(value, f.name), arrays) for f in fields(value)}
    if isinstance(value, dict):
        return {key: to_plain(inner, arrays) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(inner, arrays) for inner in value]
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return len(arrays) - 1
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, numbers.Rational) and not isinstance(value, int):  # Pillow's, in EXIF
        return float(value)
    return value


def from_plain(value: Any, kind: Any, arrays: Sequence[NDArray[Any]] = ()) -> Any:
    """Return what `to_plain` made `value` of, of type `kind`, an annotation. Raises ValueError or TypeError."""
    if isinstance(kind, type) and is_dataclass(kind):
        kinds = _kinds_of(kind)
        if not isinstance(value, dict) or value.keys() != kinds.keys():
            raise ValueError(f"{value!r:.80}, expected {', '.join(kinds)}")
        return kind(**{n: from_plain(value[n], inner, arrays) for n, inner in kinds.items()})
    origin, choices = get_origin(kind), get_args(kind)
    if hasattr(origin, "__value__"):  # from Python 3.12 on NDArray may be a `type` of its own
        return from_plain(value, origin.__value__[choices], arrays)
    if origin in (Union, UnionType):
        if value is None and NoneType in choices:  # else others say at length that it is none of them
            return None
        for choice in choices:
            try:
                return from_plain(value, choice, arrays)
            except (TypeError, ValueError) as error:
                reason = str(error)  # not the error, whose traceback would hold the arrays
        raise ValueError(reason)
    if origin is tuple and isinstance(value, list) and choices[-1] is Ellipsis:
        choices = choices[:1] * len(value)
    if origin is tuple and isinstance(value, list) and len(value) == len(choices):
        return tuple(from_plain(v, choice, arrays) for v, choice in zip(value, choices, strict=True))
    if origin is np.ndarray and type(value) is int and 0 <= value < len(arrays):
        array = arrays[value]
        if array.dtype.type in get_args(choices[1]):
            return array
        raise ValueError(f"pixels of {array.dtype}, expected {kind}")
    if kind is Path and isinstance(value, str):
        return Path(value)
    if kind is bytes and isinstance(value, str):
        return base64.b64decode(value, validate=True)
    if kind is float and type(value) in (int, float) and math.isfinite(value):
        return float(value)
    good = value in choices if origin is Literal else kind is Any or type(value) is (origin or kind)
    if not good:
        raise ValueError(f"{value!r:.80}, expected {kind}")
    return value


def call_to_plain(function: Callable[..., Any], *arguments: Any) -> Message:
    """Return a call of a module's function as JSON holds it; `call_from_plain` reads it back."""
    return {"function": [function.__module__, function.__name__], "arguments": to_plain(arguments, [])}


def call_from_plain(call: Message) -> tuple[Callable[..., Any], list[Any]]:
    """Return function and arguments, of the types that the function is annotated with. Raises ValueError."""
    module, name = call["function"]
    function, kinds = _annotated(module, name)
    return function, [from_plain(v, kind) for v, kind in zip(call["arguments"], kinds, strict=False)]


@cache
def _annotated(module: str, name: str) -> tuple[Callable[..., Any], list[Any]]:
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function, [kind for argument, kind in get_type_hints(function).items() if argument != "return"]


@cache
def _kinds_of(kind: type[Any]) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {f.name: hints[f.name] for f in fields(kind)}


class SharedArrayWriter:
    """Hold a decoder's side of the memory for its arrays: without a name in any file system, or files in `folder`. It
    is used again once the arrays before are not needed any more, for making pages takes as long as decoding into
    them."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder, self._files = folder, 0
        self._fd: int | None = None  # until it was sent
        self._memory: mmap.mmap | None = None

    def array(self, shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
        """Return an array in this memory, with anything in it; takes the place of those before."""
        self._reserve(_room(math.prod(shape) * np.dtype(dtype).itemsize))
        return np.frombuffer(self._memory or b"", dtype, math.prod(shape)).reshape(shape)

    def put(self, arrays: Sequence[NDArray[Any]]) -> tuple[Message, int | None]:
        """Copy arrays into this memory, one after the other, but for one that lies in its place. Return what tells
        `SharedArrayReader` of them; and the memory's file if the reader does not have it, to be sent before `sent`."""
        self._reserve(sum(_room(array.nbytes) for array in arrays))
        start = 0
        for array in arrays:
            whole = np.frombuffer(self._memory or b"", np.uint8, array.nbytes, start)
            inside = whole.view(array.dtype).reshape(array.shape)
            if array.__array_interface__["data"] != inside.__array_interface__["data"]:
                inside[...] = array
            start += _room(array.nbytes)
        about = [{"shape": list(array.shape), "dtype": array.dtype.name} for array in arrays]
        message = {"arrays": about, "is_new": self._fd is not None, "file": self._files}
        return message, self._fd if self._folder is None else None

    def sent(self) -> None:
        """Close the file, which the reader has now, or opens by its number."""
        if self._fd is not None:
            os.close(self._fd)
            self._fd = None

    def leave(self) -> None:
        """Leave the memory to the reader."""
        self.sent()
        self._memory = None

    def _reserve(self, size: int) -> None:
        if self._memory is None or len(self._memory) < size:
            self.leave()
            self._files += 1
            self._fd = system.anonymous_file() if self._folder is None else self._named(self._folder)
            os.ftruncate(self._fd, size)
            self._memory = mmap.mmap(self._fd, size)

    def _named(self, folder: Path) -> int:
        folder.mkdir(exist_ok=True)  # where temporary files were cleaned up meanwhile
        return system.open_shared(folder / str(self._files), new=True)


def _room(size: int) -> int:
    """Return the bytes that an array of `size` bytes takes, so that the next one is aligned."""
    return max(1, -(-size // _ALIGNED)) * _ALIGNED


answer_memory: SharedArrayWriter | None = None
"""Of a decoder; elsewhere there is none."""


def answer_array(shape: tuple[int, ...], dtype: DTypeLike) -> NDArray[Any]:
    """Return an array to decode into, which a decoder need not copy to answer with it."""
    return np.empty(shape, dtype) if answer_memory is None else answer_memory.array(shape, dtype)


class SharedArrayReader:
    """Hold the other side of a `SharedArrayWriter` with the same `folder`: large arrays are mapped, and copied only
    where many are held."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._memory: mmap.mmap | None = None
        self._whole: weakref.ref[NDArray[np.uint8]] | None = None  # on whose memory every view is

    @property
    def is_free(self) -> bool:
        """Tell whether no view is left of the last arrays, so that others may take their place."""
        return self._whole is None or self._whole() is None

    def arrays(self, message: Message, fd: int | None) -> list[NDArray[Any]]:
        """Return the arrays that `SharedArrayWriter.put` told of; closes `fd`. Raises ValueError, KeyError or
        TypeError if the memory is not what the message says."""
        if self._folder is not None and message.get("is_new"):
            fd = _opened(self._folder / str(int(message["file"])))
        if fd is not None:
            try:
                if self._folder is None:
                    system.seal(fd)
                self._memory = mmap.mmap(fd, os.fstat(fd).st_size)
            finally:
                os.close(fd)
        if not message.get("arrays"):
            return []
        if message["is_new"] != (fd is not None):  # a process that can open no further file gets none
            raise ValueError("the file of an array was lost on the way")
        whole = np.frombuffer(self._memory or b"", np.uint8)
        _mapped[:] = [array for array in _mapped if array() is not None]
        arrays = []
        start = 0
        for about in message["arrays"]:
            shape, dtype = tuple(int(n) for n in about["shape"]), _DTYPES[about["dtype"]]
            size = math.prod(shape) * dtype.itemsize
            if min(shape, default=0) < 0 or start + size > len(whole):
                raise ValueError(f"{shape=} {dtype=} in {len(whole)} bytes")
            array = whole[start : start + size].view(dtype).reshape(shape)
            arrays.append(array.copy() if size <= _COPIED or len(_mapped) >= _MOST_MAPPED else array)
            start += _room(size)
        self._whole = weakref.ref(whole)
        _mapped.append(self._whole)
        return arrays

    def empty(self) -> None:
        """Give the memory back to the system until it is used again, if it is free."""
        if self.is_free and self._memory is not None:
            system.give_back(self._memory)


def _opened(file: Path) -> int | None:
    """Return the descriptor of a file that a decoder made, which loses its name now; None where it is not there."""
    try:
        return system.open_shared(file)
    except OSError:
        return None
    finally:
        with suppress(OSError):  # Windows removes it
            file.unlink()
