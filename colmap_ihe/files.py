"""Files and folders that are whole or not there, what tells one from another, and whether the disk has room."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import DiskFullError, ProjectError

_PIECE = 1 << 12  # bytes


@contextmanager
def room_on_disk(path: Path) -> Iterator[None]:
    """Turns the system's errors of a full or read-only disk into one line that names `path`."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise DiskFullError(
                f"{path}: no room left on this disk", hint="make room; the same command goes on from here"
            ) from error
        if error.errno in (errno.EACCES, errno.EROFS, errno.EPERM):
            raise ProjectError(
                f"{error.filename or path}: not writable", hint="give write permission, or use another folder"
            ) from error
        raise


def require_room(folder: Path, needed: int) -> None:
    """Raises `DiskFullError` unless there is room for so many bytes beside it."""
    free = shutil.disk_usage(folder).free
    if free < needed:
        raise DiskFullError(
            f"{folder}: {free / 1e9:.1f} GB free on this disk, about {needed / 1e9:.1f} GB needed",
            hint="make room; the same command goes on from here",
        )


def write_bytes(path: Path, content: bytes) -> None:
    """Writes a file that is whole under its name or not there: temporary file, flush, rename."""
    # of a length that fits, and no other process's, on no other machine either
    temporary = path.with_name(f".{fingerprint_of(path.name)}.{secrets.token_hex(4)}.tmp")
    try:
        with room_on_disk(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            with temporary.open("wb") as handle:
                handle.write(content)
                handle.flush()
                os.fsync(handle.fileno())
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_json(path: Path, values: Any) -> None:
    write_bytes(path, (json.dumps(values, indent=2, ensure_ascii=False) + "\n").encode())


def write_array(path: Path, array: NDArray[Any]) -> None:
    """As numpy's .npy file, whole or not there."""
    content = BytesIO()
    np.save(content, array, allow_pickle=False)
    write_bytes(path, content.getvalue())


def replace_folder(temporary: Path, final: Path) -> None:
    """Puts a finished folder in the place of another."""
    if final.exists():
        old = final.with_name(f".{final.name}.old")
        shutil.rmtree(old, ignore_errors=True)
        final.rename(old)
        temporary.rename(final)
        shutil.rmtree(old)
    else:
        temporary.rename(final)


def fingerprint_of(*parts: Any) -> str:
    """A short digest of plain values; equal values give equal digests in every process."""
    text = json.dumps(parts, sort_keys=True, ensure_ascii=False)
    return hashlib.blake2b(text.encode("utf-8", "surrogatepass"), digest_size=12).hexdigest()


def digest_file(path: Path) -> str:
    """A digest of a file's content. Raises OSError."""
    digest = hashlib.blake2b(digest_size=12)
    with path.open("rb") as handle:
        while chunk := handle.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()


def sketch_file(path: Path) -> str:
    """A digest of a file's size, of its beginning, its end and pieces between: what an editor or another program
    writes differs there, at no cost of reading a file of gigabytes. Raises OSError."""
    size = path.stat().st_size
    digest = hashlib.blake2b(str(size).encode(), digest_size=12)
    with path.open("rb") as handle:
        for place in sorted({*range(0, max(1, size), max(1, size // 16)), max(0, size - _PIECE)}):
            handle.seek(place)
            digest.update(handle.read(_PIECE))
    return digest.hexdigest()


def read_json(path: Path) -> dict[str, Any] | None:
    """The mapping in a JSON file, None if there is none that can be read."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return values if isinstance(values, dict) else None
