"""Write the COLMAP dense workspace: undistorted images, grey and in colour, and their masks.

`dense_dir` becomes a plain COLMAP dense workspace whose `images/` are the colour twins, so that fusion,
meshing and texturing see colour. Its model is there twice, in `sparse/` for COLMAP and in `sparse/0/` for the programs
of Gaussian splatting, which look for it there. `dense_dir/grey` is a second one, of the grey images on the same pixel
grid: there matching happens. `dense_dir/masks` holds a mask for each image, black where pixels are ignored.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import called, pycolmap
from colmap_ihe.errors import ProjectError
from colmap_ihe.machine import memory
from colmap_ihe.machine.files import require_same_folder, write_bytes
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.png import encode_png

UNDISTORT_BYTES_A_PIXEL = 8
"""Of a photograph in colour on its way, a thread: 4 to 7 measured with `benchmarks/limits.py threads`."""
_WHITE = 255
_CONTENTS = ("images", "sparse", "masks", "grey/images", "grey/sparse")


def undistort(
    sparse_model: Path,
    grey_dir: Path,
    colour_dir: Path,
    dense_dir: Path,
    *,
    masks_dir: Path | None = None,
    max_image_size: int = -1,
    progress: Progress = SILENT,
) -> int:
    """Write both workspaces anew from a sparse model with its grey and colour images; return their number.

    `masks_dir`, where it exists, has COLMAP's mask of each image, NAME.png. Depth maps are left.
    `max_image_size` bounds the longer side in pixels, -1 for none. Raises `ProjectError` if an image of the model
    has no grey or no colour file, before or after.
    """
    for folder in _CONTENTS:  # quickly, and not atomically
        shutil.rmtree(dense_dir / folder, ignore_errors=True)
    model = pycolmap.Reconstruction(sparse_model)
    names = [model.images[image_id].name for image_id in model.reg_image_ids()]
    options = pycolmap.UndistortCameraOptions(max_image_size=max_image_size)
    cameras = model.cameras.values()
    bytes_a_thread = UNDISTORT_BYTES_A_PIXEL * max((c.width * c.height for c in cameras), default=0)
    threads = memory.workers_for("undistortion", bytes_a_thread, local_workers())
    workspaces = {dense_dir / "grey": grey_dir, dense_dir: colour_dir}
    progress.start(len(workspaces), "undistorted sets")
    for workspace, images in workspaces.items():
        _require_files(images, names)
        require_same_folder(workspace)
        workspace.mkdir(parents=True, exist_ok=True)
        called(
            pycolmap.undistort_images,
            workspace,
            sparse_model,
            images,
            undistort_options=options,
            num_threads=threads,
            progress=progress,
        )
        _require_files(workspace / "images", names)
        progress.advance()
    for file in sorted(p for p in (dense_dir / "sparse").iterdir() if p.is_file()):
        write_bytes(dense_dir / "sparse" / "0" / file.name, file.read_bytes())
    if masks_dir is not None and masks_dir.is_dir():
        _undistort_masks(masks_dir, dense_dir, model, options, progress)
    return len(names)


def sizes_of(sparse_model: Path) -> list[tuple[int, int]]:
    """Return width and height in pixels of every registered image of a model."""
    model = pycolmap.Reconstruction(sparse_model)
    cameras = [model.cameras[model.images[i].camera_id] for i in model.reg_image_ids()]
    return [(camera.width, camera.height) for camera in cameras]


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
    model: pycolmap.Reconstruction,
    options: pycolmap.UndistortCameraOptions,
    progress: Progress,
) -> None:
    """Write the mask of each image, black wherever any black had a part in a pixel."""
    progress.start(len(model.reg_image_ids()), "undistorted masks")
    for image in (model.images[image_id] for image_id in model.reg_image_ids()):
        mask = pycolmap.Bitmap.from_array(read_grey(masks_dir / f"{image.name}.png"))
        undistorted, _ = pycolmap.undistort_image(options, mask, model.cameras[image.camera_id])
        values = undistorted.to_array().reshape(undistorted.height, undistorted.width)
        black_and_white = np.where(values == _WHITE, values, np.uint8(0))
        write_bytes(mask_of(dense_dir, image.name), encode_png(black_and_white))
        progress.advance()


def _require_files(folder: Path, names: list[str]) -> None:
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise ProjectError(
            f"{len(missing)} of {len(names)} images of the model are not in {folder}, first {missing[0]}",
            hint="check that the disk has room, and run the same command with --from convert",
        )
