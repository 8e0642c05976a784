"""Find the projects of a batch, and name every path of what the batch itself writes to ROOT/batch."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine import locks
from colmap_ihe.machine.files import fingerprint_of, leads_out, room_on_disk
from colmap_ihe.photographs.discover import is_foreign
from colmap_ihe.project.folder import Project

_NAME = "batch"


@dataclass(frozen=True)
class BatchFolder:
    """Name the paths of a batch. `root` holds the projects, at any depth."""

    root: Path

    @classmethod
    def at(cls, root: Path) -> BatchFolder:
        """Return the folder of a batch. Raises `ProjectError` if there is no `root`, or if it is a project itself."""
        if not root.is_dir():
            raise ProjectError(f"{root}: no such folder", hint="name a folder that holds projects")
        if (root / "images").is_dir():
            raise ProjectError(
                f"{root}: is a project itself, it has a folder images/",
                hint="name the folder that holds the projects, or run `colmap-ihe reconstruct` on this one",
            )
        return cls(root.absolute())

    @property
    def folder(self) -> Path:
        return self.root / _NAME

    @property
    def page_file(self) -> Path:
        return self.folder / "index.html"

    @property
    def json_file(self) -> Path:
        return self.folder / "batch.json"

    def stop_file(self) -> Path:
        """Return a file of a new name, by which this process tells its runs to stop, wherever they run."""
        return self.folder / f"stop-{fingerprint_of(os.getpid(), time.time_ns())}"

    def make(self) -> None:
        """Make the folder. Raises `ProjectError` where somebody else made it, or it is a link out of `root`."""
        if leads_out(self.folder, self.root):
            raise ProjectError(
                f"{self.folder}: a link that leads out of {self.root}, and the page is not written through one",
                hint="take the link out",
            )
        if not locks.is_marked(self.folder):
            locks.refuse_unmarked(self.folder, "the batch puts its page there: give yours another name")
            with room_on_disk(self.folder):
                locks.make(self.folder)

    def projects(self, warn: Callable[[str], None]) -> list[Path]:
        """Return every folder below that has a folder `images`, sorted. Links are followed, each folder once; nothing
        is looked for inside a project, in hidden folders, in those of a system or a NAS box, or in what we made.
        `warn` is told of folders that cannot be read."""
        projects: list[Path] = []
        seen: set[tuple[int, int]] = set()

        def warn_of(error: OSError) -> None:
            warn(f"{error.filename}: cannot be read ({error.strerror}), so no project is looked for in it")

        for parent, folders, _ in os.walk(self.root, onerror=warn_of, followlinks=True):
            folder = Path(parent)
            try:
                about = folder.stat()
                skipped = (about.st_dev, about.st_ino) in seen or locks.is_marked(folder)
                is_project = not skipped and folder != self.root and (folder / "images").is_dir()
            except OSError as error:
                warn_of(error)
                skipped, is_project = True, False
            else:
                seen.add((about.st_dev, about.st_ino))
            if is_project:
                projects.append(folder)
            folders[:] = [] if skipped or is_project else [f for f in folders if not is_foreign(Path(f))]
        return sorted(projects)

    def name_of(self, project: Path) -> str:
        """Return the path of a project below the root."""
        return project.relative_to(self.root).as_posix()


def contents_of(project: Project) -> tuple[str, float]:
    """Return a digest of names, sizes and times of what the user put into a project, and when that last changed, in
    seconds since the epoch."""
    paths = [project.options_file]
    for folder in (project.images, project.masks, project.calibration):
        for parent, _, names in os.walk(folder):
            paths += [Path(parent), *(Path(parent) / name for name in names)]
    files: list[tuple[str, int, int]] = []
    newest = 0.0
    for path in paths:
        try:
            about = path.stat()
        except OSError:  # not there, gone again, or a link to nowhere
            continue
        newest = max(newest, about.st_ctime)
        files.append((str(path), about.st_size, about.st_mtime_ns))
    return fingerprint_of(sorted(files)), newest
