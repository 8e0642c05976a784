"""The processes in which photographs are decoded: each works for one thread at a time and is used again and again;
there are as many as threads decoded at once.
"""

from __future__ import annotations

import atexit
import base64
import logging
import os
import pickle
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, Protocol, TypeVar, get_type_hints

from numpy.typing import NDArray

from colmap_ihe.errors import CapabilityError, PhotographError
from colmap_ihe.machine import memory
from colmap_ihe.machine.decoder_process import BROKEN, SECONDS, Decoder
from colmap_ihe.machine.decoder_wire import Message, from_plain

logger = logging.getLogger(__name__)

SECONDS_A_MEGAPIXEL = 5.0
_UNKNOWN_PIXELS = 100_000_000  # of a photograph whose header was not read, for its time
_HEADER_MEMORY = 1 << 30  # bytes; a header needs a few
_SHARE_OF_MEMORY = 0.9

_KNOWN = {kind.__name__: kind for kind in (PhotographError, CapabilityError)}
_Result = TypeVar("_Result")


class Subject(Protocol):
    """Describe what a decoder works on: a capture, or the path of a file."""

    @property
    def name(self) -> str: ...
    def absolute(self) -> Any: ...


def in_decoder(
    function: Callable[..., _Result], subject: Subject, *arguments: Any, pixels: int | None = None
) -> _Result:
    """Return `function(subject, *arguments)`, computed by a decoder in a process of its own.

    `function` is one of a module; it returns plain values, arrays, or dataclasses of these, as annotated. `pixels` to
    be decoded: 0 if unknown, None if only a header is read. Raises `PhotographError`, also when the decoder crashed,
    took too long, ran out of memory or returned another type; `Cancelled` within `stoppable`; `CapabilityError` if no
    decoder can be started.
    """
    with one_decoder() as decoder:
        return decoder.run(function, subject, *arguments, pixels=pixels)


@contextmanager
def one_decoder() -> Iterator[LentDecoder]:
    """Lend one decoder for several questions."""
    with _pool.lent() as decoder:
        yield LentDecoder(decoder)


class LentDecoder:
    """Hold a decoder that remembers what it was asked before, until it `is_lost`."""

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder

    @property
    def is_lost(self) -> bool:
        """Tell whether it crashed, or was ended since it took too long."""
        return self._decoder.dead

    def run(
        self, function: Callable[..., _Result], subject: Subject, *arguments: Any, pixels: int | None = None
    ) -> _Result:
        """Return what `in_decoder` does."""
        seconds, limit = SECONDS, _HEADER_MEMORY
        if pixels is not None:
            seconds += SECONDS_A_MEGAPIXEL * (pixels or _UNKNOWN_PIXELS) / 1e6
            limit = max(limit, int(_free_memory.bytes() * _SHARE_OF_MEMORY))
        call = base64.b64encode(pickle.dumps((function, (subject.absolute(), *arguments)))).decode("ascii")
        request = {"call": call, "name": subject.name, "memory": limit}
        answer, arrays = self._decoder.ask(request, subject.name, seconds)
        result: _Result = _result_of(answer, arrays, _kind_of_result(function), subject.name)
        return result


@cache
def _kind_of_result(function: Callable[..., Any]) -> Any:
    return get_type_hints(function)["return"]


def _result_of(answer: Message, arrays: Sequence[NDArray[Any]], kind: Any, name: str) -> Any:
    """Return the value in an answer about a photograph. Raises the error that it tells of."""
    if "error" in answer:
        if answer.get("traceback"):
            logger.debug("%s: %s", name, answer["traceback"])
        error = _KNOWN.get(str(answer["error"]), PhotographError)
        raise error(" ".join(str(answer.get("message")).split()), hint=str(answer.get("hint") or ""))
    with understood(name):
        return from_plain(answer["value"], kind, arrays)


@contextmanager
def understood(name: str) -> Iterator[None]:
    """Within, blame the photograph `name` for an answer that makes no sense: it may have taken its decoder over.
    Raises `PhotographError`."""
    try:
        yield
    except (TypeError, ValueError, LookupError, AttributeError, OverflowError) as error:
        reason = " ".join(str(error).split())[:200]
        raise PhotographError(f"{name}: the decoder lost its way on it ({reason})", hint=BROKEN) from error


class _Pool:
    """Hold the decoders of this process. `lock` is held for moments only, and never while one decodes."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.idle: list[Decoder] = []
        self.busy: set[Decoder] = set()

    @contextmanager
    def lent(self) -> Iterator[Decoder]:
        """Lend an idle decoder, else a new one. Of several the one used last whose photograph is not held any more: its
        memory can be used again, and making new takes as long as decoding into it."""
        decoder: Decoder | None = None
        while decoder is None or decoder.dead:
            with self.lock:
                self.idle.sort(key=lambda idle: idle.window.is_free)
                decoder = self.idle.pop() if self.idle else None
            if decoder is None:
                decoder = Decoder()
            elif not decoder.is_alive:  # else the next photograph would be blamed
                decoder.end()
        with self.lock:
            self.busy.add(decoder)
        try:
            yield decoder
        finally:
            with self.lock:
                self.busy.discard(decoder)
                if not decoder.dead:
                    self.idle.append(decoder)

    def end_idle(self) -> None:
        """End those that nobody uses."""
        with self.lock:
            idle, self.idle = self.idle, []
        for decoder in idle:
            decoder.end()

    def end_all(self) -> None:
        """End all, with this process."""
        self.end_idle()
        for decoder in tuple(self.busy):
            decoder.end()

    def after_fork(self) -> None:
        """Forget, in a forked child, the decoders of its parent, in which the lock may have been held."""
        self.lock = threading.Lock()
        for decoder in (*self.idle, *self.busy):
            decoder.forget()
        self.idle, self.busy = [], set()


class _FreeMemory:
    """Tell how much memory is free, asked for once a second: to ask takes as long as decoding a small photograph."""

    def __init__(self) -> None:
        self._bytes, self._until = 0, 0.0

    def bytes(self) -> int:
        now = time.monotonic()
        if now >= self._until:
            self._bytes, self._until = memory.available(), now + 1
        return self._bytes


_free_memory = _FreeMemory()
_pool = _Pool()
atexit.register(_pool.end_all)
os.register_at_fork(after_in_child=_pool.after_fork)


def release_memory() -> None:
    """Give back the memory in which idle decoders returned photographs."""
    with _pool.lock:
        for decoder in _pool.idle:
            decoder.window.empty()


def end_idle() -> None:
    """End the decoders that are idle, some 50 MB each; the next read starts one again."""
    _pool.end_idle()
