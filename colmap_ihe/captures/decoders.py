"""Decoding in processes of its own: what a broken photograph does to a native decoder, it does to one of these.

A decoder works for one thread at a time and is used again and again; there are as many as threads decoded at
once. It is a fresh Python (`decoder_main`), neither forked, for LibRaw with OpenMP can deadlock then, nor of
`multiprocessing`, which would run the user's script again. It ends when its socket closes, whatever became of us.
"""

from __future__ import annotations

import atexit
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from typing import Any, Protocol

from numpy.typing import NDArray

from colmap_ihe import memory
from colmap_ihe.captures.wire import Message, Window, anonymous_file, receive, send
from colmap_ihe.errors import Cancelled, CapabilityError, PhotographError

logger = logging.getLogger(__name__)

SECONDS = 120.0
"""For a header, or to start: a disk may have to wake up, or a file to come from a cloud."""
SECONDS_A_MEGAPIXEL = 5.0
_UNKNOWN_PIXELS = 100_000_000  # of a photograph whose header was not read, for its time
_HEADER_MEMORY = 1 << 30  # bytes; a header needs a few
_SHARE_OF_MEMORY = 0.9
_TICK_MS = 100  # how long a cancelled read may go on

_START = "import sys; sys.path[:] = sys.argv[2:]; from colmap_ihe.captures.decoder_main import main; main()"
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # photographs are what is parallel
_KNOWN = {kind.__name__: kind for kind in (PhotographError, CapabilityError)}
BROKEN = "copy it from the card again, or take it out of the folder"


class Stop(Protocol):
    """What says that work is no longer wanted: an Event, or what a task on another machine looks at."""

    def is_set(self) -> bool: ...


_stop: ContextVar[Stop | None] = ContextVar("stop", default=None)


@contextmanager
def stoppable(stop: Stop) -> Iterator[None]:
    """Reads of this thread within end with `Cancelled` soon after `stop` is set, however slow the decoder is."""
    token = _stop.set(stop)
    try:
        yield
    finally:
        _stop.reset(token)


def stopped() -> bool:
    """Whether what this thread works on, within `stoppable`, is no longer wanted."""
    event = _stop.get()
    return event is not None and event.is_set()


def ask(
    task: str, name: str, pixels: int | None = None, **arguments: Any
) -> tuple[Message, NDArray[Any] | None]:
    """Has a decoder do one of `decoder_main.TASKS` on the photograph called `name`: what it returns, and the
    array if there is one. `pixels` to be decoded: 0 if unknown, None if only a header is read.

    Raises `PhotographError`, also when the decoder crashed, took too long or ran out of memory; `Cancelled`
    within `stoppable`; `CapabilityError` if none can be started.
    """
    with kept() as decoder:
        return decoder.ask(task, name, pixels, **arguments)


@contextmanager
def kept() -> Iterator[Kept]:
    """One decoder for several questions."""
    with _pool.lent() as decoder:
        yield Kept(decoder)


class Kept:
    """A decoder that remembers what it was asked before, until it `is_lost`."""

    def __init__(self, decoder: _Decoder) -> None:
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
        if "error" in answer:
            if answer.get("traceback"):
                logger.debug("%s: %s", name, answer["traceback"])
            raise _KNOWN.get(answer["error"], PhotographError)(answer["message"], answer["hint"])
        return answer["value"], array


class _Decoder:
    """One process. Whatever goes wrong ends it: it is then `dead`."""

    def __init__(self) -> None:
        self.dead = False
        self.window = Window()
        self._ready = False
        self._words = anonymous_file()  # what it says on stderr, and in the end perhaps why
        self._socket, theirs = socket.socketpair()
        try:
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable or "python3", "-c", _START, str(theirs.fileno()), *sys.path],
                    pass_fds=[theirs.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=self._words,
                    start_new_session=True,  # Ctrl-C in the terminal is for us
                    env=os.environ | _ONE_THREAD,
                )
        except OSError as error:
            self._socket.close()
            os.close(self._words)
            raise _cannot_start(str(error)) from error

    def ask(self, request: Message, name: str, seconds: float) -> tuple[Message, NDArray[Any] | None]:
        """As `ask`, with the answer as it came."""
        try:
            if not self._ready:
                self._started()
            try:
                send(self._socket, request | {"free": self.window.is_free})
            except OSError as error:
                raise EOFError from error
            answer, fd = self._answer(seconds)
            return answer, self.window.array(answer["array"], fd) if "array" in answer else None
        except TimeoutError:
            self.end()
            raise PhotographError(
                f"{name}: the decoder did not finish within {seconds:.0f} seconds", hint=BROKEN
            ) from None
        except EOFError:
            raise PhotographError(
                f"{name}: the decoder crashed on it ({self._died()})", hint=BROKEN
            ) from None
        except (ValueError, KeyError, TypeError) as error:
            self.end()
            raise PhotographError(f"{name}: the decoder lost its way on it ({error})", hint=BROKEN) from error
        except BaseException:  # Ctrl-C here would leave an answer that nobody waits for
            self.end()
            raise

    def _started(self) -> None:
        try:
            self._answer(SECONDS)
        except EOFError:
            raise _cannot_start(self._died()) from None
        except TimeoutError:
            self.end()
            raise _cannot_start(f"it did not start within {SECONDS:.0f} seconds") from None
        self._ready = True

    def _answer(self, seconds: float) -> tuple[Message, int | None]:
        end, poll = time.monotonic() + seconds, select.poll()
        poll.register(self._socket, select.POLLIN)
        while not poll.poll(_TICK_MS):
            if stopped():
                raise Cancelled
            if time.monotonic() > end:
                raise TimeoutError
        self._socket.settimeout(seconds)
        try:
            answer = receive(self._socket)
        except ConnectionError:
            answer = None
        if answer is None:
            raise EOFError
        return answer

    def _died(self) -> str:
        """Ends one that closed its socket: the signal that it died of, or its last words."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(SECONDS)
        words = os.pread(self._words, 1 << 16, 0).decode("utf-8", "replace").strip().splitlines()
        status = self._process.poll()
        self.end()
        if status is not None and status < 0:
            with suppress(ValueError):
                died_of = signal.Signals(-status).name
                return f"{died_of}, perhaps for want of memory" if died_of == "SIGKILL" else died_of
        return words[-1] if words else f"exit status {status}"

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def end(self) -> None:
        if not self.dead:
            self.dead = True
            self._process.kill()
            self._process.wait()
            self.forget()

    def forget(self) -> None:
        """Lets go of one that belongs to another process."""
        self.dead = True
        self._process.returncode = self._process.returncode or 0
        self._socket.close()
        os.close(self._words)


def _cannot_start(reason: str) -> CapabilityError:
    return CapabilityError(
        f"no process to decode photographs could be started ({reason})",
        hint="photographs are decoded in further Python processes; see docs/troubleshooting.md",
    )


class _Pool:
    """The decoders of this process. `lock` is held for moments only, and never while one decodes."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.idle: list[_Decoder] = []
        self.busy: set[_Decoder] = set()

    @contextmanager
    def lent(self) -> Iterator[_Decoder]:
        """An idle decoder, else a new one. Of several the one used last whose photograph is no longer wanted: its
        memory can be used again, and making new takes as long as decoding into it."""
        decoder: _Decoder | None = None
        while decoder is None or decoder.dead:
            with self.lock:
                self.idle.sort(key=lambda one: one.window.is_free)
                decoder = self.idle.pop() if self.idle else None
            if decoder is None:
                decoder = _Decoder()
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


def relax() -> None:
    """Gives back the memory in which idle decoders returned photographs."""
    with _pool.lock:
        for decoder in _pool.idle:
            decoder.window.empty()


def rest() -> None:
    """Ends the decoders that are idle, some 50 MB each; the next read starts one again."""
    _pool.end_idle()
