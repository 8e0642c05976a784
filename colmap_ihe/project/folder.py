"""The project folder: every path in it, atomic writes, stage records. No other module builds such a path.

images/ masks/ calibration/ project.yaml      the user's, never written to
workspace/ colour/ report/ records/           ours
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_ihe.errors import BusyError, ProjectError
from colmap_ihe.machine import locks as ours
from colmap_ihe.machine.files import leads_out, odd_below, read_json, room_on_disk, write_json
from colmap_ihe.project.record_models import is_valid


@dataclass(frozen=True)
class Project:
    """The paths of one project. `images` may lie elsewhere (`--images DIR`)."""

    root: Path
    images: Path

    @classmethod
    def at(cls, root: Path, images: Path | None = None) -> Project:
        """Raises `ProjectError` if there is no folder of photographs."""
        folder = images or root / "images"
        if not folder.is_dir():
            raise ProjectError(
                f"{folder}: no such folder of photographs",
                hint=f"put the photographs into {root / 'images'}, or name their folder with --images DIR",
            )
        if root.exists() and not root.is_dir():
            raise ProjectError(f"{root}: is a file, wanted a project folder")
        project = cls(root.absolute(), folder.absolute())
        project.refuse_links()
        for made in (*project.made_folders, project.records):
            if _overlap(folder.resolve(), made.resolve()):
                raise ProjectError(
                    f"{folder}: the photographs and what is made of them in {made} would lie in one folder",
                    hint=f"put the photographs into {root / 'images'}, or name another project folder",
                )
        return project

    @property
    def made_folders(self) -> tuple[Path, Path, Path]:
        """The folders that hold what we make, and nothing of the user's."""
        return (self.workspace, self.colour, self.report)

    def claim(self) -> None:
        """Marks the workspace as ours. Raises `ProjectError` where somebody else made one of our folders: a
        workspace without our mark is somebody's work, and not ours to write into."""
        if not ours.is_marked(self.workspace):
            for folder in self.made_folders:
                ours.refuse_unmarked(folder, "move it away, or use another project folder with --images")
            ours.make(self.workspace)

    def refuse_links(self) -> None:
        """Raises `ProjectError` where one of our folders is a link out of the project, or holds one: what we write and
        remove there would be somebody's elsewhere. Likewise for pipes and devices, which nobody reads to the end."""
        for folder in (*self.made_folders, self.records, self.comparison):
            found = [folder] if folder.is_symlink() else []
            with room_on_disk(folder):
                if folder.is_dir():
                    found += odd_below(folder, deep=folder != self.comparison)
            for odd in found:
                if not odd.is_symlink():
                    raise ProjectError(
                        f"{odd}: neither file nor folder, in a folder of ours", hint="take it out"
                    )
                if leads_out(odd, self.root) and not self._is_shared(odd):
                    raise ProjectError(
                        f"{odd}: a link that leads out of the project, and what we make is not written through one",
                        hint="take the link out; to work on another disk, put the project there and name --images DIR",
                    )

    def _is_shared(self, link: Path) -> bool:
        """Whether it is the one that `compare` makes: means of calibration frames, found once for all its methods."""
        return link == self.masters and link.resolve() == (self.root.parent / "records/calibration").resolve()

    @property
    def options_file(self) -> Path:
        return self.root / "project.yaml"

    @property
    def masks(self) -> Path:
        return self.root / "masks"

    @property
    def calibration(self) -> Path:
        return self.root / "calibration"

    @property
    def masters(self) -> Path:
        """What is made of the calibration frames."""
        return self.records / "calibration"

    @property
    def workspace(self) -> Path:
        return self.root / "workspace"

    @property
    def grey(self) -> Path:
        return self.workspace / "images"

    @property
    def made_masks(self) -> Path:
        """COLMAP's masks of the grey images, made of the user's."""
        return self.workspace / "masks"

    @property
    def database(self) -> Path:
        return self.workspace / "database.db"

    @property
    def sparse(self) -> Path:
        return self.workspace / "sparse"

    @property
    def dense(self) -> Path:
        return self.workspace / "dense" / "0"

    @property
    def mesh(self) -> Path:
        """The surface with vertex colours; the textured ones lie beside it."""
        return self.dense / "mesh.ply"

    @property
    def colour(self) -> Path:
        return self.root / "colour"

    @property
    def report(self) -> Path:
        return self.root / "report"

    @property
    def set_aside(self) -> Path:
        """What somebody has changed of what we made, before it was made again."""
        return self.root / "set-aside"

    @property
    def comparison(self) -> Path:
        return self.root / "compare"

    @property
    def page_file(self) -> Path:
        return self.report / "index.html"

    @property
    def summary_file(self) -> Path:
        return self.report / "summary.json"

    @property
    def weights_file(self) -> Path:
        return self.report / "weights.yaml"

    @property
    def records(self) -> Path:
        return self.root / "records"

    @property
    def histogram_file(self) -> Path:
        """What the fit counted, for fits over several campaigns."""
        return self.records / "fit.histogram"

    @property
    def native_log(self) -> Path:
        return self.records / "colmap.log"

    @property
    def batch_record(self) -> Path:
        """How the last run of this project in a batch ended; beside it the log of that run."""
        return self.records / "batch.json"

    @property
    def batch_log(self) -> Path:
        return self.records / "batch.log"

    @property
    def digests_file(self) -> Path:
        return self.records / "digests.json"

    @property
    def run_file(self) -> Path:
        """What the last run was given."""
        return self.records / "run.json"

    def record_file(self, stage: str) -> Path:
        return self.records / f"{stage}.json"

    def begun_file(self, stage: str) -> Path:
        return self.records / f"{stage}.begun.json"

    def read_record(self, stage: str) -> dict[str, Any] | None:
        """The record of a finished stage, or None. A record that is not whole is none."""
        record = read_json(self.record_file(stage))
        if record is None or not {"fingerprint", "seconds"} <= set(record):
            return None
        return record if is_valid(stage, record) else None

    def write_record(self, stage: str, record: dict[str, Any]) -> None:
        write_json(self.record_file(stage), record)
        self.begun_file(stage).unlink(missing_ok=True)

    def drop_record(self, stage: str) -> None:
        self.record_file(stage).unlink(missing_ok=True)
        self.begun_file(stage).unlink(missing_ok=True)

    def was_begun(self, stage: str, fingerprint: str) -> bool:
        """Whether `stage` was begun with this fingerprint and not finished, so that what it left under final
        names may be kept."""
        return (read_json(self.begun_file(stage)) or {}).get("fingerprint") == fingerprint

    def stage_begun(self) -> str:
        """The stage that is being made, empty if none is."""
        return next((file.name.split(".")[0] for file in self.records.glob("*.begun.json")), "")

    def begin(self, stage: str, fingerprint: str) -> None:
        """Notes that `stage` is being made. To be called when nothing is left of what it made before."""
        write_json(self.begun_file(stage), {"fingerprint": fingerprint})

    @contextmanager
    def locked(self) -> Iterator[None]:
        """One run at a time; the lock goes with the process, however that ends. Raises `BusyError`."""
        with room_on_disk(self.root):
            lock = ours.acquire_lock(self.records / "lock")
        if lock is None:
            raise BusyError(
                f"{self.root}: another run is working on this project", hint="wait for it, or stop it"
            )
        with lock:
            yield


def _overlap(one: Path, other: Path) -> bool:
    return one.is_relative_to(other) or other.is_relative_to(one)
