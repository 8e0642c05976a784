"""Read the user's masks and write COLMAP's."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.files import leads_out, open_file, write_bytes
from colmap_ihe.photographs.png import encode_png
from colmap_ihe.project.folder import Project

MASKS = ("PNG", "JPEG", "TIFF", "BMP")
"""The kinds of files that are read as masks, whatever their name: Pillow would run a program for some others."""
_UNREADABLE_MASK = (
    OSError,
    SyntaxError,
    ValueError,
    TypeError,
    struct.error,
    Image.DecompressionBombError,
    MemoryError,
)


def make_masks(project: Project, grey_names: Mapping[str, str]) -> tuple[Path | None, list[str]]:
    """Write COLMAP's mask folder from the user's masks; return it, None without masks, and what was not used."""
    shutil.rmtree(project.made_masks, ignore_errors=True)
    if not project.masks.is_dir():
        return None, []
    used = write_masks(project.masks, grey_names, project.grey, project.made_masks)
    unused = sorted({p.relative_to(project.masks).as_posix() for p in project.masks.rglob("*.png")} - used)
    if not unused:
        return project.made_masks, []
    return project.made_masks, [
        f"{len(unused)} masks belong to no photograph, as masks/{unused[0]}: IMG.JPG has IMG.JPG.png"
    ]


def write_masks(masks: Path, grey_names: Mapping[str, str], grey_folder: Path, out: Path) -> set[str]:
    """Write COLMAP's masks for grey images (GREY.png.png, black is left out) from those of the user, who may name a
    mask after the photograph (IMG.JPG.png) or the grey image; white where there is none.

    `grey_names` by photograph. Return the masks used. Raises `ProjectError` for one that
    cannot be read, is of another size, or lies elsewhere.
    """
    used = set()
    for photograph, grey in grey_names.items():
        with Image.open(grey_folder / grey) as image:
            size = image.size
        mask = np.full(size[::-1], 255, np.uint8)
        for name in (f"{photograph}.png", f"{grey}.png"):
            if not (masks / name).is_file():
                continue
            mask = _read_mask(masks, name, size)
            used.add(name)
            break
        write_bytes(out / f"{grey}.png", encode_png(mask))
    return used


def _read_mask(masks: Path, name: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    path = masks / name
    if leads_out(path, masks):
        raise ProjectError(
            f"{path}: a link that leads out of the folder of masks", hint="put the mask in its place"
        )
    try:
        with open_file(path) as file, Image.open(file, formats=MASKS) as image:
            if image.size != size:  # before its pixels are decoded, of which there may be too many
                raise ProjectError(
                    f"{path}: {image.width}x{image.height} pixels, its photograph has {size[0]}x{size[1]}",
                    hint="masks have the size of the photograph as stored, not turned upright",
                )
            return np.asarray(image.convert("L"))
    except _UNREADABLE_MASK as error:
        raise ProjectError(
            f"{path}: cannot be read as a mask ({error})", hint="save it as a PNG again"
        ) from error
