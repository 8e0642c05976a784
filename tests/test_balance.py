"""Colour balance: a change of light is undone, and no RAW value grows."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.balance import Gains, balance_gains
from colmap_ihe.captures.decode import Photograph, read_photograph
from colmap_ihe.captures.discover import Capture, discover
from colmap_ihe.captures.recipe import Recipe
from colmap_ihe.demo.dng import write_dng
from colmap_ihe.demo.exif import PhotoExif
from colmap_ihe.progress import SILENT

LIGHTS = ((1.0, 1.0, 1.0), (0.8, 1.0, 0.6), (0.5, 0.7, 0.5))


def scene() -> NDArray[np.float64]:
    """(128, 160, 3): patches of 16 pixels of many colours."""
    patches = np.random.default_rng(3).uniform(0.1, 0.7, (8, 10, 3))
    return np.asarray(np.kron(patches, np.ones((16, 16, 1))))


def shoot_raw(folder: Path) -> tuple[Capture, ...]:
    for n, light in enumerate(LIGHTS):
        lit = scene() * light
        mosaic = lit[..., 1].copy()
        mosaic[::2, ::2], mosaic[1::2, 1::2] = lit[::2, ::2, 0], lit[1::2, 1::2, 2]
        write_dng(
            folder / f"{n}.dng",
            np.rint(mosaic * 15871 + 512).astype(np.uint16),
            black=512,
            white=16383,
            as_shot_neutral=(0.5, 1.0, 0.6),
            colour_matrix=np.eye(3),
            exif=PhotoExif(),
        )
    return discover(folder).captures


def shoot_coded(folder: Path) -> tuple[Capture, ...]:
    for n, light in enumerate(LIGHTS):
        Image.fromarray(np.rint(255 * scene() * light).astype(np.uint8)).save(folder / f"{n}.png")
    return discover(folder).captures


def balanced(captures: tuple[Capture, ...]) -> dict[str, Gains]:
    with ThreadPoolExecutor(2) as executor:
        return balance_gains(captures, executor, SILENT)


@pytest.mark.parametrize("shoot", [shoot_raw, shoot_coded])
def test_a_change_of_light_is_undone(tmp_path: Path, shoot: Callable[[Path], tuple[Capture, ...]]) -> None:
    captures = shoot(tmp_path)
    gains = balanced(captures)
    undone = np.array([gains[c.name] for c in captures]) * LIGHTS
    np.testing.assert_allclose(undone / undone[0], 1, rtol=0.02)


def test_raw_gains_never_exceed_1_and_coded_ones_keep_the_mean(tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    (tmp_path / "coded").mkdir()
    raw = np.array(list(balanced(shoot_raw(tmp_path / "raw")).values()))
    assert raw.max() == pytest.approx(1)
    coded = np.array(list(balanced(shoot_coded(tmp_path / "coded")).values()))
    np.testing.assert_allclose(np.exp(np.log(coded).mean(axis=0)), 1, rtol=1e-9)


def test_one_photograph_and_those_that_cannot_be_read_stay(tmp_path: Path) -> None:
    captures = shoot_coded(tmp_path)
    assert balanced(captures[:1]) == {captures[0].name: (1.0, 1.0, 1.0)}
    captures[1].path.write_bytes(b"no picture")
    gains = balanced(captures)
    assert gains[captures[1].name] == (1.0, 1.0, 1.0)
    assert gains[captures[0].name] != (1.0, 1.0, 1.0)


def test_a_black_photograph_stays(tmp_path: Path) -> None:
    captures = shoot_coded(tmp_path)
    Image.new("RGB", (160, 128)).save(captures[2].path)
    assert balanced(captures)[captures[2].name] == (1.0, 1.0, 1.0)


def test_raw_and_coded_are_balanced_apart(tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    (tmp_path / "coded").mkdir()
    raw = shoot_raw(tmp_path / "raw")
    coded = tuple(replace(c, name=f"coded-{c.name}") for c in shoot_coded(tmp_path / "coded"))
    assert balanced(raw + coded) == balanced(raw) | balanced(coded)


def test_denoising_is_not_done_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    captures = shoot_raw(tmp_path)
    noisy = tuple(replace(c, recipe=Recipe(denoise=1.0)) for c in captures)
    seen: list[float] = []

    def watched(capture: Capture) -> Photograph:
        seen.append(capture.recipe.denoise)
        return read_photograph(capture)

    monkeypatch.setattr("colmap_ihe.balance.read_photograph", watched)
    assert balanced(noisy) == balanced(captures)
    assert set(seen) == {0.0}
