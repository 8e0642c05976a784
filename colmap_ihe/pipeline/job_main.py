"""Program that reconstructs one project: it tells `job`, which starts it, how far it is, a line of JSON at a time."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any

from colmap_ihe.errors import BusyError, Cancelled, KnownError, NativeError, ShortOfMemoryError
from colmap_ihe.machine import memory
from colmap_ihe.machine.progress import Progress, Silent
from colmap_ihe.machine.system import offer_to_be_killed
from colmap_ihe.pipeline.job import GOES_ON, LESS_MEMORY
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.options_file import project_options

_GRACE_SECONDS = 20.0
"""Until a run that nobody waits for any more ends itself; less than `job` waits."""
_TELL_SECONDS = 0.5
_LIKELIER = 500
"""Than other processes to be ended by the system when memory runs out; the batch itself should not be."""


class _Teller(Silent):
    """Write the progress of the run to a pipe."""

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._out = os.fdopen(descriptor, "w", encoding="utf-8")
        self._lock = threading.Lock()
        self._stage, self._done, self._total, self._next = "", 0, 0, 0.0

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        self.check()
        self._stage, self._done, self._total = name, 0, 0
        self._tell()
        yield self

    def start(self, total: int, unit: str = "images") -> None:
        self._done, self._total = 0, total
        super().start(total, unit)

    def advance(self, count: int = 1) -> None:
        with self._lock:
            self._done += count
            due = time.monotonic() >= self._next
        if due:
            self._tell()
        super().advance(count)

    def warn(self, text: str) -> None:
        print(f"warning: {text}", file=sys.stderr, flush=True)

    def _tell(self) -> None:
        self._next = time.monotonic() + _TELL_SECONDS
        self.say({"stage": self._stage, "done": self._done, "total": self._total})

    def say(self, values: dict[str, Any]) -> None:
        with self._lock, suppress(OSError):  # nobody listens any more: the lifeline ends the run
            self._out.write(json.dumps(values) + "\n")
            self._out.flush()


def main() -> None:
    """Run the job in the first argument. Never returns: a mapper that cannot be asked to stop may be on its thread."""
    teller = _Teller(os.dup(1))
    os.dup2(2, 1)  # what a library prints goes to the log
    _listen(teller)
    warnings.filterwarnings("ignore", module=r"PIL\b")
    logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s", stream=sys.stderr)
    offer_to_be_killed(_LIKELIER)
    state, reason, hint = _run(json.loads(sys.argv[2]), teller)
    teller.say({"ended": {"state": state, "reason": reason, "hint": hint}})
    sys.stderr.flush()
    os._exit(0)


def _listen(teller: _Teller) -> None:
    def on_signal(_number: int, _frame: FrameType | None) -> None:
        teller.cancelled = True

    def until_closed() -> None:
        while os.read(0, 1024):
            pass
        teller.cancelled = True
        time.sleep(_GRACE_SECONDS)
        os._exit(1)

    signal.signal(signal.SIGTERM, on_signal)
    threading.Thread(target=until_closed, name="lifeline", daemon=True).start()


def _run(job: dict[str, Any], teller: _Teller) -> tuple[str, str, str]:
    """Reconstruct, and return how it ended, why, and what to do."""
    memory.keep_within(job["memory_bytes"])
    root = Path(job["root"])
    try:
        reconstruct(root, project_options(root, job["assignments"]), progress=teller)
    except Cancelled:
        return "stopped", "stopped", GOES_ON
    except BusyError as error:
        return "busy", str(error), error.hint
    except (MemoryError, ShortOfMemoryError) as error:
        return "out_of_memory", str(error) or "memory ran out", LESS_MEMORY
    except KnownError as error:
        if isinstance(error, NativeError) and "bad_alloc" in str(error):
            return "out_of_memory", f"memory ran out: {error}", LESS_MEMORY
        return "failed", str(error), error.hint
    except OSError as error:
        file = f"{error.filename}: " if error.filename else ""
        return "failed", f"{file}{error.strerror or error}", "see the log"
    except Exception as error:  # noqa: BLE001  the batch goes on, and the log holds all of it
        traceback.print_exc()
        words = f"an error that we did not expect: {type(error).__name__}: {error}"
        return "crashed", words, "please report it, with records/batch.log"
    return "done", "", ""
