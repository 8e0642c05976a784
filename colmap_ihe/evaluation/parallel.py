"""Methods of a comparison at the same time, as far as their matches, each in a process of its own."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from pathlib import Path

from colmap_ihe.errors import Cancelled
from colmap_ihe.machine import memory
from colmap_ihe.machine.progress import Progress
from colmap_ihe.pipeline.job import GRACE_SECONDS, Outcome, ProjectJob, run_job
from colmap_ihe.project.folder import Project

_TICK_SECONDS = 0.25


def match_together(
    projects: Sequence[Project],
    assignments: Sequence[str],
    developed: Path,
    jobs: int,
    executor: Executor | None,
    progress: Progress,
) -> None:
    """Runs them with what their project.yaml says, and `assignments` over it, `jobs` at a time here, or all on
    `executor`. What becomes of them is in their records: one that failed is not done, and fails again where it is run
    alone. Raises `Cancelled`."""
    stop_file = developed.with_name("stop")
    stop_file.unlink(missing_ok=True)
    share = 0 if executor else memory.available() // jobs
    progress.start(len(projects), "methods")
    with ExitStack() as stack:
        pool = executor or stack.enter_context(ThreadPoolExecutor(jobs, thread_name_prefix="method"))
        futures: list[Future[Outcome]] = []
        for one in projects:
            job = ProjectJob(
                str(one.root),
                tuple(assignments),
                images=str(one.images),
                until="matches",
                developed=str(developed),
                memory_bytes=share,
                stop_file=str(stop_file),
            )
            futures.append(pool.submit(run_job, job))
        try:
            left = set(futures)
            while left:
                done, left = wait(left, _TICK_SECONDS)
                progress.advance(len(done))
        except Cancelled:
            stop_file.touch()
            for future in futures:
                future.cancel()
            wait(futures, GRACE_SECONDS + 15)
            stop_file.unlink(missing_ok=True)
            raise
