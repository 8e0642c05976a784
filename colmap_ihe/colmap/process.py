"""COLMAP in Python processes of our own: one that can be ended, dies alone, and has its BLAS to itself.

Fresh Pythons in sessions of their own: none of `multiprocessing`'s, which would run the user's script again, and
Ctrl-C in the terminal is for us. They end when their pipe closes, whatever became of us.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryFile
from types import TracebackType
from typing import Any, TypeVar

from colmap_ihe.colmap import native
from colmap_ihe.errors import NativeError
from colmap_ihe.machine import threads
from colmap_ihe.machine.progress import Progress, Silent

_START = "import sys; sys.path[:] = sys.argv[2:]; from colmap_ihe.colmap.process import main; main(int(sys.argv[1]))"
_POLL_SECONDS = 0.2
_END_SECONDS = 10.0

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class ColmapProcesses:
    """Processes, as many as there are calls at a time; they are kept for later calls, and end with this."""

    def __init__(self, most_threads: int | None = None) -> None:
        """Each computes with `most_threads`, by default with as many as this process may."""
        self._threads = threads.limit() if most_threads is None else most_threads
        self._idle: list[_Process] = []

    def __enter__(self) -> ColmapProcesses:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        while self._idle:
            self._idle.pop().end()

    def call(
        self,
        function: Callable[[_Item, Progress], _Result],
        argument: _Item,
        progress: Progress,
        grace_seconds: float = 0.0,
    ) -> _Result:
        """What `function`, one of a module, makes of a plain value; what its watch is told reaches `progress`. May be
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
    def __init__(self, most_threads: int | None) -> None:
        heard = bool(native.pycolmap.logging.alsologtostderr)
        self._words = TemporaryFile()  # noqa: SIM115  of the process, until it ends
        self._pipe, theirs = Pipe()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-c", _START, str(theirs.fileno()), *sys.path],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=self._words,
                stderr=None if heard else self._words,
                start_new_session=True,
                # Threads that wait would else keep the cores busy for the others.
                env=os.environ | {"OMP_WAIT_POLICY": "passive"} | threads.environment(most_threads),
            )
        self._send((most_threads, native.log_file(), heard))

    def call(
        self, function: Callable[..., Any], argument: Any, progress: Progress, grace_seconds: float
    ) -> Any:
        self._send((function, argument))
        stop: BaseException | None = None
        until = float("inf")
        while True:
            try:
                said = self._pipe.recv() if self._pipe.poll(_POLL_SECONDS) else 0
            except (EOFError, OSError):
                raise stop or self._death() from None
            if not isinstance(said, int):
                break
            if stop is not None:
                if time.monotonic() > until:
                    raise stop
                continue
            try:
                progress.advance(said) if said else progress.check()
            except BaseException as error:
                if not grace_seconds:
                    raise
                stop, until = error, time.monotonic() + grace_seconds
                self._send(None)
        result, failure = said
        if stop is not None or failure is not None:
            raise stop or failure
        return result

    def end(self) -> None:
        self._pipe.close()
        self._process.kill()
        self._process.wait()
        self._words.close()

    def _send(self, message: Any) -> None:
        with suppress(OSError):  # it died, which is told when its answer is read
            self._pipe.send(message)

    def _death(self) -> NativeError:
        try:
            status = self._process.wait(_END_SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        hint = "records/colmap.log.* holds its own log"
        if status < 0:
            died = signal.Signals(-status).name
            why = f"{died}, perhaps for want of memory" if died == "SIGKILL" else died
            return NativeError(f"COLMAP died ({why})", hint=hint)
        self._words.seek(0)
        lines = self._words.read().decode("utf-8", "replace").strip().splitlines()
        return NativeError(f"COLMAP failed: {lines[-1] if lines else f'exit status {status}'}", hint=hint)


class _Teller(Silent):
    """In that process: hears that it is to stop, and tells how far it is."""

    def __init__(self, pipe: Connection) -> None:
        super().__init__()
        self._pipe = pipe

    def advance(self, count: int = 1) -> None:
        self._pipe.send(count)
        super().advance(count)


def main(descriptor: int) -> None:
    """In that process: does what comes through the pipe, and ends with it."""
    pipe = Connection(descriptor)
    most_threads, log, heard = pipe.recv()
    progress = _Teller(pipe)
    asked: SimpleQueue[tuple[Callable[..., Any], Any]] = SimpleQueue()
    threading.Thread(target=_listen, args=(pipe, progress, asked), daemon=True).start()
    if heard:
        native.hear_colmap()
    with ExitStack() as stack:
        stack.enter_context(threads.limited(most_threads))
        if log:
            stack.enter_context(native.logged_to(Path(log), besides=True))
        while True:
            function, argument = asked.get()
            try:
                pipe.send((function(argument, progress), None))
            except BaseException as error:  # noqa: BLE001  it is for the one who asked
                pipe.send((None, error))


def _listen(pipe: Connection, progress: _Teller, asked: SimpleQueue[tuple[Callable[..., Any], Any]]) -> None:
    with suppress(EOFError, OSError):
        while True:
            message = pipe.recv()
            progress.cancelled = message is None
            if message is not None:
                asked.put(message)
    os._exit(1)
