"""Keep pycolmap and its global state in one place: import order, log file, cancellation, errors.

Every module that drives COLMAP imports pycolmap from here.
"""

from __future__ import annotations

import ctypes
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol, TypeVar

from colmap_ihe.errors import Cancelled, CapabilityError, KnownError, NativeError, OptionError, did_you_mean
from colmap_ihe.machine import threads
from colmap_ihe.machine.libraries import pycolmap as pycolmap
from colmap_ihe.machine.progress import Progress

_T = TypeVar("_T")
_POLL_SECONDS, _STOP_SECONDS = 0.25, 60.0
_LOGS_KEPT = 4
_logs_to: list[Path] = []
_silence = threading.Lock()


def hear_colmap() -> None:
    """Send COLMAP's log to stderr too, from now on, where there is a COLMAP."""
    with suppress(CapabilityError):
        pycolmap.logging.alsologtostderr = True


def cuda_devices() -> int:
    """Return the number of CUDA devices for COLMAP: 0 for a pycolmap without CUDA, or where no driver finds one."""
    if not pycolmap.has_cuda:
        return 0
    count = ctypes.c_int(0)
    try:
        driver = ctypes.CDLL("libcuda.so.1")
        if driver.cuInit(0) or driver.cuDeviceGetCount(ctypes.byref(count)):
            return 0
    except (OSError, AttributeError):  # no driver, so no device
        return 0
    return count.value


def parameter_names(camera: pycolmap.Camera) -> list[str]:
    """Return the names of a camera's parameters, in COLMAP's order."""
    return camera.params_info.replace(" ", "").split(",")


class _Mergeable(Protocol):
    def mergedict(self, arg0: dict[Any, Any]) -> None: ...

    def todict(self) -> dict[str, Any]: ...


_Options = TypeVar("_Options", bound=_Mergeable)


def apply_options(target: _Options, values: Mapping[str, Any], section: str) -> _Options:
    """Set pycolmap's own options, and the threads that are left to COLMAP to as many as a run is limited to; return
    the options. COLMAP checks types itself. Raises `OptionError` that names `section`."""
    _refuse_unknown(target, values, section)
    if (most := threads.limit()) is not None:
        fill(target, dict.fromkeys(("num_threads", "num_workers"), most))
    try:
        with silent():
            target.mergedict(dict(values))
    except (AttributeError, TypeError, ValueError, RuntimeError) as error:
        why = _unfit(target, values, section) or f"{section}: {str(error).strip() or type(error).__name__}"
        raise OptionError(why, hint=f"see the options of pycolmap.{type(target).__name__}") from error
    return target


def _refuse_unknown(target: _Mergeable, values: Mapping[str, Any], section: str) -> None:
    """Raise `OptionError` for a name that COLMAP has not, which it would say in its own log too."""
    for name, value in values.items():
        if not hasattr(target, str(name)):
            hint = (
                did_you_mean(str(name), target.todict())
                or f"known there: {', '.join(sorted(target.todict()))}"
            )
            raise OptionError(f"{section}: COLMAP has no option {name!r} there", hint=hint)
        inner = getattr(target, str(name))
        if isinstance(value, Mapping) and hasattr(inner, "todict"):
            _refuse_unknown(inner, value, f"{section}.{name}")


def _unfit(target: _Mergeable, values: Mapping[str, Any], section: str) -> str:
    """Name the first value that COLMAP does not take, and one that it would; empty if it takes each."""
    for name, value in values.items():
        inner = getattr(target, name)
        if isinstance(value, Mapping) and hasattr(inner, "todict"):
            if why := _unfit(inner, value, f"{section}.{name}"):
                return why
            continue
        try:
            with silent():
                target.mergedict({name: value})
        except (AttributeError, TypeError, ValueError, RuntimeError):
            members = getattr(type(inner), "__members__", {})
            expected = f"one of {', '.join(members)}" if members else _like(inner)
            return f"{section}: {name} is {value!r:.100}; expected {expected}"
    return ""


def _like(value: Any) -> str:
    return (
        f"options of its own: {', '.join(value.todict())}"
        if hasattr(value, "todict")
        else f"a value such as {value!r:.60}"
    )


@contextmanager
def quiet(level: pycolmap.logging.Level | None = None) -> Iterator[None]:
    """Let COLMAP log only what is of this level, by default errors, for as long as this lasts; not to be entered by two
    threads at once."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR if level is None else level)
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before


@contextmanager
def silent() -> Iterator[None]:
    """Let COLMAP log nothing for as long as this lasts: what it refuses, a message of ours says."""
    with _silence, quiet(pycolmap.logging.FATAL):
        yield


def fill(target: _Mergeable, values: Mapping[str, int]) -> None:
    """Set the options named in `values` wherever in `target` they are -1: left to COLMAP."""
    target.mergedict(_unset(target.todict(), values))


def _unset(options: Mapping[str, Any], values: Mapping[str, int]) -> dict[str, Any]:
    changes: dict[str, Any] = {}
    for name, option in options.items():
        nested = option.todict() if hasattr(option, "todict") else option
        if isinstance(nested, dict):
            if inner := _unset(nested, values):
                changes[name] = inner
        elif name in values and option == -1:
            changes[name] = values[name]
    return changes


@contextmanager
def logged_to(file: Path, besides: bool = False) -> Iterator[None]:
    """Write COLMAP's own log beside `file`, instead of to stderr, for as long as this lasts. glog adds a date and the
    process to the name. The last few logs are kept, and `besides` another process's all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    for old in [] if besides else sorted(file.parent.glob(f"{file.name}.*"))[:-_LOGS_KEPT]:
        old.unlink(missing_ok=True)
    log = pycolmap.logging
    _logs_to.append(file)
    before = (log.logtostderr, log.stderrthreshold)
    log.set_log_destination(log.INFO, f"{file}.")  # glog writes what is graver there too
    for level in (log.WARNING, log.ERROR, log.FATAL):
        log.set_log_destination(level, "")
    log.logtostderr = False
    log.stderrthreshold = int(log.FATAL)
    try:
        yield
    finally:
        _logs_to.pop()
        log.logtostderr, log.stderrthreshold = before


def log_file() -> str:
    """Return the path of COLMAP's log, empty for stderr."""
    return str(_logs_to[-1]) if _logs_to else ""


def hush() -> None:
    """Let COLMAP print only errors on stderr in a worker, which has no log file."""
    if not _logs_to:
        pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)


def called(
    function: Callable[..., _T],
    *args: Any,
    progress: Progress,
    units_done: Callable[[], int] | None = None,
    cancellable: bool = True,
    **kwargs: Any,
) -> _T:
    """Call into COLMAP on a thread of its own, so that Ctrl-C is heard while it works.

    `units_done` returns the number of units done; `progress` is told of them a few times a second. On cancellation
    COLMAP is asked to stop, and waited for. Raises `Cancelled`, or `NativeError` with COLMAP's own words.
    """
    token = pycolmap.CancellationToken()
    if cancellable:
        kwargs["cancellation_token"] = token
    results: list[_T] = []
    failures: list[BaseException] = []

    def work() -> None:
        try:
            with threads.limit_openmp_of_this_thread():
                results.append(function(*args, **kwargs))
        except BaseException as error:  # noqa: BLE001  handed to the caller's thread below
            failures.append(error)

    thread = threading.Thread(target=work, name="colmap", daemon=True)
    thread.start()
    reported = 0
    try:
        while thread.is_alive():
            thread.join(_POLL_SECONDS)
            progress.check()
            if units_done is not None and (now := units_done()) > reported:
                progress.advance(now - reported)
                reported = now
    except BaseException:
        token.cancel()
        until = time.monotonic() + _STOP_SECONDS
        while cancellable and thread.is_alive() and time.monotonic() < until:
            thread.join(_POLL_SECONDS)
        raise
    if failures:
        raise translated(failures[0]) from failures[0]
    return results[0]


def translated(error: BaseException) -> BaseException:
    """Return what COLMAP throws as one of our errors; our own pass through."""
    if isinstance(error, KnownError | Cancelled | KeyboardInterrupt):
        return error
    lines = str(error).strip().splitlines()
    text = lines[0] if lines else type(error).__name__
    if "sqlite" in text.lower() or "disk" in text.lower():
        return NativeError(
            f"COLMAP could not use its database: {text}",
            hint="check that the disk has room and allows locking; the same command goes on from here",
        )
    return NativeError(f"COLMAP failed: {text}", hint="records/colmap.log.* in the project holds its own log")
