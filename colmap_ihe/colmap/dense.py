"""Dense reconstruction: undistortion, depth maps, fusion. From paths and options to counts.

`dense_dir` becomes a plain COLMAP dense workspace whose `images/` are the colour twins, so that fusion,
meshing and texturing see colour. `dense_dir/grey` is a second one, of the grey images on the same pixel
grid: there matching happens. Depth and normal maps lie in `dense_dir/stereo`, whichever backend made them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from colmap_ihe.colmap.depth_maps import DepthCounts, sgm_depth_maps
from colmap_ihe.colmap.native import apply_options, called, pycolmap
from colmap_ihe.errors import CapabilityError, ProjectError
from colmap_ihe.progress import SILENT, Watch

__all__ = [
    "Backend",
    "DepthCounts",
    "fuse",
    "patchmatch_depth_maps",
    "pick_backend",
    "sgm_depth_maps",
    "undistort",
]

Backend = Literal["patchmatch", "sgm"]

# Fusion holds all maps in memory up to this much, and above it only the ones it has just used.
FUSION_MEMORY_GB = 4.0
# Every pixel of our depth maps was confirmed by other photographs, so that two maps that agree are enough
# (COLMAP asks for five). Within less than a pixel, so that the cloud keeps the images' resolution: COLMAP's
# two pixels leave about half of the points. Depth and normals are checked as COLMAP does.
FUSION_DEFAULTS: Mapping[str, Any] = {"min_num_pixels": 2, "max_reproj_error": 0.75}


def pick_backend(requested: Literal["auto", "patchmatch", "sgm"] = "auto") -> Backend:
    """The backend that will run. Raises `CapabilityError` if PatchMatch is asked for and there is no CUDA."""
    if requested == "auto":
        return "patchmatch" if pycolmap.has_cuda else "sgm"
    if requested == "patchmatch" and not pycolmap.has_cuda:
        raise CapabilityError(
            "dense.backend is 'patchmatch', which needs CUDA, and pycolmap has none here",
            hint="install pycolmap-cuda12 on a machine with an NVIDIA GPU, or set dense.backend to 'sgm'",
        )
    return requested


def undistort(
    sparse_model: Path,
    grey_dir: Path,
    colour_dir: Path,
    dense_dir: Path,
    *,
    max_image_size: int = -1,
    watch: Watch = SILENT,
) -> int:
    """Writes both workspaces from a sparse model with its grey and colour images; returns their number.

    `max_image_size` bounds the longer side in pixels, -1 for none. Raises `ProjectError` if an image of the
    model has no grey or no colour file, or came out without one.
    """
    model = pycolmap.Reconstruction(sparse_model)
    names = [model.images[image_id].name for image_id in model.reg_image_ids()]
    options = pycolmap.UndistortCameraOptions(max_image_size=max_image_size)
    workspaces = {dense_dir / "grey": grey_dir, dense_dir: colour_dir}
    watch.start(len(workspaces), "undistorted sets")
    for workspace, images in workspaces.items():
        _require_files(images, names)
        workspace.mkdir(parents=True, exist_ok=True)
        called(
            pycolmap.undistort_images, workspace, sparse_model, images, undistort_options=options, watch=watch
        )
        _require_files(workspace / "images", names)
        watch.advance()
    return len(names)


def patchmatch_depth_maps(
    dense_dir: Path, *, options: Mapping[str, Any] | None = None, watch: Watch = SILENT
) -> int:
    """Depth and normal maps by COLMAP's PatchMatch on CUDA, from the grey images; returns their number.

    `options` goes to pycolmap.PatchMatchOptions.
    """
    native = patchmatch_options(options or {})
    watch.start(1, "runs of PatchMatch")
    called(pycolmap.patch_match_stereo, dense_dir / "grey", options=native, watch=watch)
    # Copied by link, not moved: COLMAP skips the maps that it finds in its own workspace.
    for made in (dense_dir / "grey" / "stereo").glob("*_maps/**/*.geometric.bin"):
        target = dense_dir / made.relative_to(dense_dir / "grey")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        target.hardlink_to(made)
    watch.advance()
    return len(list((dense_dir / "stereo" / "depth_maps").glob("**/*.geometric.bin")))


def fuse(dense_dir: Path, *, options: Mapping[str, Any] | None = None, watch: Watch = SILENT) -> int:
    """Fuses the depth maps to the coloured cloud `dense_dir/fused.ply`; returns its number of points.

    `options` goes to pycolmap.StereoFusionOptions, over `FUSION_DEFAULTS`.
    """
    native = fusion_options({**_fusion_memory(dense_dir), **(options or {})})
    part = dense_dir / "fused.part.ply"
    watch.start(1, "fusions")
    cloud = called(pycolmap.stereo_fusion, part, dense_dir, options=native, output_type="ply", watch=watch)
    for suffix in (".vis", ""):
        part.with_name(part.name + suffix).replace(dense_dir / f"fused.ply{suffix}")
    watch.advance()
    return int(cloud.num_points3D())


def patchmatch_options(values: Mapping[str, Any]) -> pycolmap.PatchMatchOptions:
    """Raises `OptionError`."""
    native = pycolmap.PatchMatchOptions()
    apply_options(native, values, "dense.patchmatch")
    return native


def fusion_options(values: Mapping[str, Any]) -> pycolmap.StereoFusionOptions:
    """`FUSION_DEFAULTS` with `values` over them. Raises `OptionError`."""
    native = pycolmap.StereoFusionOptions(**FUSION_DEFAULTS)
    apply_options(native, values, "dense.colmap")
    return native


def _fusion_memory(dense_dir: Path) -> dict[str, Any]:
    """Fusion's cache options: depth, normal, colour and a mark take 4 + 12 + 3 + 4 bytes a pixel."""
    model = pycolmap.Reconstruction(dense_dir / "sparse")
    cameras = [model.cameras[image.camera_id] for image in model.images.values()]
    needed_gb = sum(camera.width * camera.height for camera in cameras) * 23 / 1e9
    return {"use_cache": needed_gb > FUSION_MEMORY_GB, "cache_size": FUSION_MEMORY_GB}


def _require_files(folder: Path, names: list[str]) -> None:
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise ProjectError(
            f"{len(missing)} of {len(names)} images of the model are not in {folder}, first {missing[0]}",
            hint="check that the disk has room, and run the same command with --from convert",
        )
