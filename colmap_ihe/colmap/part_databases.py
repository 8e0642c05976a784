"""Make and merge databases of some images, as processes and the workers of a cluster get and return them.

COLMAP's database stays with one process: SQLite on a folder that several machines write to is how databases are lost.
Workers copy whole files from and to the shared folder, and open them in a folder of their own. COLMAP's own merging of
databases is no use: it makes a camera of each part's, where one was shared.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from copy import copy
from pathlib import Path

from colmap_ihe.colmap.native import pycolmap, translated
from colmap_ihe.errors import DiskFullError, NativeError
from colmap_ihe.machine.files import room_on_disk
from colmap_ihe.machine.scratch import scratch_folder

Pair = tuple[int, int]
"""The ids of two images."""

_LITTLE = 1 << 20  # bytes free with which nothing can be written: a database grows in steps


def write_images(
    database: Path, cameras: Mapping[int, pycolmap.Camera], names: Mapping[int, str] | None = None
) -> None:
    """Write images without features by their ids, each with its camera. Without `names` they are named after their ids,
    since names in lists of pairs cannot hold spaces; each is a frame of its own, as COLMAP imports them."""
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for camera in {camera.camera_id: camera for camera in cameras.values()}.values():
            opened.write_camera(camera, use_camera_id=True)
            rig = pycolmap.Rig(rig_id=camera.camera_id)
            rig.add_ref_sensor(camera.sensor_id)
            opened.write_rig(rig, use_rig_id=True)
        for image_id, camera in cameras.items():
            name = names[image_id] if names else str(image_id)
            image = pycolmap.Image(name=name, camera_id=camera.camera_id, image_id=image_id)
            frame = pycolmap.Frame(frame_id=image_id, rig_id=camera.camera_id)
            frame.add_data_id(image.data_id)
            opened.write_frame(frame, use_frame_id=True)
            image.frame_id = image_id
            opened.write_image(image, use_image_id=True)


def copy_features(source: Path, target: Path, ids: Mapping[int, int] | None = None) -> None:
    """Copy the features of images that have none in `target`, all or none. `ids`: the id in `target` by that in
    `source`; by default those of all images in `target`, the same in both."""
    with (
        pycolmap.Database.open(source) as given,
        pycolmap.Database.open(target) as taken,
        pycolmap.DatabaseTransaction(taken),
    ):
        if ids is None:
            ids = {image.image_id: image.image_id for image in taken.read_all_images()}
        for source_id, target_id in ids.items():
            if given.exists_keypoints(source_id) and not taken.exists_keypoints(target_id):
                taken.write_keypoints(target_id, given.read_keypoints(source_id))
                taken.write_descriptors(target_id, given.read_descriptors(source_id))


def copy_matches(source: Path, target: Path, pairs: Iterable[Pair]) -> None:
    """Copy those of `pairs` that COLMAP has looked at, all or none; it keeps a row for one without a match too."""
    with (
        pycolmap.Database.open(source) as given,
        pycolmap.Database.open(target) as taken,
        pycolmap.DatabaseTransaction(taken),
    ):
        for pair in map(ordered, pairs):
            if given.exists_matches(*pair) and not taken.exists_matches(*pair):
                taken.write_matches(*pair, given.read_matches(*pair))
            if given.exists_two_view_geometry(*pair) and not taken.exists_two_view_geometry(*pair):
                taken.write_two_view_geometry(*pair, given.read_two_view_geometry(*pair))


def copy_with_cameras(source: Path, target: Path, groups: Iterable[Iterable[str]]) -> None:
    """Copy a database, but with a camera of its own for each group of images, given by name: that of the first of them,
    as it is in `source`, without what EXIF says of its focal length."""
    with pycolmap.Database.open(source) as given:
        images = {str(image.name): image for image in given.read_all_images()}
        cameras = {camera.camera_id: camera for camera in given.read_all_cameras()}
        pairs = [pycolmap.pair_id_to_image_pair(pair) for pair in given.read_num_matches()[0]]
        priors = given.read_all_pose_priors()
    taken = {image.image_id: cameras[image.camera_id] for image in images.values()}
    next_id = max(cameras) + 1
    for group in groups:
        numbers = [images[name].image_id for name in group]
        camera = copy(taken[numbers[0]])
        camera.camera_id, next_id = next_id, next_id + 1
        taken |= dict.fromkeys(numbers, camera)
    write_images(target, taken, {image.image_id: name for name, image in images.items()})
    copy_features(source, target)
    copy_matches(source, target, pairs)
    with pycolmap.Database.open(target) as opened, pycolmap.DatabaseTransaction(opened):
        for prior in priors:
            opened.write_pose_prior(prior, use_pose_prior_id=True)


def ordered(pair: Pair) -> Pair:
    """Return the pair with the smaller id first."""
    return min(pair), max(pair)


@contextmanager
def task_folder() -> Iterator[Path]:
    """Give a folder on a disk of the worker's own, while a task lasts. Raises `DiskFullError` where that is full,
    whatever COLMAP makes of it, else `NativeError`."""
    with scratch_folder() as folder:
        try:
            with room_on_disk(folder):
                yield folder
        except (RuntimeError, NativeError) as error:
            if shutil.disk_usage(folder).free < _LITTLE:
                raise DiskFullError(
                    f"{folder}: no room left on this disk",
                    hint="make room there, or set TMPDIR where workers are started; the same command goes on from here",
                ) from error
            raise translated(error) from error
