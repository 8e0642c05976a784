"""Hide from this package, and from nothing else, what Windows has not: modules, functions, signals, /proc and links.

`scripts/test-portable` runs the tests so: by sitecustomize.py, in pytest and in each Python that a test starts.
sys.platform stays as it is, and libraries see all there is.
"""

from __future__ import annotations

import builtins
import fcntl
import importlib
import pathlib
import sys
import types
from collections.abc import Callable
from typing import Any

PACKAGE = "colmap_ihe"
MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "readline", "resource", "syslog", "termios", "tty"}
NAMES = {
    "os": (
        "O_CLOEXEC O_DIRECTORY O_NOFOLLOW O_NONBLOCK O_SYNC MFD_ALLOW_SEALING MFD_CLOEXEC SCHED_IDLE WNOHANG chown"
        " chroot fchdir fchmod fchown fork forkpty getegid geteuid getgid getgroups getloadavg getpgid getpgrp"
        " getpriority getresuid getsid getuid killpg lchown lockf major memfd_create minor mkfifo mknod nice"
        " openpty pidfd_open pipe2 posix_fadvise posix_fallocate posix_spawn pread preadv pwrite register_at_fork"
        " sched_getaffinity sched_setaffinity sched_yield sendfile setegid seteuid setgid setpgid setpriority setsid"
        " setuid statvfs fstatvfs sync sysconf tcgetpgrp uname wait wait3 wait4 waitid"
    ),
    "signal": (
        "ITIMER_REAL SIGALRM SIGBUS SIGCHLD SIGCONT SIGHUP SIGIO SIGKILL SIGPIPE SIGPOLL SIGQUIT SIGSTOP SIGUSR1"
        " SIGUSR2 alarm pause pthread_kill pthread_sigmask set_wakeup_fd setitimer sigwait"
    ),
    "socket": "AF_UNIX CMSG_SPACE SCM_RIGHTS recv_fds send_fds",
    "select": "epoll poll kqueue",
    "mmap": "MADV_REMOVE MADV_DONTNEED MAP_PRIVATE MAP_SHARED PROT_READ PROT_WRITE",
}
FOLDERS = ("/proc", "/sys/fs/cgroup")


class _WithoutNames(types.ModuleType):
    """Stand for a module without some of its names."""

    def __init__(self, module: types.ModuleType, names: str) -> None:
        super().__init__(module.__name__)
        self.__dict__.update(_module=module, _names=frozenset(names.split()))

    def __getattr__(self, name: str) -> Any:
        if name in self.__dict__["_names"]:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r} on this system")
        return getattr(self.__dict__["_module"], name)


def _locking(descriptor: int, mode: int, _bytes: int) -> None:
    """Lock as Windows does, by what Linux has."""
    try:
        fcntl.flock(descriptor, mode)
    except BlockingIOError as error:
        raise PermissionError(*error.args) from error


def _fake_msvcrt() -> types.ModuleType:
    module = types.ModuleType("msvcrt")
    module.__dict__.update(locking=_locking, LK_NBLCK=fcntl.LOCK_EX | fcntl.LOCK_NB)
    return module


_SEEN = {name: _WithoutNames(importlib.import_module(name), names) for name, names in NAMES.items()}
_SEEN["msvcrt"] = _fake_msvcrt()  # type: ignore[assignment]
_import, _import_module = builtins.__import__, importlib.import_module


def _is_ours(name: object) -> bool:
    return str(name).partition(".")[0] == PACKAGE


def _imported(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:
    if level or not globals or not _is_ours(globals.get("__name__")):
        return _import(name, globals, locals, fromlist, level)
    if name in MODULES:
        raise ModuleNotFoundError(f"No module named {name!r} on this system", name=name)
    return _SEEN.get(name) or _import(name, globals, locals, fromlist, level)


def _imported_module(name: str, package: str | None = None) -> Any:
    if not _is_ours(sys._getframe(1).f_globals.get("__name__")):
        return _import_module(name, package)
    if name in MODULES:
        raise ModuleNotFoundError(f"No module named {name!r} on this system", name=name)
    return _SEEN.get(name) or _import_module(name, package)


def _hidden_from_us(
    method: Callable[..., Any], refuses: Callable[[pathlib.Path], bool]
) -> Callable[..., Any]:
    def seen(path: pathlib.Path, *arguments: Any, **named: Any) -> Any:
        if refuses(path) and _is_ours(sys._getframe(1).f_globals.get("__name__")):
            raise FileNotFoundError(2, "not on this system", str(path))
        return method(path, *arguments, **named)

    return seen


def _hide() -> None:
    builtins.__import__ = _imported
    importlib.import_module = _imported_module
    for name in ("open", "read_text", "read_bytes", "write_text"):
        method = getattr(pathlib.Path, name)
        setattr(pathlib.Path, name, _hidden_from_us(method, lambda path: str(path).startswith(FOLDERS)))
    exists = pathlib.Path.exists
    seen = lambda path: exists(path) and not str(path).startswith(FOLDERS)  # noqa: E731
    setattr(pathlib.Path, "exists", seen)  # noqa: B010
    pathlib.Path.symlink_to = _hidden_from_us(pathlib.Path.symlink_to, lambda _: True)  # type: ignore[method-assign]


if PACKAGE not in sys.modules:
    _hide()
else:
    raise RuntimeError(f"{PACKAGE} was imported before what it is not to see was hidden")
