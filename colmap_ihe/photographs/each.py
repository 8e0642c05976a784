"""Work on one photograph at a time; those that cannot be used are left out."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from functools import partial
from typing import Protocol, TypeVar

from colmap_ihe.errors import PhotographError, ProjectError
from colmap_ihe.machine import memory
from colmap_ihe.machine.executor import in_order, shares_memory
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.machine.words import listed
from colmap_ihe.photographs.discover import Capture

logger = logging.getLogger(__name__)

LeftOut = dict[str, str]
"""Captures that cannot be used, by name, each with the reason and what to do."""


class _Photograph(Protocol):
    @property
    def capture(self) -> Capture: ...


_One = TypeVar("_One", bound="Capture | _Photograph")
_Result = TypeVar("_Result")


def each_usable(
    function: Callable[[_One], _Result],
    photographs: Sequence[_One],
    executor: Executor,
    progress: Progress,
    strict: bool,
    left_out: LeftOut,
) -> Iterable[_Result]:
    """Yield `function` of every capture, or what has one, that can be used; the others go to `left_out`, or end the
    run if strict.

    As many at a time as there are workers, or fewer if memory has no room for so many of the largest; on other
    machines as many as they have workers, for their memory is theirs to know.
    """
    captures = [item if isinstance(item, Capture) else item.capture for item in photographs]
    progress.start(len(captures))
    usable = 0
    most = at_once(captures, executor)
    guarded = partial(_guarded, function)
    results = in_order(executor, guarded, photographs, most, progress)
    for capture, result in zip(captures, results, strict=True):
        progress.advance()
        if isinstance(result, PhotographError):
            leave_out(capture, result, strict, left_out)
            continue
        usable += 1
        yield result
    if not usable:
        raise none_usable(left_out)


def at_once(captures: Sequence[Capture], executor: Executor) -> int | None:
    """Return how many photographs at a time memory has room for, None if that is as many as there are workers; on
    other machines None, for their memory is theirs to know."""
    if not shares_memory(executor):
        return None
    count = memory.at_once(captures, local_workers())
    logger.info("%s", memory.in_words(captures, count))
    return count if count < local_workers() else None


def leave_out(capture: Capture, error: PhotographError, strict: bool, left_out: LeftOut) -> None:
    """Note a photograph that cannot be used; raise the error if strict, and `ProjectError` where it is not broken but
    gone: a disk that goes half-way must not come to a smaller set."""
    try:
        capture.path.lstat()  # a link to nowhere was none before
    except PermissionError:
        pass
    except OSError as gone:
        raise ProjectError(
            f"{capture.path}: was there when the run began, and is not any more ({gone.strerror})",
            hint="connect its disk again, or if it was taken out go on without it: by the same command",
        ) from error
    error = _by_whole_name(capture, error)
    if strict:
        raise error
    hint = error.hint
    if hint and capture.paired:
        hint = f"{hint}; without it {capture.paired[0]} is used"
    left_out[capture.name] = f"{error}; {hint}" if hint else str(error)


def _by_whole_name(capture: Capture, error: PhotographError) -> PhotographError:
    """Return the error with the photograph's folder: a card has the same names in several."""
    file, words = capture.path.name, str(error)
    if file == capture.name or not words.startswith(f"{file}: "):
        return error
    return PhotographError(f"{capture.name}{words.removeprefix(file)}", hint=error.hint)


def refused(reasons: Mapping[str, str], strict: bool) -> LeftOut:
    """Return what is left out before anything is read; raise `PhotographError` for the first if strict."""
    for reason in reasons.values() if strict else ():
        message, _, hint = reason.partition("; ")
        raise PhotographError(message, hint=hint)
    return dict(reasons)


def none_usable(left_out: LeftOut) -> ProjectError:
    """Return the error of a set of which every photograph is left out, with the reasons and what to do about each."""
    words = [reason.partition("; ") for reason in left_out.values()]
    hints = dict.fromkeys(hint for _, _, hint in words if hint)
    reasons = listed([reason for reason, _, _ in words], 3, "; ")
    which = "the only photograph" if len(left_out) == 1 else f"none of the {len(left_out)} photographs"
    cannot = "cannot" if len(left_out) == 1 else "can"
    return ProjectError(f"{which} {cannot} be used: {reasons}", hint=listed(hints, 3, "; or "))


def _guarded(function: Callable[[_One], _Result], item: _One) -> _Result | PhotographError:
    try:
        return function(item)
    except PhotographError as error:
        return error
