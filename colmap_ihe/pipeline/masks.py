"""Read the user's masks and write COLMAP's.

One reading for all stages: what is brighter than half of a mask's largest value is kept, so that 0 and 1, 0 and 255,
16 bit, palettes and transparency all mean what their author sees. COLMAP's masks hold 0 and 255 and nothing else.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.errors import ProjectError
from colmap_ihe.machine.files import leads_out, open_file, write_bytes
from colmap_ihe.machine.words import listed
from colmap_ihe.photographs.png import encode_png
from colmap_ihe.pipeline.input_digests import MASK_SUFFIXES, mask_files
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
_BETWEEN = ("", "_mask", ".mask")
"""What stands between the photograph's name and the suffix in COLMAP, OpenDroneMap and RealityScan."""
_NOISY_WHITE = 255  # a JPEG of nothing but black holds some 1 and 2


def make_masks(
    project: Project, grey_names: Mapping[str, str], paired: Mapping[str, Sequence[str]]
) -> tuple[Path | None, list[str]]:
    """Write COLMAP's mask folder from the user's masks; return it, None without masks, and what to tell about them.
    `grey_names` and the JPEG files `paired` with a RAW file by photograph."""
    shutil.rmtree(project.made_masks, ignore_errors=True)
    if not project.masks.is_dir():
        return None, []
    kept = write_masks(project.masks, grey_names, project.grey, project.made_masks, paired)
    return project.made_masks, list(_warnings(project.masks, kept))


def _warnings(masks: Path, kept: Mapping[str, float]) -> Iterator[str]:
    unused = [name for name in mask_files(masks) if name not in kept]
    if unused:
        yield (
            f"{masks.name}/: not used, of no photograph: {listed(unused)};"
            f" the mask of IMG_1.JPG is {masks.name}/IMG_1.JPG.png or {masks.name}/IMG_1_mask.png"
        )
    if empty := [name for name, share in kept.items() if share == 0]:
        yield f"{masks.name}/: black all over, so nothing is kept: {listed(empty)}"
    if full := [name for name, share in kept.items() if share == 1]:
        yield f"{masks.name}/: white all over, so nothing is hidden: {listed(full)}"


def write_masks(
    masks: Path,
    grey_names: Mapping[str, str],
    grey_folder: Path,
    out: Path,
    paired: Mapping[str, Sequence[str]] | None = None,
) -> dict[str, float]:
    """Write COLMAP's masks for grey images (GREY.png.png: 0 is left out, 255 kept) from those of the user, who may
    name a mask after the photograph, with its suffix or without, its grey image, or the JPEG of a RAW file; white
    where there is none.

    `grey_names` and `paired` by photograph. Return the share of pixels that each used mask keeps, by its name. Raises
    `ProjectError` for one that cannot be read, is of another size, or lies elsewhere.
    """
    files = mask_files(masks)
    by_folded = {name.casefold(): name for name in files} | {name: name for name in files}
    kept: dict[str, float] = {}
    for photograph, grey in grey_names.items():
        with Image.open(grey_folder / grey) as image:
            size = image.size
        name = _mask_name(by_folded, (photograph, grey, *(paired or {}).get(photograph, ())))
        mask = np.ones(size[::-1], bool)
        if name:
            mask = _read_mask(masks, name, size)
            kept[name] = float(mask.mean())
        write_bytes(out / f"{grey}.png", encode_png(np.where(mask, np.uint8(255), np.uint8(0))))
    return kept


def _mask_name(by_folded: Mapping[str, str], names: Iterable[str]) -> str:
    """Return the mask that is named after one of `names`, empty for none. Case does not matter, unless it has to."""
    names = list(names)
    bases = dict.fromkeys([*names, *(str(Path(name).with_suffix("")) for name in names)])
    for base in bases:
        for between in _BETWEEN:
            for suffix in MASK_SUFFIXES:
                wanted = f"{base}{between}{suffix}"
                if found := by_folded.get(wanted) or by_folded.get(wanted.casefold()):
                    return found
    return ""


def _read_mask(masks: Path, name: str, size: tuple[int, int]) -> NDArray[np.bool_]:
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
            return kept_pixels(image)
    except _UNREADABLE_MASK as error:
        raise ProjectError(
            f"{path}: cannot be read as a mask ({error})", hint="save it as a PNG again"
        ) from error


def kept_pixels(image: Image.Image) -> NDArray[np.bool_]:
    """Return which pixels a mask keeps, (H, W) bool: those above half of its largest value, or of 255 in a JPEG. In
    colour the brightest channel counts; transparency makes dark."""
    largest = _NOISY_WHITE if image.format == "JPEG" else None
    if image.mode in ("P", "PA") or "transparency" in image.info:
        image = image.convert("RGBA")
    elif image.mode == "CMYK":
        image = image.convert("RGB")
    values = np.nan_to_num(np.asarray(image, np.float32))
    if values.ndim == 3:
        has_alpha = image.mode in ("LA", "RGBA")
        brightest = values[..., : values.shape[2] - has_alpha].max(axis=2)
        values = brightest * values[..., -1] / 255 if has_alpha else brightest
    return np.asarray(values > (values.max() if largest is None else largest) / 2)
