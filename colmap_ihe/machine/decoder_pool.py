"""The processes in which photographs are decoded: each works for one thread at a time and is used again and again;
there are as many as threads decoded at once.
"""

from __future__ import annotations

import atexit
import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numpy.typing import NDArray

from colmap_ihe.errors import CapabilityError, PhotographError
from colmap_ihe.machine import memory
from colmap_ihe.machine.decoder_process import BROKEN, SECONDS, Decoder
from colmap_ihe.machine.decoder_wire import Message

logger = logging.getLogger(__name__)

SECONDS_A_MEGAPIXEL = 5.0
_UNKNOWN_PIXELS = 100_000_000  # of a photograph whose header was not read, for its time
_HEADER_MEMORY = 1 << 30  # bytes; a header needs a few
_SHARE_OF_MEMORY = 0.9

_KNOWN = {kind.__name__: kind for kind in (PhotographError, CapabilityError)}


def ask(
    task: str, name: str, pixels: int | None = None, **arguments: Any
) -> tuple[Message, NDArray[Any] | None]:
    """Has a decoder do one of `decoder_main.TASKS` on the photograph called `name`: what it returns, and the
    array if there is one. `pixels` to be decoded: 0 if unknown, None if only a header is read.

    Raises `PhotographError`, also when the decoder crashed, took too long or ran out of memory; `Cancelled`
    within `stoppable`; `CapabilityError` if none can be started.
    """
    with one_decoder() as decoder:
        return decoder.ask(task, name, pixels, **arguments)


@contextmanager
def one_decoder() -> Iterator[LentDecoder]:
    """One decoder for several questions."""
    with _pool.lent() as decoder:
        yield LentDecoder(decoder)


class LentDecoder:
    """A decoder that remembers what it was asked before, until it `is_lost`."""

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder

    @property
    def is_lost(self) -> bool:
        """Whether it crashed, or was ended since it took too long."""
        return self._decoder.dead

    def ask(
        self, task: str, name: str, pixels: int | None = None, **arguments: Any
    ) -> tuple[Message, NDArray[Any] | None]:
        """As `decoders.ask`."""
        seconds, limit = SECONDS, _HEADER_MEMORY
        if pixels is not None:
            seconds += SECONDS_A_MEGAPIXEL * (pixels or _UNKNOWN_PIXELS) / 1e6
            limit = max(limit, int(_room.bytes() * _SHARE_OF_MEMORY))
        request = {"task": task, "name": name, "memory": limit, "arguments": arguments}
        answer, array = self._decoder.ask(request, name, seconds)
        return value_of(answer, name), array


def value_of(answer: Message, name: str) -> Any:
    """What a decoder answered of a photograph. Raises the error that it tells of."""
    if "error" in answer:
        if answer.get("traceback"):
            logger.debug("%s: %s", name, answer["traceback"])
        kind = _KNOWN.get(str(answer["error"]), PhotographError)
        raise kind(" ".join(str(answer.get("message")).split()), hint=str(answer.get("hint") or ""))
    with understood(name):
        return answer["value"]


@contextmanager
def understood(name: str) -> Iterator[None]:
    """Within, an answer that makes no sense is that photograph's fault: it may have taken its decoder over. Raises
    `PhotographError`."""
    try:
        yield
    except (TypeError, ValueError, LookupError, AttributeError, OverflowError) as error:
        reason = " ".join(str(error).split())[:200]
        raise PhotographError(f"{name}: the decoder lost its way on it ({reason})", hint=BROKEN) from error


class _Pool:
    """The decoders of this process. `lock` is held for moments only, and never while one decodes."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.idle: list[Decoder] = []
        self.busy: set[Decoder] = set()

    @contextmanager
    def lent(self) -> Iterator[Decoder]:
        """An idle decoder, else a new one. Of several the one used last whose photograph is no longer wanted: its
        memory can be used again, and making new takes as long as decoding into it."""
        decoder: Decoder | None = None
        while decoder is None or decoder.dead:
            with self.lock:
                self.idle.sort(key=lambda one: one.window.is_free)
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
        with self.lock:
            idle, self.idle = self.idle, []
        for decoder in idle:
            decoder.end()

    def end_all(self) -> None:
        self.end_idle()
        for decoder in tuple(self.busy):
            decoder.end()

    def after_fork(self) -> None:
        """In a forked child: the decoders are its parent's, in which the lock may have been held."""
        self.lock = threading.Lock()
        for decoder in (*self.idle, *self.busy):
            decoder.forget()
        self.idle, self.busy = [], set()


class _RoomInMemory:
    """How much memory is free, asked for once a second: to ask takes as long as a small photograph's decoding."""

    def __init__(self) -> None:
        self._bytes, self._until = 0, 0.0

    def bytes(self) -> int:
        now = time.monotonic()
        if now >= self._until:
            self._bytes, self._until = memory.available(), now + 1
        return self._bytes


_room = _RoomInMemory()
_pool = _Pool()
atexit.register(_pool.end_all)
os.register_at_fork(after_in_child=_pool.after_fork)


def release_memory() -> None:
    """Gives back the memory in which idle decoders returned photographs."""
    with _pool.lock:
        for decoder in _pool.idle:
            decoder.window.empty()


def end_idle() -> None:
    """Ends the decoders that are idle, some 50 MB each; the next read starts one again."""
    _pool.end_idle()
