"""Python processes that this one starts, for work that may crash, hang or be stopped alone.

Each is a fresh Python with the modules of this one: not forked, for native libraries with threads can deadlock then,
nor of `multiprocessing`, which would run the user's script again. It is in a session of its own, or on Windows has no
console, since Ctrl-C in the terminal is for this process. Its stdin is a lifeline: that closes when this process ends,
however it ends.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from multiprocessing.connection import Pipe
from queue import Empty, SimpleQueue
from types import MappingProxyType
from typing import IO, Any

from colmap_ihe.machine import system

if sys.platform == "win32":
    from multiprocessing.connection import PipeConnection
else:
    from multiprocessing.connection import Connection as PipeConnection

Channel = PipeConnection

_MOST_WORDS = 1 << 16  # bytes
_STDIN, _STDERR = 0, 2
_CRASHES = {0xC0000005: "access violation", 0xC00000FD: "stack overflow", 0xC0000409: "abort"}  # of Windows


class ChildProcess:
    """Hold one process, what it wrote to stderr, and its lifeline."""

    def __init__(
        self,
        module: str,
        *arguments: str,
        environment: Mapping[str, str] = MappingProxyType({}),
        errors: int | None = None,
        piped: bool = False,
    ) -> None:
        """Start `main()` of `module` with `environment` over that of this process; `arguments` are sys.argv[2:], and
        sys.argv[1] is for `channel_to_parent`.

        `errors` is the descriptor of stderr, by default a file in memory. stdout goes there too, or if `piped` to
        `lines`. Raises OSError.
        """
        self._open = ExitStack()
        try:
            self._words = system.anonymous_file() if errors is None else os.dup(errors)
            self._open.callback(os.close, self._words)
            self.channel, theirs = Pipe()
            self._open.callback(self.channel.close)
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable or "python3", "-c", code_of(module), str(theirs.fileno()), *arguments],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE if piped else self._words,
                    stderr=self._words,
                    env=os.environ | environment,
                    **_alone_with(theirs.fileno()),
                )
        except BaseException:
            self._open.close()
            raise
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                self._open.enter_context(pipe)

    @property
    def pid(self) -> int:
        """Return the number of the process."""
        return self._process.pid

    def lines(self, seconds: float) -> Iterator[bytes]:
        """Yield each line of its stdout until that is closed, and an empty one after so many seconds without any."""
        lines: SimpleQueue[bytes] = SimpleQueue()
        threading.Thread(target=_put_lines, args=(self._process.stdout, lines), daemon=True).start()
        while True:
            try:
                line = lines.get(timeout=seconds)
            except Empty:
                yield b""
                continue
            if not line:
                return
            yield line

    def status(self, seconds: float | None = 0.0) -> int | None:
        """Wait for its end, `seconds` at most or for ever: return its exit status, -N for signal N, None if it runs."""
        with suppress(subprocess.TimeoutExpired):
            return self._process.poll() if seconds == 0 else self._process.wait(seconds)
        return None

    def close_lifeline(self) -> None:
        """Tell it that it is to end."""
        assert self._process.stdin is not None
        self._process.stdin.close()

    def kill(self) -> None:
        """Kill it and what it started, unless it has ended."""
        if self._process.poll() is None:
            system.kill(self._process.pid)

    def end(self) -> None:
        """Kill it, and close what is open of it here."""
        self.kill()
        self._process.wait()
        self._open.close()

    def forget(self) -> None:
        """Close what is open of it here, in a forked process whose parent's it is."""
        self._process.returncode = self._process.returncode or 0
        self._open.close()

    def words(self) -> str:
        """Return the end of what it wrote to stderr, empty if that cannot be read."""
        with suppress(OSError):
            return _end_of(self._words)
        return ""

    def cause_of_death(self, seconds: float) -> str:
        """Wait for its end, `seconds` at most: return the signal that ended it, else its last words or its status."""
        status = self.status(seconds)
        if name := crash_of(status):
            return f"{name}, perhaps for want of memory" if name == "SIGKILL" else name
        lines = self.words().strip().splitlines()
        return lines[-1] if lines else f"exit status {status}"


def code_of(module: str) -> str:
    """Return the program of a child: `main()` of a module, found where this process finds it."""
    return f"import sys; sys.path[:] = {sys.path!r}; from {module} import main; main()"


def crash_of(status: int | None) -> str:
    """Return what ended a process of this exit status: "SIGSEGV" for -11; empty if it ended by itself or runs."""
    if status is None or status >= 0:
        return _CRASHES.get(status or 0, "")
    try:
        return signal.Signals(-status).name
    except ValueError:
        return f"signal {-status}"


def channel_to_parent() -> Channel:
    """Return the child's end of `ChildProcess.channel`."""
    return Channel(int(sys.argv[1]))


def die_with_parent() -> None:
    """Have this child end as soon as its lifeline closes. By SIGIO that is at once, be it deep in a native loop, and
    SIGIO would come of what is sent as well, and late, so nothing ever is; by a thread, as soon as Python runs."""
    if hasattr(signal, "SIGIO"):
        fcntl = system.fcntl
        if hasattr(fcntl, "F_SETOWN"):
            fcntl.fcntl(_STDIN, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(_STDIN, fcntl.F_SETFL, fcntl.fcntl(_STDIN, fcntl.F_GETFL) | fcntl.FASYNC)
    else:
        threading.Thread(target=_end_with_lifeline, name="lifeline", daemon=True).start()


def forget_own_words() -> None:
    """Empty the file that this child's stderr is."""
    os.lseek(_STDERR, 0, os.SEEK_SET)
    os.ftruncate(_STDERR, 0)


def own_words() -> str:
    """Return the end of what this child wrote to stderr since `forget_own_words`."""
    return _end_of(_STDERR)


def _alone_with(handle: int) -> dict[str, Any]:
    """Return how Popen starts a process that no key in this terminal reaches and that inherits `handle`."""
    if sys.platform == "win32":
        os.set_handle_inheritable(handle, True)
        startup = subprocess.STARTUPINFO(lpAttributeList={"handle_list": [handle]})
        return {"creationflags": subprocess.CREATE_NO_WINDOW, "startupinfo": startup}
    return {"pass_fds": (handle,), "start_new_session": True}


def _end_of(descriptor: int) -> str:
    """Return the last of the text in a file that is written on at its end."""
    size = os.lseek(descriptor, 0, os.SEEK_END)
    os.lseek(descriptor, max(0, size - _MOST_WORDS), os.SEEK_SET)
    return os.read(descriptor, _MOST_WORDS).decode("utf-8", "replace")


def _put_lines(pipe: IO[bytes], lines: SimpleQueue[bytes]) -> None:
    with suppress(OSError, ValueError):  # it was closed here
        for line in pipe:
            lines.put(line)
    lines.put(b"")


def _end_with_lifeline() -> None:
    while os.read(_STDIN, 1):
        pass
    os._exit(1)
