"""Note what we wrote into a folder that is not a project: which files are ours, and which of them are stale.

The record in the folder names each file with the fingerprint of what it is made from. A stale file is removed
before the record says otherwise, so a file under its name is always of the fingerprint in the record, however
a run ended. A file that we did not write, or that somebody changed since, is never overwritten.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.executor import in_order, local_executor
from colmap_ihe.machine.files import (
    digest_file,
    is_name_below,
    leads_out,
    read_json,
    remove_unfinished,
    room_on_disk,
    write_json,
)
from colmap_ihe.machine.locks import lock_at_once
from colmap_ihe.machine.progress import RunProgress
from colmap_ihe.machine.system import open_to_lock
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.each import LeftOut, refused
from colmap_ihe.photographs.readable import find_photographs
from colmap_ihe.photographs.recipes import prepared_set
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.run_stages import warn_of
from colmap_ihe.pipeline.warnings import photographs as set_warnings
from colmap_ihe.project.options import CamerasOptions, DevelopOptions

RECORD = ".colmap-ihe.json"


class Ledger:
    """Keep the record of one folder. `files`: by name, the fingerprint of what each is made from and the digest of
    what we wrote, empty if we were killed before it was noted. `notes`: plain values kept beside. `changed`,
    once it has begun: our files that somebody has changed since."""

    def __init__(self, folder: Path) -> None:
        """Read the record. Raises `ProjectError` for a folder with anything in it and no record of ours."""
        self.folder = folder
        self.files: dict[str, dict[str, str]] = {}
        self.notes: dict[str, Any] = {}
        self.changed: set[str] = set()
        record = read_json(folder / RECORD)
        if record is None:
            if any(folder.iterdir()):
                raise ProjectError(
                    f"{folder}: is not empty, and not of an earlier run of colmap-ihe",
                    hint="name an empty or a new folder",
                )
            return
        files, notes = record.get("files"), record.get("notes")
        if not isinstance(files, dict) or not isinstance(notes, dict) or not _is_table(files):
            raise ProjectError(
                f"{folder / RECORD}: is not a record of this version", hint="name an empty or a new folder"
            )
        self.files, self.notes = {n: dict(f) for n, f in files.items() if self._is_below(n)}, notes

    def refuse(self, expected: Mapping[str, str]) -> None:
        """Raise `ProjectError` if a file that is not ours is in the way of `expected`, or if what lies here is
        of other photographs. `expected`: the photograph that each file is made from."""
        for name in expected:
            if not self._is_below(name):
                raise ProjectError(
                    f"{self.folder / name}: lies behind a link that leads out of the folder",
                    hint="take the link out, or name another folder",
                )
            if name not in self.files and (self.folder / name).exists():
                raise ProjectError(
                    f"{self.folder / name}: is there already and was not written by colmap-ihe",
                    hint="move it away, or name another folder",
                )
        there = {f["photograph"] for n, f in self.files.items() if (self.folder / n).exists()}
        if there and not there & set(expected.values()):
            raise ProjectError(
                f"{self.folder}: holds grey images of other photographs, as {min(there)}",
                hint="name a folder of its own for each set",
            )

    def _is_below(self, name: str) -> bool:
        return is_name_below(name) and not leads_out(self.folder / name, self.folder)

    def begin(self, expected: Mapping[str, str], prints: Mapping[str, str]) -> set[str]:
        """Remove what is stale or no longer expected, note what will be written, and return these names. `prints`: the
        fingerprint that each expected file is to have. Raises `ProjectError` for a stale file that was changed."""
        there = self._digests([n for n, f in self.files.items() if f["digest"]])
        changed = self.changed = {n for n, digest in there.items() if digest != self.files[n]["digest"]}
        stale = {n for n in expected if self.files.get(n, {}).get("fingerprint") != prints[n]}
        for name in sorted(stale & changed):
            raise ProjectError(
                f"{self.folder / name}: is to be written again and was changed since it was written",
                hint="move it away to keep it, or delete it",
            )
        for name in (stale | set(self.files) - set(expected)) - changed:
            with room_on_disk(self.folder):
                (self.folder / name).unlink(missing_ok=True)
        missing = {n for n in expected if n in stale or not (self.folder / n).exists()}
        kept = {n: self.files[n] for n in expected if n not in missing}
        new = {
            n: {"photograph": expected[n], "fingerprint": prints[n], "digest": ""}
            for n in expected
            if n in missing
        }
        self.files = kept | new
        self.save()
        return missing

    def end(self) -> None:
        """Note what has been written."""
        for name, digest in self._digests([n for n, f in self.files.items() if not f["digest"]]).items():
            self.files[name]["digest"] = digest
        self.save()

    def save(self) -> None:
        write_json(self.folder / RECORD, {"files": self.files, "notes": self.notes})

    def _digests(self, names: Sequence[str]) -> dict[str, str]:
        """Return the digests of those files that are there."""
        there = [n for n in names if (self.folder / n).exists()]
        with local_executor() as executor:
            return dict(zip(there, executor.map(digest_file, [self.folder / n for n in there]), strict=True))


@contextmanager
def opened(folder: Path) -> Iterator[Ledger]:
    """Open the ledger of a folder, made if it is not there, for one run at a time; a folder that is empty in the end
    is removed again. Raises `ProjectError`."""
    if folder.exists() and not folder.is_dir():
        raise ProjectError(f"{folder}: is a file, expected a folder", hint="name an empty or a new folder")
    with room_on_disk(folder):
        folder.mkdir(parents=True, exist_ok=True)
    handle = open_to_lock(folder.resolve())
    try:
        if not lock_at_once(handle, folder):
            raise ProjectError(f"{folder}: another run is writing into it", hint="wait for it, or stop it")
        remove_unfinished(folder)
        yield Ledger(folder)
    finally:
        with suppress(OSError):  # it is not empty
            folder.rmdir()
        os.close(handle)


@dataclass
class FolderRun:
    """Hold what the steps of work on one folder share: photographs, how they are developed (`steps`, by camera),
    `digests` of their content by name, a ledger for each folder that is written into, and what was left out."""

    surveyed: Sequence[Surveyed]
    steps: dict[str, list[str]]
    digests: dict[str, str]
    ledgers: Sequence[Ledger]
    executor: Executor
    progress: RunProgress
    strict: bool
    left_out: LeftOut


@contextmanager
def folder_run(
    images: Path,
    folders: Sequence[Path],
    develop: DevelopOptions | None,
    calibration: Path | None,
    strict: bool,
    progress: RunProgress,
    *,
    cameras: CamerasOptions | None = None,
    raw_only: bool = False,
) -> Iterator[FolderRun]:
    """Survey the photographs in `images` and open the ledgers of `folders`; in the end tell what was left out. With
    `raw_only` other photographs are passed over. Raises `KnownError`s."""
    folders = [folder.resolve() for folder in folders]
    _require_apart(images.resolve(), folders)
    discovery = (discover if raw_only else find_photographs)(images.absolute())
    refused_files = refused(discovery.refused, strict)
    captures = [c for c in discovery.captures if c.kind == "raw" or not raw_only]
    others = len(discovery.captures) - len(captures)
    if not captures:
        raise ProjectError(
            f"{images}: none of its {others} photographs is a RAW file",
            hint="others are developed already: use them as they are",
        )
    with ExitStack() as stack:
        executor = stack.enter_context(local_executor())
        how = (captures, develop, calibration, executor, progress)
        prepared = stack.enter_context(
            prepared_set(*how, strict=strict, cameras=cameras, refused=refused_files)
        )
        left_out = dict(prepared.left_out)
        warn_of(set_warnings.warnings_of(prepared.surveyed, discovery.ignored, discovery.notes), progress)
        warn_of(
            set_warnings.camera_warnings(cameras or CamerasOptions(), prepared.surveyed, left_out), progress
        )
        warn_of([f"{others} photographs are no RAW files: passed over"] if others else [], progress)
        digests = _digests_of(prepared.surveyed, executor, progress)
        ledgers = [stack.enter_context(opened(folder)) for folder in folders]
        yield FolderRun(
            prepared.surveyed, prepared.steps, digests, ledgers, executor, progress, strict, left_out
        )
    warn_of([f"left out: {reason}" for reason in left_out.values()], progress)


def _is_table(files: Mapping[Any, Any]) -> bool:
    keys = ("photograph", "fingerprint", "digest")
    return all(isinstance(f, dict) and all(isinstance(f.get(k), str) for k in keys) for f in files.values())


def _digests_of(surveyed: Sequence[Surveyed], executor: Executor, progress: RunProgress) -> dict[str, str]:
    """Return the digest of each photograph's content, by name."""
    digests = {}
    with progress.stage("content") as stage_progress:
        stage_progress.start(len(surveyed))
        files = [s.capture.path for s in surveyed]
        for photograph, digest in zip(surveyed, in_order(executor, digest_file, files), strict=True):
            digests[photograph.capture.name] = digest
            stage_progress.advance()
    return digests


def _require_apart(images: Path, folders: Sequence[Path]) -> None:
    """Raise `ProjectError` where one of the folders lies in another."""
    for folder in folders:
        if folder.is_relative_to(images) or images.is_relative_to(folder):
            raise ProjectError(
                f"{folder}: lies in the folder of photographs or holds it", hint="use a folder of its own"
            )
    for folder, other in pairwise(folders):
        if folder.is_relative_to(other) or other.is_relative_to(folder):
            raise ProjectError(
                f"{other}: lies in the folder of grey images or holds it", hint="use a folder of its own"
            )
