"""Worker processes on this machine, for `local:N`: a scheduler in this process, and N workers of one thread."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from distributed import LocalCluster

from colmap_ihe.machine.scratch import scratch_folder

_END_SECONDS = 10
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1));"  # the same modules as here
    " from distributed.cli.dask_worker import main; main()"
)


@contextmanager
def local_workers(count: int, log: Path) -> Iterator[str]:
    """The address of their scheduler. A worker that dies is started again; what they say goes into `log`.

    They are fresh Pythons in a session of their own: none of `multiprocessing`, which would run the user's script
    again, and Ctrl-C in the terminal is for us. They end with the scheduler, however this process ends.
    """
    with scratch_folder() as scratch:
        cluster = LocalCluster(
            n_workers=0, dashboard_address="127.0.0.1:0", silence_logs=50, host="127.0.0.1"
        )
        processes: list[subprocess.Popen[bytes]] = []
        try:
            log.parent.mkdir(parents=True, exist_ok=True)
            with log.open("wb") as words:
                address = cluster.scheduler_address
                processes += [_started(address, f"local-{n}", scratch, words) for n in range(count)]
            yield address
        finally:
            for process in processes:
                process.terminate()
            for process in processes:
                try:
                    process.wait(_END_SECONDS)
                except subprocess.TimeoutExpired:
                    with suppress(ProcessLookupError):
                        os.killpg(process.pid, 9)
                    process.wait()
            cluster.close(timeout=_END_SECONDS)


def _started(address: str, name: str, scratch: Path, words: BinaryIO) -> subprocess.Popen[bytes]:
    worker = [sys.executable, "-c", _START, json.dumps(sys.path), address, "--nthreads", "1", "--name", name]
    limits = [
        "--memory-limit",
        "0",
        "--no-dashboard",
        "--local-directory",
        str(scratch),
        "--death-timeout",
        "60",
    ]
    return subprocess.Popen(
        [*worker, *limits],
        stdin=subprocess.DEVNULL,
        stdout=words,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )
