"""One process that decodes photographs: what a broken photograph does to a native decoder, it does to this process."""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import cache, lru_cache
from typing import Any, Protocol, TypeVar, get_type_hints

from numpy.typing import NDArray

from colmap_ihe.errors import Cancelled, CapabilityError, PhotographError
from colmap_ihe.machine import decoder_wire as wire
from colmap_ihe.machine import memory, system, threads
from colmap_ihe.machine.child_process import ChildProcess
from colmap_ihe.machine.progress import stopped
from colmap_ihe.machine.scratch import scratch_folder

logger = logging.getLogger(__name__)

SECONDS = 120.0
"""For a header, or to start: a disk may have to wake up, or a file to come from a cloud."""
SECONDS_A_MEGAPIXEL = 5.0
_UNKNOWN_PIXELS = 100_000_000  # of a photograph whose header was not read, for its time
_HEADER_MEMORY = 1 << 30  # bytes; a header needs a few
_SHARE_OF_MEMORY = 0.9
_TICK_SECONDS = 0.1  # how long a cancelled read may go on
BROKEN = "copy it from the card again, or take it out of the folder"
_LINE_ENDS = re.compile(r"[\x00-\x1f\x7f-\x9f]+")  # and not the spaces of other scripts, which names hold
_NONSENSE = (TypeError, ValueError, LookupError, AttributeError, OverflowError, RecursionError)
_KNOWN = {kind.__name__: kind for kind in (PhotographError, CapabilityError)}
_Result = TypeVar("_Result")


class Subject(Protocol):
    """Describe what a decoder works on: a capture, or the path of a file."""

    @property
    def name(self) -> str: ...
    def absolute(self) -> Any: ...


def nonsense(name: str, reason: object) -> PhotographError:
    """Return the error of an answer that makes no sense: the photograph `name` may have taken its decoder over."""
    words = " ".join(str(reason).split())[:200]
    return PhotographError(f"{name}: the decoder lost its way on it ({words})", hint=BROKEN)


class Decoder:
    """Hold one process, which remembers what it was asked before. Whatever goes wrong ends it: it is then `dead`."""

    def __init__(self) -> None:
        """Start it. Raises `CapabilityError`."""
        self.dead = False
        self._ready = False
        self._folder = ExitStack()
        try:
            folder = None if system.SENDS_MEMORY else self._folder.enter_context(scratch_folder())
            self._process = ChildProcess(
                "colmap_ihe.photographs.decoder_main",
                str(folder or ""),
                environment=threads.environment(1),  # photographs are what is parallel
            )
        except OSError as error:
            self._folder.close()
            raise _cannot_start(str(error)) from error
        self.window = wire.SharedArrayReader(folder)
        self._channel = self._process.channel
        system.bound_reads(self._channel.fileno(), SECONDS)

    def run(
        self, function: Callable[..., _Result], subject: Subject, *arguments: Any, pixels: int | None = None
    ) -> _Result:
        """Return `function(subject, *arguments)`, computed in the process.

        `function` is one of a module; it returns plain values, arrays, or dataclasses of these, as annotated. `pixels`
        to be decoded: 0 if unknown, None if only a header is read. Raises `PhotographError`, also when the process
        died, took too long, ran out of memory or returned another type; `Cancelled` within `stoppable`;
        `CapabilityError` if it does not start.
        """
        name, seconds, limit = subject.name, SECONDS, _HEADER_MEMORY
        if pixels is not None:
            seconds += SECONDS_A_MEGAPIXEL * (pixels or _UNKNOWN_PIXELS) / 1e6
            limit = max(limit, int(_free_memory(int(time.monotonic())) * _SHARE_OF_MEMORY))
        call = wire.call_to_plain(function, subject.absolute(), *arguments)
        answer, arrays = self.ask({**call, "name": name, "memory": limit}, name, seconds)
        if "error" in answer:
            if answer.get("traceback"):
                logger.debug("%s: %s", name, answer["traceback"])
            error = _KNOWN.get(str(answer["error"]), PhotographError)
            raise error(_LINE_ENDS.sub(" ", str(answer.get("message"))), hint=str(answer.get("hint") or ""))
        try:
            result: _Result = wire.from_plain(answer["value"], _kind_of_result(function), arrays)
        except _NONSENSE as error:
            raise nonsense(name, error) from error
        return result

    def ask(
        self, request: wire.Message, name: str, seconds: float
    ) -> tuple[wire.Message, list[NDArray[Any]]]:
        """Send a request about the photograph `name`: return the answer as it came, and its arrays.

        Raises `PhotographError` where the process dies, takes longer than `seconds` or answers nonsense; `Cancelled`
        within `stoppable`; `CapabilityError` if it does not start.
        """
        try:
            if not self._ready:
                self._await_start()
            try:
                wire.send(self._channel, request | {"free": self.window.is_free})
            except OSError as error:
                raise EOFError from error
            answer, fd = self._answer(seconds)
            return answer, self.window.arrays(answer, fd)
        except TimeoutError:
            self.end()
            reason = f"did not finish within {seconds:.0f} seconds"
        except EOFError:
            reason = f"crashed on it ({self._cause_of_death()})"
        except _NONSENSE as error:
            self.end()
            raise nonsense(name, error) from error
        except BaseException:  # Ctrl-C here would leave an answer that nobody waits for
            self.end()
            raise
        raise PhotographError(f"{name}: the decoder {reason}", hint=BROKEN)

    def _await_start(self) -> None:
        try:
            self._answer(SECONDS)
        except EOFError:
            raise _cannot_start(self._cause_of_death()) from None
        except TimeoutError:
            self.end()
            raise _cannot_start(f"it did not start within {SECONDS:.0f} seconds") from None
        self._ready = True

    def _answer(self, seconds: float) -> tuple[wire.Message, int | None]:
        end = time.monotonic() + seconds
        while not self._channel.poll(_TICK_SECONDS):
            if stopped():
                raise Cancelled
            if time.monotonic() > end:
                raise TimeoutError
        try:
            answer = wire.receive(self._channel)
        except ConnectionError as error:
            raise EOFError from error
        except BlockingIOError as error:  # the rest of a message does not come
            raise TimeoutError from error
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
            self._folder.close()

    def forget(self) -> None:
        """Let go of it in a forked process: it is the parent's."""
        self.dead = True
        self._process.forget()


@cache
def _kind_of_result(function: Callable[..., Any]) -> Any:
    return get_type_hints(function)["return"]


@lru_cache(maxsize=1)
def _free_memory(_second: int) -> int:
    """Return `memory.available()`, asked once a second: to ask takes as long as decoding a small photograph."""
    return memory.available()


def _cannot_start(reason: str) -> CapabilityError:
    return CapabilityError(
        f"no process to decode photographs could be started ({reason})",
        hint="photographs are decoded in further Python processes; see docs/troubleshooting.md",
    )
