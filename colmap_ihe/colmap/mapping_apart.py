"""Mappers of COLMAP that cannot be asked to stop, in a process of their own, which can be ended.

pycolmap 4.2 gives neither `hierarchical_mapping` nor `global_mapping`, nor the classes behind them, a token to cancel
with. On a thread they would go on after Ctrl-C, for hours in a large set, beside whatever comes next.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from colmap_ihe import threads
from colmap_ihe.colmap import native
from colmap_ihe.colmap.native import apply_options, called, fill, logged_to, pycolmap
from colmap_ihe.errors import KnownError, NativeError
from colmap_ihe.progress import SILENT, Watch

_START = "import sys; sys.path[:] = sys.argv[1:]; from colmap_ihe.colmap.mapping_apart import main; main()"
_POLL_SECONDS = 0.2
_KNOWN = 3  # exit status: what is on stderr is a sentence for the user

MAPPERS: dict[str, tuple[Any, Any]] = {
    "global": (pycolmap.global_mapping, pycolmap.GlobalPipelineOptions),
    "hierarchical": (pycolmap.hierarchical_mapping, pycolmap.HierarchicalPipelineOptions),
}


def pipeline_options(mapper: str, values: Mapping[str, Any]) -> Any:
    """The options of one of `MAPPERS`. The hierarchical one takes those of the incremental mapper, with which it maps
    its parts, by their own names too. Raises `OptionError`."""
    settings = MAPPERS[mapper][1]()
    of_parts = getattr(settings, "incremental_options", None)
    passed_on = {n: v for n, v in values.items() if not hasattr(settings, n) and hasattr(of_parts, n)}
    if passed_on:
        apply_options(settings, {"incremental_options": passed_on}, "sparse.colmap")
    apply_options(settings, {n: v for n, v in values.items() if n not in passed_on}, "sparse.colmap")
    return settings


def map_apart(
    mapper: str, database: Path, grey: Path, out: Path, options: Mapping[str, Any], seed: int, watch: Watch
) -> dict[int, pycolmap.Reconstruction]:
    """The models that one of `MAPPERS` finds; it writes them below `out`. Raises `NativeError`, also where its
    process died, and `Cancelled`, when it has ended."""
    request = {
        "mapper": mapper,
        "database": str(database),
        "grey": str(grey),
        "out": str(out),
        "options": dict(options),
        "seed": seed,
        "threads": threads.limit(),
        "log": native.log_file(),
    }
    with (
        TemporaryFile() as words,
        subprocess.Popen(
            [sys.executable, "-c", _START, *sys.path],
            stdin=subprocess.PIPE,
            stdout=words,
            stderr=words,
            start_new_session=True,  # Ctrl-C in the terminal is for us
            env=os.environ | threads.environment(),
        ) as process,
    ):
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()  # and left open: it ends when this process does
            while process.poll() is None:
                watch.check()
                try:
                    process.wait(_POLL_SECONDS)
                except subprocess.TimeoutExpired:
                    continue
        except BrokenPipeError:
            process.wait()
        except BaseException:
            process.kill()
            raise
        words.seek(0)
        if process.returncode:
            raise _failed(process.returncode, words.read().decode("utf-8", "replace"))
    folders = sorted((p for p in out.iterdir() if p.is_dir()), key=lambda p: p.name)
    return {number: pycolmap.Reconstruction(folder) for number, folder in enumerate(folders)}


def _failed(status: int, words: str) -> NativeError:
    lines = words.strip().splitlines()
    if status == _KNOWN and lines:
        return NativeError(lines[-1])
    if status < 0:
        died = signal.Signals(-status).name
        why = f"{died}, perhaps for want of memory" if died == "SIGKILL" else died
        return NativeError(f"COLMAP's mapper died ({why})", hint="records/colmap.log.* holds its own log")
    last = lines[-1] if lines else f"exit status {status}"
    return NativeError(f"COLMAP's mapper failed: {last}", hint="records/colmap.log.* holds its own log")


def main() -> None:
    """In that process: reads the request from stdin, and ends when stdin does."""
    request = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_stdin, daemon=True).start()
    function, _ = MAPPERS[request["mapper"]]
    with ExitStack() as stack:
        stack.enter_context(threads.limited(request["threads"]))
        if request["log"]:
            stack.enter_context(logged_to(Path(request["log"])))
        try:
            settings = pipeline_options(request["mapper"], request["options"])
            fill(settings, {"random_seed": request["seed"]})
            called(
                function,
                *(Path(request[name]) for name in ("database", "grey", "out")),
                options=settings,
                watch=SILENT,
                cancellable=False,
            )
        except KnownError as error:
            print(f"{error} ({error.hint})" if error.hint else error, file=sys.stderr)
            sys.exit(_KNOWN)


def _end_with_stdin() -> None:
    sys.stdin.read()
    os._exit(1)
