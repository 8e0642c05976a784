"""One process that decodes photographs: what a broken one does to a native decoder, it does to this.

It is a fresh Python (`decoder_main`), neither forked, for LibRaw with OpenMP can deadlock then, nor of
`multiprocessing`, which would run the user's script again. It ends when its socket closes, whatever became of us.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from typing import Any

from numpy.typing import NDArray

from colmap_ihe.errors import Cancelled, CapabilityError, PhotographError
from colmap_ihe.machine.cancel import stopped
from colmap_ihe.machine.decoder_wire import Message, SharedArrayReader, anonymous_file, receive, send

SECONDS = 120.0
"""For a header, or to start: a disk may have to wake up, or a file to come from a cloud."""
_TICK_MS = 100  # how long a cancelled read may go on
_START = (
    "import sys; sys.path[:] = sys.argv[3:]; from colmap_ihe.photographs.decoder_main import main; main()"
)
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # photographs are what is parallel
BROKEN = "copy it from the card again, or take it out of the folder"


class Decoder:
    """One process. Whatever goes wrong ends it: it is then `dead`."""

    def __init__(self) -> None:
        self.dead = False
        self.window = SharedArrayReader()
        self._ready = False
        self._ours = ExitStack()  # what is open on this side
        try:
            with ExitStack() as theirs:
                self._words = anonymous_file()  # what it says on stderr, and in the end perhaps why
                self._ours.callback(os.close, self._words)
                self._socket, asked = self._pair(theirs)
                _, lifeline = self._pair(theirs)  # nothing is sent on it
                passed = (asked.fileno(), lifeline.fileno())
                self._process = subprocess.Popen(
                    [sys.executable or "python3", "-c", _START, *map(str, passed), *sys.path],
                    pass_fds=passed,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=self._words,
                    start_new_session=True,  # Ctrl-C in the terminal is for us
                    env=os.environ | _ONE_THREAD,
                )
        except OSError as error:
            self._ours.close()
            raise _cannot_start(str(error)) from error

    def _pair(self, theirs: ExitStack) -> tuple[socket.socket, socket.socket]:
        here, there = socket.socketpair()
        return self._ours.enter_context(here), theirs.enter_context(there)

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
        except (ValueError, LookupError, TypeError, OverflowError, RecursionError) as error:
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
        self._ours.close()


def _cannot_start(reason: str) -> CapabilityError:
    return CapabilityError(
        f"no process to decode photographs could be started ({reason})",
        hint="photographs are decoded in further Python processes; see docs/troubleshooting.md",
    )
