"""Colour balance: a change of light is undone, and no RAW value grows."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dngs import shoot
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.colour_balance import Gains, balance_gains
from colmap_ihe.photographs.decode import DecodedPhotograph, read_photograph
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.project.recipe import Recipe

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
        shoot(folder / f"{n}.dng", np.rint(mosaic * 15871 + 512).astype(np.uint16))
    return discover(folder).captures


def shoot_coded(folder: Path) -> tuple[Capture, ...]:
    for n, light in enumerate(LIGHTS):
        Image.fromarray(np.rint(255 * scene() * light).astype(np.uint8)).save(folder / f"{n}.png")
    return discover(folder).captures


def balanced(captures: tuple[Capture, ...]) -> dict[str, Gains]:
    with ThreadPoolExecutor(2) as executor:
        return balance_gains(captures, executor, SILENT)


def test_a_change_of_light_is_undone_in_raw(tmp_path: Path) -> None:
    captures = shoot_raw(tmp_path)
    gains = np.array([balanced(captures)[c.name] for c in captures])
    undone = gains * LIGHTS
    np.testing.assert_allclose(undone / undone[0], 1, rtol=0.02)
    assert gains.max() == pytest.approx(1)


def test_a_cast_is_undone_in_coded_photographs_and_brightness_stays(tmp_path: Path) -> None:
    captures = shoot_coded(tmp_path)
    gains = np.array([balanced(captures)[c.name] for c in captures])
    undone = gains * LIGHTS
    hue = undone / undone.mean(axis=1, keepdims=True)
    np.testing.assert_allclose(hue / hue[0], 1, rtol=0.02)
    np.testing.assert_allclose(np.exp(np.log(gains).mean(axis=1)), 1, rtol=1e-9)
    np.testing.assert_allclose(np.exp(np.log(gains).mean(axis=0)), 1, rtol=1e-9)


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

    def watched(capture: Capture) -> DecodedPhotograph:
        seen.append(capture.recipe.denoise)
        return read_photograph(capture)

    monkeypatch.setattr("colmap_ihe.photographs.colour_balance.read_photograph", watched)
    assert balanced(noisy) == balanced(captures)
    assert set(seen) == {0.0}
