"""The processes in which photographs are decoded: each works for one thread at a time and is used again and again;
there are as many as threads decoded at once.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from colmap_ihe.machine.decoder_process import Decoder, Subject

_Result = TypeVar("_Result")


def in_decoder(
    function: Callable[..., _Result], subject: Subject, *arguments: Any, pixels: int | None = None
) -> _Result:
    """Return `function(subject, *arguments)`, computed by a decoder in a process of its own, as `Decoder.run` does."""
    with one_decoder() as decoder:
        return decoder.run(function, subject, *arguments, pixels=pixels)


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

    def release_memory(self) -> None:
        """Give back the memory in which idle decoders returned photographs."""
        with self.lock:
            for decoder in self.idle:
                decoder.window.empty()

    def end_idle(self, kept: int = 0) -> None:
        """End those that nobody uses, some 50 MB each, but for `kept` of them. To start one takes half a second."""
        with self.lock:
            idle, self.idle = self.idle[kept:], self.idle[:kept]
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


_pool = _Pool()
one_decoder = _pool.lent
release_memory = _pool.release_memory
end_idle = _pool.end_idle
atexit.register(_pool.end_all)
if hasattr(os, "register_at_fork"):  # where processes can fork
    os.register_at_fork(after_in_child=_pool.after_fork)
