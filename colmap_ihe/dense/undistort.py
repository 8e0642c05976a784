"""Write the COLMAP dense workspace: undistorted images, grey and in colour, and their masks.

`dense_dir` becomes a plain COLMAP dense workspace whose `images/` are the colour twins, so that fusion,
meshing and texturing see colour. Its model is there twice, in `sparse/` for COLMAP and in `sparse/0/` for the programs
of Gaussian splatting, which look for it there. `dense_dir/grey` is a second one, of the grey images on the same pixel
grid: there matching happens. `dense_dir/masks` holds a mask for each image, black where pixels are ignored.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.flat_parts import FlatPart, flat_part, write_flat_model
from colmap_ihe.errors import ProjectError
from colmap_ihe.machine import memory
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.files import require_same_folder, room_on_disk, write_bytes
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.photographs.encode import encode_image
from colmap_ihe.photographs.png import Png, decode_png, encode_png

UNDISTORT_BYTES_A_PIXEL = 12
"""Of a photograph in colour on its way, a thread: 11 measured with `benchmarks/limits.py threads`."""
_WHITE = 255
_CONTENTS = ("images", "sparse", "masks", "grey/images", "grey/sparse")
_MAPS = ("depth_maps", "normal_maps", "consistency_graphs")
_SOURCES = "__auto__, 20"  # of PatchMatch, chosen by COLMAP itself


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
    has no grey or no colour file, or one that cannot be read, `MappingError` for a camera of which nothing can be laid
    flat.
    """
    for folder in _CONTENTS:  # quickly, and not atomically
        shutil.rmtree(dense_dir / folder, ignore_errors=True)
    model = pycolmap.Reconstruction(sparse_model)
    cameras = _flat_cameras(model)
    parts = {image.name: cameras[image.camera_id] for image in _registered(model)}
    options = _options(max_image_size)
    largest = max((_pixels(part.camera, options) for part in parts.values()), default=0)
    threads = memory.workers_for("undistortion", UNDISTORT_BYTES_A_PIXEL * largest, local_workers())
    require_same_folder(dense_dir)
    workspaces = {dense_dir / "grey": grey_dir, dense_dir: colour_dir}
    for photographs in workspaces.values():
        _require_files(photographs, list(parts))

    def lay_flat(name: str) -> None:
        for workspace, photographs in workspaces.items():
            as_rgb = workspace == dense_dir
            _lay_flat(photographs / name, workspace / "images" / name, parts[name], options, as_rgb=as_rgb)

    progress.start(len(parts), "photographs laid flat")
    with ThreadPoolExecutor(threads) as pool:
        for _ in in_order(pool, lay_flat, list(parts), progress=progress):
            progress.advance()
    write_flat_model(model, cameras, options, dense_dir / "sparse")
    for copy in (dense_dir / "sparse" / "0", dense_dir / "grey" / "sparse"):
        _copy_model(dense_dir / "sparse", copy)
    for workspace in workspaces:
        _write_lists(workspace / "stereo", list(parts))
    if masks_dir is not None and masks_dir.is_dir():
        _undistort_masks(masks_dir, dense_dir, parts, options, progress)
    return parts


def _lay_flat(
    source: Path, target: Path, part: FlatPart, options: pycolmap.UndistortCameraOptions, *, as_rgb: bool
) -> None:
    """Write the part of a photograph as a pinhole camera sees it; one that is so already is copied."""
    flat = pycolmap.undistort_camera(options, part.camera)
    same_size = (flat.width, flat.height) == (part.camera.width, part.camera.height)
    if part.is_whole and same_size and part.camera.is_undistorted():
        write_bytes(target, source.read_bytes())
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    png = _read_png(source, as_rgb=as_rgb)
    if png is None:
        undistorted = _undistorted(_bitmap(source, as_rgb=as_rgb), part, options)
        if not undistorted.write(target):
            raise ProjectError(f"{target} cannot be written", hint="check that the disk has room")
        return
    exif, profile, bitmap = png.exif, png.profile, pycolmap.Bitmap.from_array(png.pixels)
    del png  # a photograph in full size
    values = _undistorted(bitmap, part, options).to_array().reshape(flat.height, flat.width, -1)
    with room_on_disk(target):
        target.write_bytes(encode_image(values if as_rgb else values[:, :, 0], exif, "png", profile))


def _undistorted(
    bitmap: pycolmap.Bitmap, part: FlatPart, options: pycolmap.UndistortCameraOptions
) -> pycolmap.Bitmap:
    if not part.is_whole:
        bitmap = pycolmap.Bitmap.from_array(part.of(bitmap.to_array()))
    undistorted, _ = pycolmap.undistort_image(options, bitmap, part.camera)
    return undistorted


def _copy_model(model: Path, folder: Path) -> None:
    for file in sorted(path for path in model.iterdir() if path.is_file()):
        write_bytes(folder / file.name, file.read_bytes())


def _write_lists(stereo: Path, names: Sequence[str]) -> None:
    """Write what COLMAP's PatchMatch and fusion read beside a model: the images to work on."""
    for folder in _MAPS:
        (stereo / folder).mkdir(parents=True, exist_ok=True)
    write_bytes(stereo / "fusion.cfg", "".join(f"{name}\n" for name in names).encode())
    sources = "".join(f"{name}\n{_SOURCES}\n" for name in names)
    write_bytes(stereo / "patch-match.cfg", sources.encode())


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
    if png := _read_png(path, as_rgb=as_rgb):
        return png.pixels
    return np.ascontiguousarray(_bitmap(path, as_rgb=as_rgb).to_array())


def _read_png(path: Path, *, as_rgb: bool) -> Png | None:
    """Return a PNG file of ours that has as many channels as are asked for; None for any other file."""
    if path.suffix.lower() != ".png" or not path.is_file():
        return None
    png = decode_png(path.read_bytes())
    fits = png is not None and png.pixels.shape[2:] == ((3,) if as_rgb else ())
    return png if fits else None


def _bitmap(path: Path, *, as_rgb: bool) -> pycolmap.Bitmap:
    # By pycolmap: its PNG reader works in every order of imports (photographs/png.py).
    bitmap = pycolmap.Bitmap.read(path, as_rgb=as_rgb)
    if bitmap is None:
        raise ProjectError(
            f"{path} cannot be read as an image", hint="run the same command with --from convert"
        )
    return bitmap


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
