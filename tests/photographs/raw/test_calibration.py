"""Calibration frames: which belong to a shot, what is made of them, and what they do on the whole way."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dngs import shoot as write_shot
from numpy.typing import NDArray

from colmap_ihe.errors import PhotographError, ProjectError
from colmap_ihe.evaluation.demo.exif import PhotoExif
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.raw.calibration import (
    KINDS,
    Master,
    Shot,
    flat_gain,
    groups_of,
    hot_pixels,
    matched,
    mean_of,
    read_bad_pixels,
)
from colmap_ihe.photographs.raw.mosaic import Mosaic
from colmap_ihe.photographs.recipes import Recipes, recipe_notes, with_recipes
from colmap_ihe.photographs.survey import survey
from colmap_ihe.project.options import DevelopOptions
from colmap_ihe.project.recipe import Recipe, recipe_from_dict

BAYER = np.array([[0, 1], [3, 2]], np.uint8)
SIZE = (96, 128)
BLACK, WHITE = 512, 16383
SHOT = Shot(128, 96, "Maker", "One", "77", exposure_s=0.01, iso=400, lens="L", focal_mm=24, f_number=8)


def like(values: NDArray[Any]) -> Mosaic:
    return Mosaic(values.astype(np.uint16), BAYER, np.full((2, 2), BLACK, np.float32), WHITE)


def test_frames_are_averaged_by_what_matters_to_their_kind() -> None:
    changes: list[dict[str, Any]] = [{}, {"f_number": 4.0}, {"exposure_s": 0.5}, {"iso": 800}]
    shots = [(name, replace(SHOT, **change)) for name, change in zip("abcd", changes, strict=True)]
    names = [["".join(sorted(n)) for _, n in groups_of(shots, kind)] for kind in KINDS]
    assert names == [["abc", "d"], ["ab", "c", "d"], ["a", "b", "c", "d"]]


def test_the_mean_of_frames() -> None:
    frames = [like(np.full(SIZE, v)) for v in (500, 501, 505)]
    mean, _ = mean_of(frames)
    assert mean.dtype == np.float32
    np.testing.assert_allclose(mean, 502)
    with pytest.raises(ProjectError, match="several sizes"):
        mean_of([frames[0], like(np.zeros((4, 4)))])
    with pytest.raises(ProjectError, match="no calibration frame"):
        mean_of([])


def test_a_flat_field_changes_no_balance_and_shows_dead_pixels() -> None:
    x = np.arange(SIZE[1])[None, :]
    light = 1 - 0.3 * (x / SIZE[1]) ** 2
    gains = np.tile([[0.4, 1.0], [0.98, 0.6]], (SIZE[0] // 2, SIZE[1] // 2))
    mean = (BLACK + 8000 * light * gains).astype(np.float32)
    mean[10, 20] = BLACK + 100
    gain, bad = flat_gain(mean, like(mean), None)
    assert bad.tolist() == [[10, 20]]
    evened = (mean - BLACK) * gain
    evened[10, 20] = evened[10, 22]
    for places in ([(0, 0)], [(0, 1), (1, 0)], [(1, 1)]):
        cells = np.concatenate([evened[y::2, x::2].ravel() for y, x in places])
        light_of = np.concatenate([(mean - BLACK)[y::2, x::2].ravel() for y, x in places])
        assert np.ptp(cells) / cells.mean() < 1e-4
        assert cells.mean() == pytest.approx(light_of.mean(), rel=1e-3)


def test_hot_pixels_stand_out_of_the_noise_of_a_dark_frame() -> None:
    rng = np.random.default_rng(3)
    dark = rng.normal(BLACK, 4, SIZE).astype(np.float32)
    dark[5, 7] += 400
    dark[60, 90] += 20  # noise, or next to it
    assert hot_pixels(dark, like(dark)).tolist() == [[5, 7]]


def test_a_list_of_bad_pixels(tmp_path: Path) -> None:
    file = tmp_path / "bad-pixels.txt"
    file.write_text("# column row\n12 3 0\n\n  7 9  # a line of dcraw's ends in a time\n")
    assert read_bad_pixels(file).tolist() == [[3, 12], [9, 7]]
    file.write_text("")
    assert read_bad_pixels(file).shape == (0, 2)
    for wrong in ("12", "a b", "-1 3", "1.5 2", "9999999 1"):
        file.write_text(f"1 2\n{wrong}\n")
        with pytest.raises(ProjectError, match="line 2"):
            read_bad_pixels(file)


def master(kind: Any, **differs: Any) -> Master:
    shot = replace(SHOT, **differs)
    name = f"{kind}-{shot.iso:g}-{shot.exposure_s:g}-{shot.focal_mm:g}.npy"
    return Master(kind, shot, 8, name, f"bad-{kind}")


@pytest.mark.parametrize(
    ("masters", "expected", "says"),
    [
        ([master("darks")], {"dark": "darks-400-0.01-24.npy"}, ""),
        ([master("darks"), master("darks", exposure_s=1.0)], {"dark": "darks-400-0.01-24.npy"}, ""),
        ([master("darks", exposure_s=1.0)], {}, "no dark frame of 0.01 s"),
        ([master("darks", iso=800)], {}, "no dark frame of ISO 400"),
        ([master("darks", iso=0, exposure_s=0)], {"dark": "darks-0-0-24.npy"}, ""),
        ([master("bias")], {"bias": "bias-400-0.01-24.npy"}, ""),
        ([master("bias"), master("darks", exposure_s=0.04)],
         {"bias": "bias-400-0.01-24.npy", "dark": "darks-400-0.04-24.npy", "dark_scale": 0.25}, ""),
        ([master("flats"), master("flats", focal_mm=50)], {"flat": "flats-400-0.01-24.npy"}, ""),
        ([master("flats", focal_mm=50)], {"flat": "flats-400-0.01-50.npy"}, "not of its lens"),
        ([master("darks", serial="78")], {}, "no calibration frame is of its camera"),
        ([master("darks", width=64)], {}, "no calibration frame is of its camera"),
    ],
)  # fmt: skip
def test_frames_are_matched_to_a_shot(masters: list[Master], expected: dict[str, Any], says: str) -> None:
    said: list[str] = []
    recipe, bad = matched(SHOT, masters, Recipe(), said.append)
    assert recipe.as_dict() == expected
    assert all(b.startswith("bad-") for b in bad)
    assert len(said) == (says != "")
    assert says in "".join(said)


def test_a_recipe_comes_back_from_plain_values() -> None:
    recipe = Recipe(demosaic="vng", dark="/a/d.npy", dark_scale=0.5, gains=(1.0, 0.5, 2.0), denoise=1.5)
    assert recipe_from_dict(recipe.as_dict()) == recipe
    assert Recipe().as_dict() == {}
    assert recipe.identity() == replace(recipe, dark="/b/c/d.npy").identity()
    assert recipe_from_dict(recipe.identity(), Path("/a")) == recipe
    with pytest.raises(ValueError, match="nonsense"):
        recipe_from_dict({"nonsense": 1})


# On the whole way: photographs of a flawed sensor, its frames, and the clean scene as the truth.


def light(shot: int) -> NDArray[np.float64]:
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    return np.asarray((0.45 + 0.2 * np.sin(x / 20 + shot) + 0.1 * np.cos(y / 15 - shot)) * (0.6 + 0.1 * shot))


@pytest.fixture
def flawed(tmp_path: Path) -> Callable[..., Path]:
    """`flawed()`: a project folder of five shots of a sensor with glow, falloff and bad pixels, with frames."""
    rng = np.random.default_rng(4)
    pattern = rng.uniform(0, 200, SIZE)  # of a 0.01 s shot
    y, x = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    falloff = 1 - 0.4 * ((x / SIZE[1] - 0.5) ** 2 + (y / SIZE[0] - 0.5) ** 2)
    bad = np.array([[20, 30], [51, 77], [80, 3]])

    def shoot(file: Path, share: NDArray[np.float64], seconds: float, stuck: bool = True) -> None:
        values = BLACK + pattern * glow * seconds / 0.01 + share * falloff * 12000 + rng.normal(0, 2, SIZE)
        if stuck:
            values[bad[:, 0], bad[:, 1]] = 9000
        exif = PhotoExif(exposure_time_s=Fraction(seconds).limit_denominator(1000), iso=400)
        write_shot(file, np.clip(np.rint(values), 0, WHITE).astype(np.uint16), exif=exif)

    glow = 1.0

    def make(with_frames: bool = True) -> Path:
        nonlocal glow
        glow = 1.0 if with_frames else 0.05
        for n in range(5):
            shoot(tmp_path / "images" / f"{n}.dng", light(n), 0.01)
        none, even = np.zeros(SIZE), np.full(SIZE, 0.7)
        for n in range(4 if with_frames else 0):
            shoot(tmp_path / "calibration" / "bias" / f"{n}.dng", none, 0.0001, stuck=False)
            shoot(tmp_path / "calibration" / "darks" / f"{n}.dng", none, 0.02)
            shoot(tmp_path / "calibration" / "flats" / f"{n}.dng", even, 0.001)
        return tmp_path

    return make


def recipes(project: Path, strict: bool = False, **develop: Any) -> Recipes:
    options = DevelopOptions(**develop)
    found = discover(project / "images").captures
    with ThreadPoolExecutor(2) as executor:
        surveyed, _ = survey(found, executor, SILENT, strict=True)
        folders = project / "calibration", project / "records"
        return with_recipes(surveyed, options, *folders, executor, SILENT, strict=strict)


def error_of(found: Recipes) -> float:
    """The error of a developed photograph that all but a few pixels stay below, as a share of the scene's
    brightness; the few lie around bad pixels, which can but be guessed."""
    rgb = read_photograph(found.surveyed[4].capture).rgb[4:-4, 4:-4] / 65535 * (WHITE - BLACK) / 12000
    truth = light(4)[4:-4, 4:-4, None]
    level = np.median(rgb / truth)
    return float(np.percentile(np.abs(rgb / truth / level - 1), 99.5))


def test_frames_undo_what_the_sensor_does(flawed: Callable[..., Path]) -> None:
    project = flawed()
    found = recipes(project)
    (steps,) = found.steps.values()
    assert steps[:3] == ["bias frame, and dark frame scaled to the exposure", "flat field", "3 bad pixels"]
    assert steps[3:] == ["green equilibrium", "demosaicing (linear)"]
    assert not found.warnings
    assert error_of(found) < 0.005
    assert set(recipe_notes(found.surveyed)) == {f"{n}.dng" for n in range(5)}
    for file in (project / "calibration").rglob("*.dng"):
        file.unlink()
    assert error_of(recipes(project)) > 0.05


def test_folders_of_frames_may_have_other_names(flawed: Callable[..., Path]) -> None:
    project = flawed()
    frames = project / "calibration"
    usual = recipes(project).surveyed[0].capture.recipe
    for folder, other in (("bias", "Offset frames"), ("darks", "dark"), ("flats", "Flat-field")):
        (frames / folder).rename(frames / other)
    assert recipes(project).surveyed[0].capture.recipe == usual
    (frames / "flats").mkdir()
    (frames / "loose.dng").touch()
    (frames / "Grey card").mkdir()
    [warning] = recipes(project).warnings
    assert warning.startswith("not used: calibration/Grey card/, calibration/flats/ (no RAW file in it),")


def test_what_a_system_keeps_beside_frames_is_none(flawed: Callable[..., Path]) -> None:
    project = flawed()
    for name in ("darks/._0.dng", "@eaDir/darks/0.dng", "darks/@eaDir/0.dng"):
        (project / "calibration" / name).parent.mkdir(parents=True, exist_ok=True)
        (project / "calibration" / name).write_bytes(b"\0\5\x16\7")
    assert not recipes(project, strict=True).warnings


def test_frames_are_averaged_once(flawed: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    project = flawed()
    first = recipes(project)

    def fail(*_: object) -> None:
        raise AssertionError("a frame was read again")

    monkeypatch.setattr("colmap_ihe.photographs.raw.calibration_masters.read_mosaic", fail)
    assert [s.capture.recipe for s in recipes(project).surveyed] == [s.capture.recipe for s in first.surveyed]


def test_bad_pixels_are_found_over_the_set(flawed: Callable[..., Path]) -> None:
    project = flawed(with_frames=False)
    found = recipes(project, find_bad_pixels=True)
    bad = np.load(found.surveyed[0].capture.recipe.bad_pixels)
    assert {(20, 30), (51, 77), (80, 3)} <= {tuple(p) for p in bad.tolist()}
    assert len(bad) < 20
    (project / "images" / "0.dng").unlink()
    (project / "images" / "1.dng").unlink()
    assert any("too few" in w for w in recipes(project, find_bad_pixels=True).warnings)


def test_a_list_alone_is_enough(flawed: Callable[..., Path]) -> None:
    project = flawed(with_frames=False)
    (project / "calibration").mkdir()
    (project / "calibration" / "bad-pixels.txt").write_text("30 20\n77 51\n3 80\n")
    assert "3 bad pixels" in next(iter(recipes(project).steps.values()))


@pytest.mark.parametrize("breaks_in", ["header", "pixels"])
def test_only_a_broken_frame_is_left_out_and_named(flawed: Callable[..., Path], breaks_in: str) -> None:
    project = flawed()
    frame = project / "calibration" / "darks" / "0.dng"
    whole = frame.read_bytes()
    frame.write_bytes(b"II*\0" + bytes(100) if breaks_in == "header" else whole[: len(whole) // 2])
    found = recipes(project)
    assert any("0.dng" in w and "left out" in w for w in found.warnings)
    assert next(iter(found.steps.values()))[0] == "bias frame, and dark frame scaled to the exposure"
    assert found.surveyed[0].capture.recipe.dark
    with pytest.raises(PhotographError, match=r"0\.dng"):
        recipes(project, strict=True)
