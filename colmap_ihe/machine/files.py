"""Files and folders that are whole or not there, what tells one from another, and whether the disk has room."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import secrets
import shutil
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import numpy as np
import xxhash
from numpy.typing import NDArray

from colmap_ihe.errors import DiskFullError, ProjectError
from colmap_ihe.machine.system import AT_ONCE

_UNFINISHED = re.compile(r"\.[0-9a-f]{24}\.[0-9a-f]+\.tmp")  # of `write_bytes`, when it was killed
_UNREADABLE = re.compile("[\\x00-\\x1f\\x7f-\\x9f\\ud800-\\udfff]")
_GONE = (errno.EIO, errno.ENODEV, errno.ENXIO, errno.ENOTCONN, errno.ETIMEDOUT, errno.EHOSTDOWN)
_NO_ANSWER = {*_GONE, *(getattr(errno, name) for name in ("ESTALE", "EREMOTEIO") if hasattr(errno, name))}
_MOST_JSON = 1 << 28  # bytes: digests of a million photographs
_LONGEST_NAME, _LONGEST_PATH = 255, 3000  # bytes, with room for the folder before it
_PIECE = 1 << 12  # bytes
_HELD_OPEN = (5, 32, 33)  # of Windows: denied, which it says of an open file too, shared, locked
_TOO_LONG = 206  # of Windows
_TRIES_SECONDS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
_WINDOWS_KEEPS = re.compile(
    r"(con|prn|aux|nul|(com|lpt)[1-9\u00b9\u00b2\u00b3])[ ]*(\..*)?|.*[<>:\"|?*\\].*|.*[. ]", re.IGNORECASE
)
_held: dict[Path, os.stat_result] = {}


def open_file(path: Path) -> BinaryIO:
    """Open a file to read; refuse a pipe, device or folder of that name, and never wait for one. Raises OSError."""
    handle = os.open(path, os.O_RDONLY | AT_ONCE)
    kind = os.fstat(handle).st_mode
    if not stat.S_ISREG(kind):
        os.close(handle)
        number = errno.EISDIR if stat.S_ISDIR(kind) else errno.EINVAL
        raise OSError(number, "Is a directory" if stat.S_ISDIR(kind) else "is a pipe or a device", str(path))
    return os.fdopen(handle, "rb")


def read_at_most(path: Path, most: int) -> bytes:
    """Return the content of a file of no more than `most` bytes. Raises OSError."""
    with open_file(path) as handle:
        content = handle.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"is larger than {most / 1e6:.0f} MB", str(path))
    return content


def is_readable_name(name: str) -> bool:
    """Tell whether a name of a file is text without control characters; spaces, joiners and hyphens of every script
    are text. Names that are not UTF-8 come with surrogates in the place of their bytes."""
    return _UNREADABLE.search(name) is None


def readable_name(name: str) -> str:
    """Return a name with its control characters and surrogates written out, as "a\\x07.jpg"."""
    return _UNREADABLE.sub(lambda found: ascii(found[0])[1:-1], name)


def is_name_below(name: str) -> bool:
    """Tell whether a file system could have a file of that name somewhere below a folder, and nowhere else."""
    path = PurePosixPath(name)
    if not path.parts or path.is_absolute() or ".." in path.parts or not is_readable_name(name):
        return False
    if os.name == "nt" and not all(map(is_name_of_windows, path.parts)):
        return False
    longest = max(len(part.encode("utf-8", "replace")) for part in path.parts)
    return longest <= _LONGEST_NAME and len(name.encode("utf-8", "replace")) <= _LONGEST_PATH


def is_name_of_windows(part: str) -> bool:
    """Tell whether Windows could have a file of that name: not of a device, as "con" and "nul.txt", and without a dot
    or a space at its end."""
    return _WINDOWS_KEEPS.fullmatch(part) is None


def replace_file(source: Path, target: Path) -> None:
    """Give `source` the name of `target`, which it takes the place of. Windows refuses that while a viewer or a virus
    scanner has one of them open: tried again for some seconds. Raises OSError."""
    for seconds in _TRIES_SECONDS:
        try:
            source.replace(target)
            return
        except PermissionError as error:
            if getattr(error, "winerror", 0) not in _HELD_OPEN:
                raise
            time.sleep(seconds)
    source.replace(target)


def leads_out(path: Path, folder: Path) -> bool:
    """Tell whether `path`, below `folder`, is or passes a link that ends elsewhere; `folder` may be a link."""
    return not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))


def odd_below(folder: Path, deep: bool = True) -> Iterator[Path]:
    """Yield what is neither file nor folder in a folder and, if `deep`, in the folders below: links, none of which is
    followed, pipes, devices. Raises OSError."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                if deep:
                    yield from odd_below(folder / entry.name)
            elif not entry.is_file(follow_symlinks=False):
                yield folder / entry.name


def link_or_copy(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the disk has no hard links, as exFAT and many network shares; what
    was at `target` is replaced. Raises OSError."""
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)
    try:
        target.hardlink_to(source)
    except OSError:  # systems give many numbers for it; a disk that is gone or full fails below too
        part = target.with_name(f"{target.name}.{secrets.token_hex(4)}.part")
        shutil.copyfile(source, part)
        replace_file(part, target)


def link_or_copy_folder(source: Path, target: Path) -> None:
    """Make `target` a link to a folder, or a fresh copy of it where the disk has no links. Raises OSError."""
    if target.is_symlink():
        return
    shutil.rmtree(target, ignore_errors=True)
    try:
        target.symlink_to(source.resolve(), target_is_directory=True)
    except OSError:
        shutil.copytree(source, target)


@contextmanager
def room_on_disk(path: Path) -> Iterator[None]:
    """Turn the system's errors of a full, read-only or vanished disk into one line that names `path`."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise DiskFullError(
                f"{path}: no room left on this disk", hint="make room; the same command goes on from here"
            ) from error
        if getattr(error, "winerror", 0) in _HELD_OPEN:
            raise ProjectError(
                f"{error.filename or path}: another program has it open, or it is not writable",
                hint="close viewers and editors; the same command goes on from here",
            ) from error
        if error.errno == errno.ENAMETOOLONG or getattr(error, "winerror", 0) == _TOO_LONG:
            raise ProjectError(
                f"{error.filename or path}: this path is too long for the system",
                hint="use a folder with a shorter path, or on Windows allow long ones: docs/systems.md",
            ) from error
        if error.errno in (errno.EACCES, errno.EROFS, errno.EPERM):
            raise ProjectError(
                f"{error.filename or path}: not writable", hint="give write permission, or use another folder"
            ) from error
        if error.errno in _NO_ANSWER:
            raise ProjectError(
                f"{error.filename or path}: its disk does not answer ({error.strerror})",
                hint="connect it again; the same command goes on from here",
            ) from error
        raise


@contextmanager
def guard_folder(folder: Path) -> Iterator[None]:
    """Within, let this process write nothing below `folder` once another folder is in its place: a disk that is gone
    leaves its mount point, which would be filled in its stead. What fails for that says so."""
    _held[folder] = folder.stat()
    try:
        yield
    except Exception:
        require_same_folder(folder)
        raise
    finally:
        del _held[folder]


def require_same_folder(path: Path) -> None:
    """Raise `ProjectError` if `path` lies in a folder that is held and is gone."""
    for folder, status in tuple(_held.items()):
        if not path.is_relative_to(folder):
            continue
        try:
            same = os.path.samestat(folder.stat(), status)
        except OSError:
            same = False
        if not same:
            raise ProjectError(
                f"{folder}: the folder is gone, or another one is in its place",
                hint="connect its disk again, or move it back; the same command goes on from here",
            )


def require_room(folder: Path, needed: int) -> None:
    """Raise `DiskFullError` unless there is room for so many bytes beside it."""
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise DiskFullError(
            f"{folder}: {free / 1e9:.1f} GB free on this disk, about {needed / 1e9:.1f} GB needed",
            hint="make room; the same command goes on from here",
        )


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file that is whole under its name or not there: temporary file, flush, rename."""
    # of a length that fits, and no other process's, on no other machine either
    temporary = path.with_name(f".{fingerprint_of(path.name)}.{secrets.token_hex(4)}.tmp")
    try:
        with room_on_disk(path):
            require_same_folder(path)
            path.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("wb") as handle:
                handle.write(content)
                handle.flush()
                os.fsync(handle.fileno())
            replace_file(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def remove_unfinished(folder: Path) -> None:
    """Remove what `write_bytes` left below `folder` when it was killed; nobody may be writing there."""
    for parent, _, names in os.walk(folder):
        for name in names:
            if _UNFINISHED.fullmatch(name):
                (Path(parent) / name).unlink(missing_ok=True)


def write_json(path: Path, values: Any) -> None:
    text = json.dumps(values, indent=2, ensure_ascii=False) + "\n"
    write_bytes(path, text.encode("utf-8", "backslashreplace"))  # half a character, as JSON writes one


def write_array(path: Path, array: NDArray[Any]) -> None:
    """Write an array as numpy's .npy file, whole or not there."""
    content = BytesIO()
    np.save(content, array, allow_pickle=False)
    write_bytes(path, content.getvalue())


def replace_folder(temporary: Path, final: Path) -> None:
    """Put a finished folder in the place of another."""
    old = final.with_name(f".{final.name}.old")
    if final.exists():
        shutil.rmtree(old, ignore_errors=True)
        replace_file(final, old)
    replace_file(temporary, final)  # also where a kill came between the two
    shutil.rmtree(old, ignore_errors=True)


def fingerprint_of(*parts: Any) -> str:
    """Return a short digest of plain values; equal values give equal digests in every process."""
    text = json.dumps(parts, sort_keys=True, ensure_ascii=False)
    return hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=12).hexdigest()


def digest_file(path: Path) -> str:
    """Return a digest of a file's content, against mistakes and not against malice. Raises OSError."""
    digest = xxhash.xxh3_128()
    with open_file(path) as handle:
        while chunk := handle.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()


def quick_digest(path: Path) -> str:
    """Return a digest of a file's size, of its beginning, its end and pieces between: what an editor or another
    program writes differs there, at no cost of reading a file of gigabytes. Raises OSError."""
    size = path.stat().st_size
    digest = hashlib.blake2b(str(size).encode(), digest_size=12)
    with path.open("rb") as handle:
        for offset in sorted({*range(0, max(1, size), max(1, size // 16)), max(0, size - _PIECE)}):
            handle.seek(offset)
            digest.update(handle.read(_PIECE))
    return digest.hexdigest()


def read_json(path: Path) -> dict[str, Any] | None:
    """Return the mapping in a JSON file, None if there is none that can be read."""
    try:
        values = json.loads(read_at_most(path, _MOST_JSON).decode("utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return values if isinstance(values, dict) else None
