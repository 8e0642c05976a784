"""COLMAP in Python processes of its own: one that can be ended, dies alone, and has its BLAS to itself."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from queue import SimpleQueue
from types import TracebackType
from typing import Any, TypeVar

from colmap_ihe.colmap import native
from colmap_ihe.errors import NativeError
from colmap_ihe.machine import threads
from colmap_ihe.machine.child_process import Channel, ChildProcess, channel_to_parent, die_with_parent
from colmap_ihe.machine.progress import Progress, Silent

_STDERR = 2
_POLL_SECONDS = 0.2
_END_SECONDS = 10.0

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class ColmapProcesses:
    """Hold as many processes as there are calls at a time; they are kept for later calls, and end with this."""

    def __init__(self, most_threads: int | None = None) -> None:
        """Have each compute with `most_threads`, by default with as many as this process may."""
        self._threads = threads.limit() if most_threads is None else most_threads
        self._idle: list[_Process] = []

    def __enter__(self) -> ColmapProcesses:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        while self._idle:
            self._idle.pop().end()

    def start(self, count: int, function: Callable[..., Any]) -> None:
        """Start processes for so many calls of `function` at a time, which import it while this one goes on."""
        for _ in range(count):
            self._idle.append(_Process(self._threads, function))

    def call(
        self,
        function: Callable[[_Item, Progress], _Result],
        argument: _Item,
        progress: Progress,
        grace_seconds: float = 0.0,
    ) -> _Result:
        """Return what `function`, one of a module, makes of a plain value; its progress reaches `progress`. May be
        called on several threads.

        When `progress` raises, its process is asked to stop where it has some seconds of grace to finish what it has
        begun, and ended after them. Raises what `progress` and `function` do, and `NativeError` where the process died.
        """
        try:
            process = self._idle.pop()
        except IndexError:
            process = _Process(self._threads)
        try:
            result: _Result = process.call(function, argument, progress, grace_seconds)
        except BaseException:
            process.end()
            raise
        self._idle.append(process)
        return result


class _Process:
    def __init__(self, most_threads: int | None, first: Callable[..., Any] | None = None) -> None:
        heard = bool(native.pycolmap.logging.alsologtostderr)
        self._process = ChildProcess(
            "colmap_ihe.colmap.process",
            # Threads that wait would else keep the cores busy for the others.
            environment={"OMP_WAIT_POLICY": "passive"} | threads.environment(most_threads),
            errors=_STDERR if heard else None,
        )
        self._pipe = self._process.channel
        self._send((most_threads, native.log_file(), heard, first))

    def call(
        self, function: Callable[..., Any], argument: Any, progress: Progress, grace_seconds: float
    ) -> Any:
        self._send((function, argument))
        stop: BaseException | None = None
        until = float("inf")
        while True:
            try:
                message = self._pipe.recv() if self._pipe.poll(_POLL_SECONDS) else 0
            except (EOFError, OSError):
                raise stop or self._death() from None
            if not isinstance(message, int):
                break
            if stop is not None:
                if time.monotonic() > until:
                    raise stop
                continue
            try:
                progress.advance(message) if message else progress.check()
            except BaseException as error:
                if not grace_seconds:
                    raise
                stop, until = error, time.monotonic() + grace_seconds
                self._send(None)
        result, failure = message
        if stop is not None or failure is not None:
            raise stop or failure
        return result

    def end(self) -> None:
        self._process.end()

    def _send(self, message: Any) -> None:
        with suppress(OSError):  # it died, which the reading of its answer finds
            self._pipe.send(message)

    def _death(self) -> NativeError:
        cause = self._process.cause_of_death(_END_SECONDS)
        return NativeError(f"COLMAP died ({cause})", hint="records/colmap.log.* holds its own log")


class _Teller(Silent):
    """Report progress in that process, and learn there that it is to stop."""

    def __init__(self, pipe: Channel) -> None:
        super().__init__()
        self._pipe = pipe

    def advance(self, count: int = 1) -> None:
        self._pipe.send(count)
        super().advance(count)


def main() -> None:
    """Do what comes from the parent."""
    die_with_parent()
    pipe = channel_to_parent()
    most_threads, log, heard, _ = pipe.recv()  # the last is imported by that
    progress = _Teller(pipe)
    asked: SimpleQueue[tuple[Callable[..., Any], Any]] = SimpleQueue()
    if heard:
        native.hear_colmap()
    with ExitStack() as stack:
        stack.enter_context(threads.limited(most_threads))
        if log:
            stack.enter_context(native.logged_to(Path(log), besides=True))
        # Not before: what it hears it imports, and that and the search for BLAS would each hold the lock of the other,
        # of the loader of libraries and of Python.
        threading.Thread(target=_listen, args=(pipe, progress, asked), daemon=True).start()
        while True:
            function, argument = asked.get()
            try:
                pipe.send((function(argument, progress), None))
            except BaseException as error:  # noqa: BLE001  it is for the one who asked
                pipe.send((None, error))


def _listen(pipe: Channel, progress: _Teller, asked: SimpleQueue[tuple[Callable[..., Any], Any]]) -> None:
    with suppress(EOFError, OSError):
        while True:
            message = pipe.recv()
            progress.cancelled = message is None
            if message is not None:
                asked.put(message)
    os._exit(1)  # this process was given up
