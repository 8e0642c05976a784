"""Masks as people have them: what each keeps, by which names it is found, and what is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.pipeline.masks import make_masks
from colmap_ihe.project.folder import Project

_KEPT = np.arange(8 * 12).reshape(8, 12) % 3 > 0  # two thirds


def _palette(keep: NDArray[np.bool_]) -> Image.Image:
    image = Image.fromarray(keep.astype(np.uint8), "P")
    image.putpalette([0, 0, 0, 128, 0, 0])  # as labelling tools colour their first class
    return image


def _alpha(colour: int) -> Callable[[NDArray[np.bool_]], Image.Image]:
    return lambda keep: Image.fromarray(
        np.dstack([np.full((*keep.shape, 3), colour, np.uint8), np.where(keep, 255, 0).astype(np.uint8)])
    )


_WAYS: dict[str, Callable[[NDArray[np.bool_]], Image.Image]] = {
    "0 and 255": lambda keep: Image.fromarray(np.where(keep, 255, 0).astype(np.uint8)),
    "0 and 1": lambda keep: Image.fromarray(keep.astype(np.uint8)),
    "0 and 254": lambda keep: Image.fromarray(np.where(keep, 254, 0).astype(np.uint8)),
    "RGB of 16 and 235": lambda keep: Image.fromarray(
        np.repeat(np.where(keep, 235, 16).astype(np.uint8)[..., None], 3, 2)
    ),
    "1 bit": lambda keep: Image.fromarray(np.where(keep, 255, 0).astype(np.uint8)).convert("1"),
    "16 bit": lambda keep: Image.fromarray(np.where(keep, 65535, 0).astype(np.uint16)),
    "16 bit, 0 and 1": lambda keep: Image.fromarray(keep.astype(np.uint16)),
    "palette": _palette,
    "transparency of white": _alpha(255),
    "transparency of grey": _alpha(200),
}


def _project(root: Path, names: dict[str, str]) -> Project:
    """Return a project with grey images of 12x8 pixels. `names` of grey images by photograph."""
    (root / "images").mkdir(parents=True)
    project = Project(root, root / "images")
    project.grey.mkdir(parents=True)
    for grey in names.values():
        Image.new("L", (12, 8), 90).save(project.grey / grey)
    return project


def _save(folder: Path, name: str, image: Image.Image) -> None:
    folder.mkdir(exist_ok=True)
    image.save(folder / name)


@pytest.mark.parametrize("way", _WAYS)
def test_every_way_to_write_a_mask_keeps_the_same_pixels(tmp_path: Path, way: str) -> None:
    project = _project(tmp_path / "church", {"a.JPG": "a.png"})
    _save(project.masks, "a.JPG.png", _WAYS[way](_KEPT))
    folder, messages = make_masks(project, {"a.JPG": "a.png"}, {})
    assert folder is not None
    assert messages == []
    made = np.asarray(Image.open(folder / "a.png.png"))
    assert np.array_equal(made, np.where(_KEPT, 255, 0))


def test_the_noise_of_a_black_jpeg_keeps_nothing(tmp_path: Path) -> None:
    project = _project(tmp_path / "church", {"a.JPG": "a.png"})
    noise = np.arange(96).reshape(8, 12) % 4
    _save(project.masks, "a.jpg", Image.fromarray(noise.astype(np.uint8)))
    _, messages = make_masks(project, {"a.JPG": "a.png"}, {})
    assert messages == ["masks/: black all over, so nothing is kept: a.jpg"]
    assert not np.asarray(Image.open(project.made_masks / "a.png.png")).any()


def test_a_mask_that_hides_nothing_is_told(tmp_path: Path) -> None:
    project = _project(tmp_path / "church", {"a.JPG": "a.png"})
    _save(project.masks, "a.JPG.png", Image.new("L", (12, 8), 1))
    _, messages = make_masks(project, {"a.JPG": "a.png"}, {})
    assert messages == ["masks/: white all over, so nothing is hidden: a.JPG.png"]


@pytest.mark.parametrize(
    "name",
    [
        "a.NEF.png",
        "a.NEF.PNG",
        "a.nef.tif",
        "a.png",
        "a.png.png",
        "a_mask.png",
        "a.NEF_mask.jpg",
        "a.mask.png",
        "a.JPG.png",
    ],
)
@pytest.mark.parametrize("folder", ["masks", "mask", "Masks"])
def test_usual_names_of_masks_are_found(tmp_path: Path, name: str, folder: str) -> None:
    """Also after the JPEG that the camera wrote beside the RAW file."""
    _save_in = tmp_path / "church" / folder
    _project(tmp_path / "church", {"a.NEF": "a.png"})
    _save(_save_in, name, _WAYS["0 and 255"](np.arange(96).reshape(8, 12) < 48))
    project = Project(tmp_path / "church", tmp_path / "church/images")
    assert project.masks == _save_in
    _, messages = make_masks(project, {"a.NEF": "a.png"}, {"a.NEF": ["a.JPG"]})
    assert messages == []
    assert np.asarray(Image.open(project.made_masks / "a.png.png")).mean() == 127.5


def test_masks_of_nobody_are_named(tmp_path: Path) -> None:
    project = _project(tmp_path / "church", {"a.JPG": "a.png"})
    for name in ("a.JPG.png", "a.png", *(f"other{n}.JPG.png" for n in range(6))):
        _save(project.masks, name, _WAYS["0 and 255"](_KEPT))
    _, messages = make_masks(project, {"a.JPG": "a.png"}, {})
    [message] = messages
    assert message.startswith("masks/: not used, of no photograph: a.png, other0.JPG.png")
    assert "and 2 more; the mask of IMG_1.JPG is masks/IMG_1.JPG.png" in message
