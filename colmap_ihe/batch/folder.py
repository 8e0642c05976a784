"""The folder of a batch: where its projects are, and every path of what the batch itself leaves in ROOT/batch."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine import locks as ours
from colmap_ihe.machine.files import fingerprint_of, leads_out, room_on_disk
from colmap_ihe.project.folder import Project

_NAME = "batch"


@dataclass(frozen=True)
class BatchFolder:
    """`root` holds the projects, at any depth."""

    root: Path

    @classmethod
    def at(cls, root: Path) -> BatchFolder:
        """Raises `ProjectError` if there is no such folder, or if it is a project itself."""
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
        """By which this process tells its runs to stop, wherever they run."""
        return self.folder / f"stop-{fingerprint_of(os.getpid(), time.time_ns())}"

    def make(self) -> None:
        """Raises `ProjectError` where somebody else made it, or it is a link out of `root`."""
        if leads_out(self.folder, self.root):
            raise ProjectError(
                f"{self.folder}: a link that leads out of {self.root}, and the page is not written through one",
                hint="take the link out",
            )
        if not ours.is_marked(self.folder):
            ours.refuse_unmarked(self.folder, "the batch puts its page there: give yours another name")
            with room_on_disk(self.folder):
                ours.make(self.folder)

    def projects(self, warn: Callable[[str], None]) -> list[Path]:
        """Every folder below that has a folder `images`, in the order of their names. Links are followed, each folder
        once; nothing is looked for inside a project, in hidden folders, or in what we made. `warn` is told of folders
        that cannot be read."""
        found: list[Path] = []
        seen: set[tuple[int, int]] = set()

        def refused(error: OSError) -> None:
            warn(f"{error.filename}: cannot be read ({error.strerror}), so no project is looked for in it")

        for parent, folders, _ in os.walk(self.root, onerror=refused, followlinks=True):
            place = Path(parent)
            try:
                about = place.stat()
                known = (about.st_dev, about.st_ino) in seen or ours.is_marked(place)
                is_project = not known and place != self.root and (place / "images").is_dir()
            except OSError as error:
                refused(error)
                known, is_project = True, False
            else:
                seen.add((about.st_dev, about.st_ino))
            if is_project:
                found.append(place)
            folders[:] = [] if known or is_project else [f for f in folders if not f.startswith(".")]
        return sorted(found)

    def name_of(self, project: Path) -> str:
        return project.relative_to(self.root).as_posix()


def contents_of(project: Project) -> tuple[str, float]:
    """A digest of the names, sizes and times of what the user put into a project, and when that last changed."""
    files: list[tuple[str, int, int]] = []
    newest = 0.0
    for folder in (project.images, project.masks, project.calibration):
        for parent, _, names in os.walk(folder):
            for path in (Path(parent), *(Path(parent) / name for name in names)):
                try:
                    about = path.stat()
                except OSError:  # gone again, or a link to nowhere
                    continue
                newest = max(newest, about.st_ctime)
                files.append((str(path), about.st_size, about.st_mtime_ns))
    if project.options_file.exists():
        about = project.options_file.stat()
        newest = max(newest, about.st_ctime)
        files.append((str(project.options_file), about.st_size, about.st_mtime_ns))
    return fingerprint_of(sorted(files)), newest
