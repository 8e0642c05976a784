"""Write the COLMAP dense workspace: undistorted images, grey and in colour, and their masks.

`dense_dir` becomes a plain COLMAP dense workspace whose `images/` are the colour twins, so that fusion,
meshing and texturing see colour. Its model is there twice, in `sparse/` for COLMAP and in `sparse/0/` for the programs
of Gaussian splatting, which look for it there. `dense_dir/grey` is a second one, of the grey images on the same pixel
grid: there matching happens. `dense_dir/masks` holds a mask for each image, black where pixels are ignored.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.colmap.native import called, pycolmap
from colmap_ihe.dense.flat_parts import FlatPart, flat_part, write_model
from colmap_ihe.errors import ProjectError
from colmap_ihe.machine import memory
from colmap_ihe.machine.files import link_or_copy, require_same_folder, write_bytes
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.png import encode_png

UNDISTORT_BYTES_A_PIXEL = 8
"""Of a photograph in colour on its way, a thread: 4 to 7 measured with `benchmarks/limits.py threads`."""
_WHITE = 255
_QUALITY = 98  # of a part of a JPEG, on its way
_CONTENTS = ("images", "sparse", "masks", "grey/images", "grey/sparse")
_PARTS = ".parts"


def undistort(
    sparse_model: Path,
    grey_dir: Path,
    colour_dir: Path,
    dense_dir: Path,
    *,
    masks_dir: Path | None = None,
    max_image_size: int = -1,
    progress: Progress = SILENT,
) -> dict[str, FlatPart]:
    """Write both workspaces anew from a sparse model with its grey and colour images; return what of each is in them.

    `masks_dir`, where it exists, has COLMAP's mask of each image, NAME.png. Depth maps are left.
    `max_image_size` bounds the longer side in pixels, -1 for none. Raises `ProjectError` if an image of the model
    has no grey or no colour file, before or after, `MappingError` for a camera of which nothing can be laid flat.
    """
    for folder in (*_CONTENTS, _PARTS):  # quickly, and not atomically
        shutil.rmtree(dense_dir / folder, ignore_errors=True)
    model = pycolmap.Reconstruction(sparse_model)
    cameras = _flat_cameras(model)
    parts = {image.name: cameras[image.camera_id] for image in _registered(model)}
    options = _options(max_image_size)
    largest = max((_pixels(part.camera, options) for part in parts.values()), default=0)
    threads = memory.workers_for("undistortion", UNDISTORT_BYTES_A_PIXEL * largest, local_workers())
    require_same_folder(dense_dir)
    workspaces = {dense_dir / "grey": (grey_dir, read_grey), dense_dir: (colour_dir, read_colour)}
    progress.start(len(workspaces), "undistorted sets")
    try:
        write_model(model, cameras, dense_dir / _PARTS / "sparse")
        for workspace, (photographs, read) in workspaces.items():
            _require_files(photographs, list(parts))
            require_same_folder(workspace)
            workspace.mkdir(parents=True, exist_ok=True)
            called(
                pycolmap.undistort_images,
                workspace,
                dense_dir / _PARTS / "sparse",
                _cut(photographs, parts, dense_dir / _PARTS / "images", read),
                undistort_options=options,
                num_threads=threads,
                progress=progress,
            )
            _require_files(workspace / "images", list(parts))
            progress.advance()
    finally:
        shutil.rmtree(dense_dir / _PARTS, ignore_errors=True)
    for file in sorted(p for p in (dense_dir / "sparse").iterdir() if p.is_file()):
        write_bytes(dense_dir / "sparse" / "0" / file.name, file.read_bytes())
    if masks_dir is not None and masks_dir.is_dir():
        _undistort_masks(masks_dir, dense_dir, parts, options, progress)
    return parts


def sizes_of(sparse_model: Path, max_image_size: int = -1) -> list[tuple[int, int]]:
    """Return width and height in pixels that every registered image of a model has when it is undistorted. Raises
    `MappingError` for a camera of which nothing can be laid flat."""
    model = pycolmap.Reconstruction(sparse_model)
    options = _options(max_image_size)
    flat = {n: pycolmap.undistort_camera(options, part.camera) for n, part in _flat_cameras(model).items()}
    cameras = [flat[image.camera_id] for image in _registered(model)]
    return [(camera.width, camera.height) for camera in cameras]


def _registered(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    return [model.images[image_id] for image_id in model.reg_image_ids()]


def _flat_cameras(model: pycolmap.Reconstruction) -> dict[int, FlatPart]:
    numbers = sorted({image.camera_id for image in _registered(model)})
    return {number: flat_part(model.cameras[number]) for number in numbers}


def _options(max_image_size: int) -> pycolmap.UndistortCameraOptions:
    return pycolmap.UndistortCameraOptions(max_image_size=max_image_size)


def _pixels(camera: pycolmap.Camera, options: pycolmap.UndistortCameraOptions) -> int:
    """Return the pixels of a photograph or of what is made of it, whichever are more."""
    flat = pycolmap.undistort_camera(options, camera)
    return int(max(camera.width * camera.height, flat.width * flat.height))


def _cut(
    photographs: Path, parts: Mapping[str, FlatPart], folder: Path, read: Callable[[Path], NDArray[np.uint8]]
) -> Path:
    """Return a folder with the parts of the photographs: their own where all are whole, else `folder`, made anew."""
    if all(part.is_whole for part in parts.values()):
        return photographs
    shutil.rmtree(folder, ignore_errors=True)
    for name, part in parts.items():
        if part.is_whole:
            link_or_copy(photographs / name, folder / name)
        else:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            picture = Image.fromarray(part.of(read(photographs / name)))
            picture.save(folder / name, quality=_QUALITY, compress_level=1)
    return folder


def mask_of(dense_dir: Path, name: str) -> Path:
    """Return the path of the mask of an undistorted image, if it has one."""
    return dense_dir / "masks" / f"{name}.png"


def read_mask(dense_dir: Path, name: str) -> NDArray[np.uint8] | None:
    """Return (H, W) uint8, 0 where pixels are ignored; None for an image without a mask. Raises `ProjectError`."""
    file = mask_of(dense_dir, name)
    return read_grey(file) if file.is_file() else None


def read_grey(path: Path) -> NDArray[np.uint8]:
    """Return (H, W) uint8. Raises `ProjectError`."""
    values = _read(path, as_rgb=False)
    return values.reshape(values.shape[:2])


def read_colour(path: Path) -> NDArray[np.uint8]:
    """Return (H, W, 3) uint8 RGB. Raises `ProjectError`."""
    return _read(path, as_rgb=True)


def _read(path: Path, *, as_rgb: bool) -> NDArray[np.uint8]:
    # By pycolmap: its PNG reader works in every order of imports (photographs/png.py).
    bitmap = pycolmap.Bitmap.read(path, as_rgb=as_rgb)
    if bitmap is None:
        raise ProjectError(
            f"{path} cannot be read as an image", hint="run the dense stage again with --from dense"
        )
    return np.ascontiguousarray(bitmap.to_array())


def _undistort_masks(
    masks_dir: Path,
    dense_dir: Path,
    parts: Mapping[str, FlatPart],
    options: pycolmap.UndistortCameraOptions,
    progress: Progress,
) -> None:
    """Write the mask of each image, black wherever any black had a part in a pixel."""
    progress.start(len(parts), "undistorted masks")
    for name, part in parts.items():
        values = part.of(read_grey(masks_dir / f"{name}.png"))
        flat = pycolmap.undistort_camera(options, part.camera)
        if not part.camera.is_undistorted() or (flat.width, flat.height) != values.shape[::-1]:
            undistorted, _ = pycolmap.undistort_image(
                options, pycolmap.Bitmap.from_array(values), part.camera
            )
            values = undistorted.to_array().reshape(flat.height, flat.width)
        black_and_white = np.where(values == _WHITE, values, np.uint8(0))
        write_bytes(mask_of(dense_dir, name), encode_png(black_and_white))
        progress.advance()


def _require_files(folder: Path, names: list[str]) -> None:
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise ProjectError(
            f"{len(missing)} of {len(names)} images of the model are not in {folder}, first {missing[0]}",
            hint="check that the disk has room, and run the same command with --from convert",
        )
