"""One process that decodes photographs: what a broken photograph does to a native decoder, it does to this process."""

from __future__ import annotations

import select
import socket
import time
from typing import Any

from numpy.typing import NDArray

from colmap_ihe.errors import Cancelled, CapabilityError, PhotographError
from colmap_ihe.machine import threads
from colmap_ihe.machine.cancel import stopped
from colmap_ihe.machine.child_process import ChildProcess
from colmap_ihe.machine.decoder_wire import Message, SharedArrayReader, receive, send

SECONDS = 120.0
"""For a header, or to start: a disk may have to wake up, or a file to come from a cloud."""
_TICK_MS = 100  # how long a cancelled read may go on
BROKEN = "copy it from the card again, or take it out of the folder"


class Decoder:
    """Hold one process. Whatever goes wrong ends it: it is then `dead`."""

    def __init__(self) -> None:
        """Start it. Raises `CapabilityError`."""
        self.dead = False
        self.window = SharedArrayReader()
        self._ready = False
        try:
            self._socket, theirs = socket.socketpair()
        except OSError as error:
            raise _cannot_start(str(error)) from error
        try:
            with theirs:  # photographs are what is parallel: one thread each
                self._process = ChildProcess(
                    "colmap_ihe.photographs.decoder_main",
                    str(theirs.fileno()),
                    pass_fds=(theirs.fileno(),),
                    environment=threads.environment(1),
                )
        except OSError as error:
            self._socket.close()
            raise _cannot_start(str(error)) from error

    def ask(self, request: Message, name: str, seconds: float) -> tuple[Message, list[NDArray[Any]]]:
        """Send a request about the photograph `name`: return the answer as it came, and its arrays.

        Raises `PhotographError` where the process dies, takes longer than `seconds` or answers nonsense; `Cancelled`
        within `stoppable`; `CapabilityError` if it does not start.
        """
        try:
            if not self._ready:
                self._await_start()
            try:
                send(self._socket, request | {"free": self.window.is_free})
            except OSError as error:
                raise EOFError from error
            answer, fd = self._answer(seconds)
            return answer, self.window.arrays(answer, fd)
        except TimeoutError:
            self.end()
            raise PhotographError(
                f"{name}: the decoder did not finish within {seconds:.0f} seconds", hint=BROKEN
            ) from None
        except EOFError:
            raise PhotographError(
                f"{name}: the decoder crashed on it ({self._cause_of_death()})", hint=BROKEN
            ) from None
        except (ValueError, LookupError, TypeError, OverflowError, RecursionError) as error:
            self.end()
            raise PhotographError(f"{name}: the decoder lost its way on it ({error})", hint=BROKEN) from error
        except BaseException:  # Ctrl-C here would leave an answer that nobody waits for
            self.end()
            raise

    def _await_start(self) -> None:
        try:
            self._answer(SECONDS)
        except EOFError:
            raise _cannot_start(self._cause_of_death()) from None
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

    def _cause_of_death(self) -> str:
        """End it, and return why it closed its socket."""
        cause = self._process.cause_of_death(SECONDS)
        self.end()
        return cause

    @property
    def is_alive(self) -> bool:
        """Tell whether the process runs."""
        return self._process.status() is None

    def end(self) -> None:
        """Kill the process, if it is not `dead` yet."""
        if not self.dead:
            self.dead = True
            self._process.end()
            self._socket.close()

    def forget(self) -> None:
        """Let go of it in a forked process: it is the parent's."""
        self.dead = True
        self._process.forget()
        self._socket.close()


def _cannot_start(reason: str) -> CapabilityError:
    return CapabilityError(
        f"no process to decode photographs could be started ({reason})",
        hint="photographs are decoded in further Python processes; see docs/troubleshooting.md",
    )
