"""Describe a batch for a person: a picture while it runs, rows of a table when it has ended."""

from __future__ import annotations

from rich.console import Group
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from colmap_ihe.batch.state import BatchState, ProjectState, facts_of
from colmap_ihe.commandline.display import printable
from colmap_ihe.report.charts import duration

_MOST_LINES = 12  # of running projects


def outcome_in_words(project: ProjectState) -> str:
    """Return the state of a project with its reason, or with its figures if it is done."""
    if project.reason:
        return f"{project.in_words}: {project.reason}" + (f" ({project.hint})" if project.hint else "")
    facts = ", ".join(f"{name} {value}" for name, value in facts_of(project))
    return f"{project.in_words}: {facts}" if project.state == "done" and facts else project.in_words


def batch_picture(state: BatchState) -> Group:
    """Return a line for each project that runs, and a bar for all projects."""
    rows = Table.grid(padding=(0, 2))
    running = [project for project in state.projects if project.state == "running"]
    for project in running[:_MOST_LINES]:
        done, total = project.progress or (0, 0)
        units = f"{done} of {total}" if total > 1 else ""
        rows.add_row(Text(printable(project.name)), Text(project.stage or "starts"), Text(units))
    if len(running) > _MOST_LINES:
        rows.add_row(Text(f"and {len(running) - _MOST_LINES} more"))
    whole = Table.grid(padding=(0, 2))
    bar = ProgressBar(total=max(1, len(state.projects)), completed=state.ended, width=32)
    whole.add_row(bar, Text(state.in_words()))
    return Group(rows, whole)


def batch_rows(state: BatchState) -> list[tuple[str, ...]]:
    """Return of each project its name, state, registered images, mean error, time, and why."""
    rows: list[tuple[str, ...]] = []
    for project in state.projects:
        figures = project.figures
        registered, error = figures.get("registered_images"), figures.get("mean_reprojection_error_px")
        rows.append(
            (
                project.name,
                project.in_words,
                "" if registered is None else f"{registered} of {figures['images']}",
                "" if error is None else f"{error:.2f} px",
                duration(sum(project.stages.values())) if project.stages else "",
                project.reason,
            )
        )
    return rows
