"""Name every path of a project folder, and guard the folder. No other module builds such a path.

images/ masks/ calibration/ control/ project.yaml      the user's, never written to
workspace/ colour/ drawings/ report/ records/          ours
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from colmap_ihe.errors import BusyError, ProjectError
from colmap_ihe.machine import locks
from colmap_ihe.machine.files import leads_out, odd_below, read_json, room_on_disk, write_json


class Project:
    """Hold the paths of one project. `images` may lie elsewhere (`--images DIR`)."""

    def __init__(self, root: Path, images: Path) -> None:
        self.root, self.images = root, images
        self.options_file = root / "project.yaml"
        self.masks = _given(root, "masks", "mask")
        self.calibration = _given(root, "calibration")
        self.control = _given(root, "control")
        """Surveyed points, positions and scale bars."""
        self.workspace = root / "workspace"
        self.grey = self.workspace / "images"
        self.made_masks = self.workspace / "masks"
        """COLMAP's masks of the grey images, made of the user's."""
        self.database = self.workspace / "database.db"
        self.tried_features = self.workspace / "tried.db"
        """What the trial of greys found, until the features are there."""
        self.sparse = self.workspace / "sparse"
        self.metric = self.workspace / "metric"
        """The largest model in the frame of its survey, in metres."""
        self.dense = self.workspace / "dense" / "0"
        self.mesh = self.dense / "mesh.ply"
        """The surface with vertex colours; the textured one lies beside it."""
        self.colour = root / "colour"
        self.drawings = root / "drawings"
        """A folder for each drawing."""
        self.report = root / "report"
        self.page_file = self.report / "index.html"
        self.picture_file = self.report / "model.jpg"
        self.summary_file = self.report / "summary.json"
        self.calibration_file = self.report / "calibration.yaml"
        self.georeference_file = self.report / "georeference.json"
        self.weights_file = self.report / "weights.yaml"
        self.set_aside = root / "set-aside"
        """What somebody has changed of what we made, before it was made again."""
        self.comparison = root / "compare"
        self.records = root / "records"
        self.masters = self.records / "calibration"
        """What is made of the calibration frames."""
        self.histogram_file = self.records / "fit.histogram"
        """What the fit counted, for fits over several campaigns."""
        self.native_log = self.records / "colmap.log"
        self.batch_record = self.records / "batch.json"
        """How the last run of this project in a batch ended; beside it the log of that run."""
        self.batch_log = self.records / "batch.log"
        self.digests_file = self.records / "digests.json"
        self.run_file = self.records / "run.json"
        """What the last run was given."""
        self.provenance_file = self.records / "provenance.json"
        self.made_folders = (self.workspace, self.colour, self.report)
        """The folders that hold what we make, and nothing of the user's."""

    @classmethod
    def at(cls, root: Path, images: Path | None = None) -> Project:
        """Return the project in a folder. Raises `ProjectError` if there is no folder of photographs."""
        folder = images or root / "images"
        if images is None and not folder.is_dir() and root.name == "images" and root.is_dir():
            raise ProjectError(
                f"{root}: is the folder of the photographs, expected the project's folder, which holds it",
                hint=f"name {root.absolute().parent}",
            )
        if not folder.is_dir():
            raise ProjectError(
                f"{folder}: no such folder of photographs",
                hint=f"put the photographs into {root / 'images'}, or name their folder with --images DIR",
            )
        if root.exists() and not root.is_dir():
            raise ProjectError(f"{root}: is a file, expected a project folder")
        project = cls(root.absolute(), folder.absolute())
        project.refuse_links()
        for made in (*project.made_folders, project.records):
            if _overlap(folder.resolve(), made.resolve()):
                raise ProjectError(
                    f"{folder}: the photographs and what is made of them in {made} would lie in one folder",
                    hint=f"put the photographs into {root / 'images'}, or name another project folder",
                )
        return project

    def claim(self) -> None:
        """Mark the workspace as ours. Raises `ProjectError` where somebody else made one of our folders: a
        workspace without our mark is somebody's work, and not ours to write into."""
        if not locks.is_marked(self.workspace):
            for folder in self.made_folders:
                locks.refuse_unmarked(folder, "move it away, or use another project folder with --images")
            locks.make(self.workspace)

    def refuse_links(self) -> None:
        """Raise `ProjectError` where one of our folders is a link out of the project, or holds one: what we write and
        remove there would be somebody's elsewhere. Likewise for pipes and devices, which nobody reads to the end."""
        drawings = (self.drawings,) if locks.is_marked(self.drawings) else ()
        for folder in (*self.made_folders, self.records, self.comparison, *drawings):
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
        """Tell the one link that `compare` makes: means of calibration frames, found once for all its methods."""
        return link == self.masters and link.resolve() == (self.root.parent / "records/calibration").resolve()

    def record_file(self, stage: str) -> Path:
        """Return the file of a stage's record."""
        return self.records / f"{stage}.json"

    def begun_file(self, stage: str) -> Path:
        """Return the file that notes a stage as begun."""
        return self.records / f"{stage}.begun.json"

    def write_record(self, stage: str, record: dict[str, Any]) -> None:
        """Write the record of a finished stage."""
        write_json(self.record_file(stage), record)
        self.begun_file(stage).unlink(missing_ok=True)

    def drop_record(self, stage: str) -> None:
        """Remove the record of a stage, which counts as not begun then."""
        self.record_file(stage).unlink(missing_ok=True)
        self.begun_file(stage).unlink(missing_ok=True)

    def was_begun(self, stage: str, fingerprint: str) -> bool:
        """Tell whether `stage` was begun with this fingerprint and not finished: what it left may then be kept."""
        return (read_json(self.begun_file(stage)) or {}).get("fingerprint") == fingerprint

    def stage_begun(self) -> str:
        """Return the stage that was begun and not finished, empty if none was."""
        return next((file.name.split(".")[0] for file in self.records.glob("*.begun.json")), "")

    def begin(self, stage: str, fingerprint: str) -> None:
        """Note that `stage` is begun. To be called when nothing is left of what it made before."""
        write_json(self.begun_file(stage), {"fingerprint": fingerprint})

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Let one run at a time work here; the lock goes with the process, however that ends. Raises `BusyError`."""
        with room_on_disk(self.root):
            lock = locks.acquire_lock(self.records / "lock")
        if lock is None:
            raise BusyError(
                f"{self.root}: another run is working on this project", hint="wait for it, or stop it"
            )
        with lock:
            yield


def _given(root: Path, *names: str) -> Path:
    """Return the user's folder of one of these names, whatever their case; under the first name if there is none."""
    there = {e.name.casefold(): e for e in root.iterdir() if e.is_dir()} if root.is_dir() else {}
    exact = root / names[0]
    return exact if exact.is_dir() else next((there[name] for name in names if name in there), exact)


def _overlap(one: Path, other: Path) -> bool:
    return one.is_relative_to(other) or other.is_relative_to(one)
