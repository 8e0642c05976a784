"""Sets that no survey should hold and some do: each ends with a sentence, none with a traceback or a wrong grey."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from command_line import Captured
from icc import rgb_profile
from PIL import Image
from same_results import pixels_of

from colmap_ihe.cli import main
from colmap_ihe.evaluation.demo.dng import write_dng
from colmap_ihe.evaluation.demo.exif import PhotoExif

SIZE = (90, 70)
Commands = tuple[tuple[str | Path, ...], ...]
REC709 = [0.21, 0.72, 0.07]  # the tie goes to the triplet of the grid that is nearest to it


@pytest.fixture
def photos(tmp_path: Path) -> Path:
    (tmp_path / "photos").mkdir()
    return tmp_path / "photos"


def colour(file: Path, seed: int = 0, **more: Any) -> None:
    pixels = np.random.default_rng(seed).integers(0, 256, (*SIZE[::-1], 3), np.uint8)
    Image.fromarray(pixels).save(file, **more)


def grey(file: Path, mode: str = "L", seed: int = 0) -> None:
    pixels = np.random.default_rng(seed).integers(0, 256, SIZE[::-1], np.uint8)
    Image.fromarray(pixels).convert(mode).save(file)


@pytest.fixture
def commands(photos: Path, tmp_path: Path) -> Commands:
    """What works on all photographs."""
    return (("fit", photos), ("convert", photos, tmp_path / "grey"))


def run(capsys: Captured, *arguments: str | Path) -> tuple[Any, str]:
    """The JSON of a command that ends well, and its warnings."""
    status = main([*map(str, arguments), "--json", "-q"])
    captured = capsys.readouterr()
    assert status == 0, captured.err
    return json.loads(captured.out), captured.err


@pytest.mark.parametrize("mode", ["L", "LA", "1", "RGB"])
def test_greyscale_photographs_only(
    capsys: Captured, photos: Path, commands: Commands, tmp_path: Path, mode: str
) -> None:
    for seed in range(2):
        grey(photos / f"{seed}.png", mode, seed)
    for command in (*commands, commands[1]):  # the fit that was kept says it again
        found, warnings = run(capsys, *command)
        assert found["weights"] == REC709
        assert "the photographs are greyscale (R = G = B)" in warnings
    with Image.open(photos / "0.png") as source, Image.open(tmp_path / "grey/0.png") as image:
        np.testing.assert_array_equal(np.asarray(image), np.asarray(source.convert("RGB"))[..., 0])


def test_one_colour_photograph_or_fixed_weights_need_no_warning(
    capsys: Captured, photos: Path, tmp_path: Path
) -> None:
    grey(photos / "a.png")
    assert run(capsys, "convert", photos, tmp_path / "grey", "--method", "mean")[1] == ""
    colour(photos / "b.png")
    assert run(capsys, "fit", photos, "--step", "0.1")[1] == ""
    Image.new("RGB", SIZE).save(photos / "black.png")
    found, warnings = run(capsys, "convert", photos, tmp_path / "grey")
    assert (warnings, found["left_out"]) == ("", {})


def test_all_photographs_are_black(
    capsys: Captured, photos: Path, commands: Commands, tmp_path: Path
) -> None:
    for name in ("a.png", "b.jpg"):
        Image.new("RGB", SIZE).save(photos / name)
    for command in commands:
        found, warnings = run(capsys, *command)
        assert (found["weights"], found["tones"]) == (REC709, 1)
        assert "hold a single tone, as if all were black" in warnings
    assert pixels_of(tmp_path / "grey/a.png").max() == 0


def test_all_raw_photographs_are_black(capsys: Captured, photos: Path, commands: Commands) -> None:
    write_dng(
        photos / "a.dng", np.full(SIZE[::-1], 512, np.uint16), black=512, white=16383, as_shot_neutral=(0.5, 1, 0.6),
        colour_matrix=np.eye(3), exif=PhotoExif(),
    )  # fmt: skip
    for command in commands:
        assert "hold a single tone" in run(capsys, *command)[1]


def test_a_mixed_set(capsys: Captured, photos: Path, tmp_path: Path, small_demo: Path) -> None:
    """Two RAW and a JPEG of others: fitted apart, and said."""
    for number in (1, 2):
        shutil.copy(small_demo / f"images/portico_0{number}.dng", photos)
    shutil.copy(small_demo / "images/portico_03.jpg", photos)
    found, warnings = run(capsys, "fit", photos, "--step", "0.1")
    assert (found["encoding"], found["images"]) == ("linear", 2)
    assert "these are the weights of the larger part" in warnings
    found, warnings = run(capsys, "convert", photos, tmp_path / "grey")
    assert "each kind has weights of its own" in warnings
    assert len(found["grey"]) == 3
    for number in (1, 3):
        grey_image = pixels_of(tmp_path / f"grey/portico_0{number}.png")
        assert grey_image.ndim == 2 and grey_image.std() > 10


@pytest.mark.parametrize("command", ["fit", "convert"])
def test_several_profiles(capsys: Captured, photos: Path, tmp_path: Path, command: str) -> None:
    colour(photos / "a.png", 1)
    colour(photos / "b.png", 2, icc_profile=rgb_profile("sRGB IEC61966-2.1"))
    more = [tmp_path / "grey"] if command == "convert" else []
    assert run(capsys, command, photos, *more)[1] == ""
    colour(photos / "c.png", 3, icc_profile=rgb_profile("Adobe RGB (1998)"))
    _, warnings = run(capsys, command, photos, *more)
    assert "in different colour profiles (2 in sRGB, 1 in Adobe RGB)" in warnings
    assert "cannot be read" not in warnings
    colour(photos / "d.png", 4, icc_profile=rgb_profile("Adobe RGB (1998)")[:140])
    _, warnings = run(capsys, command, photos, *more)
    assert "1 photograph with a profile that cannot be read: their colours are taken for sRGB" in warnings
    assert "in different colour profiles (2 in sRGB" in warnings


def test_pictures_of_kinds_that_are_not_read_are_named(
    capsys: Captured, photos: Path, commands: Commands
) -> None:
    colour(photos / "a.png")
    (photos / "b.webp").touch()
    for command in commands:
        assert "1 WebP picture cannot be used, b.webp: save it as JPEG" in run(capsys, *command)[1]


def test_a_project_of_unusual_photographs(capsys: Captured, tmp_path: Path) -> None:
    """The same sentences from reconstruct, whose twins and grey images have no profile."""
    images = tmp_path / "project/images"
    images.mkdir(parents=True)
    adobe = rgb_profile("Adobe RGB (1998)")
    pixels = np.random.default_rng(1).integers(0, 256, (*SIZE[::-1], 1), np.uint8).repeat(3, axis=2)
    Image.fromarray(pixels).save(images / "a.png", icc_profile=adobe)
    tifffile.imwrite(images / "b.tif", np.stack([pixels, pixels]), photometric="rgb")
    found, _ = run(capsys, "reconstruct", tmp_path / "project", "--until", "convert")
    greyscale, profiles = "are greyscale (R = G = B)", "different colour profiles"
    for words in (greyscale, profiles, "the first one is used: b.tif (2)"):
        assert sum(words in text for text in found["warnings"]) == 1
    for name in ("colour/a.png", "workspace/images/a.png"):
        with Image.open(tmp_path / "project" / name) as image:
            assert "icc_profile" not in image.info
