"""Write images into COLMAP's database, each with its camera."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from colmap_ihe.colmap.database import remove_database
from colmap_ihe.colmap.known_calibration import KnownCalibration, start_cameras
from colmap_ihe.colmap.native import called, pycolmap
from colmap_ihe.machine.files import replace_file
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.camera_identity import CameraIdentity, without_whole_identity


@dataclass(frozen=True)
class ImageGroup:
    """Hold images that are imported at once, by name, and how COLMAP gives them cameras. `assumed`: that one camera
    took them, which EXIF does not say."""

    names: Sequence[str]
    mode: pycolmap.CameraMode
    assumed: bool = False


def image_groups(
    names: Sequence[str], mode: pycolmap.CameraMode, identities: Mapping[str, CameraIdentity]
) -> list[ImageGroup]:
    """Return the images in groups. In AUTO those of which COLMAP would give each a camera of its own for want of EXIF
    share one for each size and all that EXIF says, as a survey is shot; all others are left to COLMAP."""
    if mode != pycolmap.CameraMode.AUTO:
        return [ImageGroup(names, mode)]
    shared = without_whole_identity(identities)
    grouped = {name for group in shared for name in group}
    others = [name for name in names if name not in grouped]
    by_exif = [ImageGroup(others, mode)] if others else []  # given no names, COLMAP would take all files
    return by_exif + [ImageGroup(group, pycolmap.CameraMode.SINGLE, assumed=True) for group in shared]


def assumed(groups: Sequence[ImageGroup]) -> tuple[int, ...]:
    """Return the number of images of each camera that several share though EXIF does not say so."""
    return tuple(len(group.names) for group in groups if group.assumed and len(group.names) > 1)


def import_images(
    database: Path,
    grey: Path,
    groups: Sequence[ImageGroup],
    reader: pycolmap.ImageReaderOptions,
    known: KnownCalibration,
    progress: Progress,
) -> None:
    """Write all images and cameras, these as `known` where it has them, and give the database its name only then:
    COLMAP groups cameras within one call, so images that came after an interruption would get cameras of their own.
    Ids follow the names."""
    unfinished = database.with_name("unfinished.db")
    remove_database(unfinished)
    pycolmap.Database.open(unfinished).close()
    for group in groups:
        called(
            pycolmap.import_images,
            unfinished,
            grey,
            camera_mode=group.mode,
            image_names=list(group.names),
            options=reader,
            progress=progress,
            cancellable=False,
        )
    if known.cameras:
        start_cameras(unfinished, known)
    replace_file(unfinished, database)
