"""Python processes that this one starts, for work that may crash, hang or be stopped alone.

Each is a fresh Python with the modules of this one: not forked, for native libraries with threads can deadlock then,
nor of `multiprocessing`, which would run the user's script again. It is in a session of its own, since Ctrl-C in the
terminal is for this process. Its stdin is a lifeline: that closes when this process ends, however it ends.
"""

from __future__ import annotations

import fcntl
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from types import MappingProxyType
from typing import IO

from colmap_ihe.machine.scratch import anonymous_file

_MOST_WORDS = 1 << 16  # bytes
_STDIN = 0


class ChildProcess:
    """Hold one process, what it wrote to stderr, and its lifeline."""

    def __init__(
        self,
        module: str,
        *arguments: str,
        pass_fds: Sequence[int] = (),
        environment: Mapping[str, str] = MappingProxyType({}),
        errors: int | None = None,
        piped: bool = False,
    ) -> None:
        """Start `main()` of `module` with `arguments` as sys.argv[1:] and `environment` over that of this process.

        `errors` is the descriptor of stderr, by default a file in memory. stdout goes there too, or if `piped` to
        `self.output`. Raises OSError.
        """
        self._open = ExitStack()
        try:
            self._words = anonymous_file() if errors is None else os.dup(errors)
            self._open.callback(os.close, self._words)
            lifeline, theirs = socket.socketpair()
            self._lifeline = self._open.enter_context(lifeline)
            with theirs:
                self._process = subprocess.Popen(
                    [sys.executable or "python3", "-c", code_of(module), *arguments],
                    pass_fds=pass_fds,
                    stdin=theirs.fileno(),
                    stdout=subprocess.PIPE if piped else self._words,
                    stderr=self._words,
                    start_new_session=True,
                    env=os.environ | environment,
                )
        except BaseException:
            self._open.close()
            raise
        if self._process.stdout is not None:
            self._open.enter_context(self._process.stdout)

    @property
    def pid(self) -> int:
        """Return the number of the process."""
        return self._process.pid

    @property
    def output(self) -> IO[bytes]:
        """Return the pipe from its stdout."""
        assert self._process.stdout is not None
        return self._process.stdout

    def status(self, seconds: float | None = 0.0) -> int | None:
        """Wait for its end, `seconds` at most or for ever: return its exit status, -N for signal N, None if it runs."""
        with suppress(subprocess.TimeoutExpired):
            return self._process.poll() if seconds == 0 else self._process.wait(seconds)
        return None

    def close_lifeline(self) -> None:
        """Tell it that it is to end."""
        self._lifeline.close()

    def kill(self) -> None:
        """Kill it and what it started, unless it has ended."""
        if self._process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)

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
            size = os.fstat(self._words).st_size
            return os.pread(self._words, _MOST_WORDS, max(0, size - _MOST_WORDS)).decode("utf-8", "replace")
        return ""

    def cause_of_death(self, seconds: float) -> str:
        """Wait for its end, `seconds` at most: return the signal that ended it, else its last words or its status."""
        status = self.status(seconds)
        if status is not None and status < 0:
            name = signal_name(-status)
            return f"{name}, perhaps for want of memory" if name == "SIGKILL" else name
        lines = self.words().strip().splitlines()
        return lines[-1] if lines else f"exit status {status}"


def code_of(module: str) -> str:
    """Return the program of a child: `main()` of a module, found where this process finds it."""
    return f"import sys; sys.path[:] = {sys.path!r}; from {module} import main; main()"


def signal_name(number: int) -> str:
    """Return SIGSEGV for 11."""
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def die_with_parent() -> None:
    """Have this child end as soon as its lifeline closes, be it deep in a native loop: by SIGIO, which would come of
    what is sent as well, and late, so nothing ever is."""
    if hasattr(fcntl, "F_SETOWN"):
        fcntl.fcntl(_STDIN, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(_STDIN, fcntl.F_SETFL, fcntl.fcntl(_STDIN, fcntl.F_GETFL) | fcntl.FASYNC)
