"""Start worker processes on this machine, for `local:N`: a scheduler in this process, and N workers of one thread.

`distributed.LocalCluster` starts its workers with `multiprocessing`: it runs the user's script again in each of them
unless that is guarded, and they print on our stdout. `dask worker` is a fresh Python, here in a session of its own,
since Ctrl-C in the terminal is for us. Workers end with the scheduler, however this process ends.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from distributed import LocalCluster

from colmap_ihe.machine.scratch import scratch_folder

_END_SECONDS = 10
_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1));"  # the same modules as here
    " from distributed.cli.dask_worker import main; main()"
)
_LIMITS = ["--nthreads", "1", "--memory-limit", "0", "--no-dashboard", "--death-timeout", "60"]


@contextmanager
def local_workers(count: int, log: Path) -> Iterator[str]:
    """Give the address of their scheduler. A worker that dies is started again; what they print goes into `log`."""
    log.parent.mkdir(parents=True, exist_ok=True)
    scheduler = LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0", silence_logs=50, host="127.0.0.1")
    with scratch_folder() as scratch, log.open("wb") as output, scheduler:
        address = scheduler.scheduler_address
        command = [sys.executable, "-c", _START, json.dumps(sys.path), address, "--nworkers", str(count)]
        workers = subprocess.Popen(
            [*command, *_LIMITS, "--name", "local", "--local-directory", str(scratch)],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            yield address
        finally:
            workers.terminate()
            try:
                workers.wait(_END_SECONDS)
            except subprocess.TimeoutExpired:
                os.killpg(workers.pid, signal.SIGKILL)
                workers.wait()
