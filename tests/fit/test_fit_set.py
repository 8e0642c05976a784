"""The fit over files: guarded or not, tried or not, and the same on any number of workers."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.errors import NativeError
from colmap_ihe.fit import counting as gathering
from colmap_ihe.fit import fit_set as fitting
from colmap_ihe.fit.fit_set import Fit, fit_captures
from colmap_ihe.fit.trial_bench import Trial
from colmap_ihe.fit.trial_result import Candidate, TrialResult
from colmap_ihe.grey.ihe import fit_weights
from colmap_ihe.grey.weights import Formula, Weights
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.discover import discover
from colmap_ihe.project.options import FitOptions
from colmap_ihe.project.recipe import Recipe


def noisy_blue(seed: int) -> NDArray[np.uint8]:
    """Detail that all channels show, in flat and textured parts; blue is mostly noise, so its histogram is flat."""
    rng = np.random.default_rng(seed)
    detail = rng.normal(0, 14, (240, 320, 1)) * (np.arange(320) > 120)[:, None]
    rgb = 110 + np.linspace(-30, 30, 320)[:, None] + detail * (1.0, 0.8, 0.6)
    rgb += rng.normal(0, 1, rgb.shape) * (1.5, 1.5, 45)
    return np.asarray(np.clip(np.rint(rgb), 0, 255), np.uint8)


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    for seed in range(3):
        Image.fromarray(noisy_blue(seed)).save(tmp_path / f"{seed}.png")
    return tmp_path


def fitted(folder: Path, options: FitOptions, workers: int = 2, trial: Trial | None = None) -> Fit:
    with ThreadPoolExecutor(workers) as executor:
        return fit_captures(discover(folder).captures, options, executor, SILENT, strict=True, trial=trial)


def weights(folder: Path, options: FitOptions | None = None, trial: Trial | None = None) -> Weights:
    main = fitted(folder, options or FitOptions(), trial=trial).main
    assert isinstance(main, Weights)
    return main


def test_the_guard_keeps_the_fit_off_the_noisy_channel(photographs: Path) -> None:
    paper, guarded = weights(photographs, FitOptions(guard="none")), weights(photographs)
    assert paper.blue > 0.8
    assert guarded.blue < 0.1
    assert paper.score is not None
    assert guarded.score is not None
    assert paper.score < guarded.score
    assert paper.contrast is None
    assert guarded.contrast is not None
    assert guarded.contrast >= 0.998


@pytest.mark.parametrize("method", ["ihe", "snr", "decolorize-set", "realtime-set"])
def test_workers_and_names_change_nothing(photographs: Path, method: str) -> None:
    one = fitted(photographs, FitOptions(method=method), workers=1)
    many = fitted(photographs, FitOptions(method=method), workers=5)
    assert one == many
    for number, file in enumerate(sorted(photographs.glob("*.png"), reverse=True)):
        file.rename(photographs / f"other{number}.png")
    assert fitted(photographs, FitOptions(method=method)).main == one.main


def test_files_and_arrays_give_the_same_weights(photographs: Path) -> None:
    images = [noisy_blue(seed) for seed in range(3)]
    guards: tuple[Literal["noise", "none"], ...] = ("noise", "none")
    for guard in guards:
        found, in_memory = weights(photographs, FitOptions(guard=guard)), fit_weights(images, guard=guard)
        assert (found.triplet, found.score) == (in_memory.triplet, in_memory.score)


def test_auto_without_a_pair_keeps_the_default_and_says_so(photographs: Path) -> None:
    found = fitted(photographs, FitOptions(method="auto"))
    assert isinstance(found.main, Weights)
    assert (found.main.triplet, found.main.method) == ((0.2126, 0.7152, 0.0722), "auto")
    told = found.tried["coded"].as_dict()
    assert told["chosen"] == "rec709"
    assert "could not be measured" in told["in_words"]
    json.dumps(told)


def test_a_formula_is_tried_as_a_triplet_is(photographs: Path) -> None:
    found = fitted(photographs, FitOptions(method="value"), trial=Trial())
    assert isinstance(found.main, Formula)
    assert found.tried["coded"].chosen == "value"


def test_rec709_needs_no_trial_of_itself(photographs: Path) -> None:
    found = fitted(photographs, FitOptions(method="rec709"), trial=Trial())
    assert not found.tried["coded"].measured.candidates
    assert "COLMAP's default" in found.tried["coded"].as_dict()["in_words"]


def test_contrast_of_a_large_set_is_measured_in_some_photographs(
    photographs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gathering, "_CONTRAST_OF", 2)
    some = weights(photographs, FitOptions(method="snr"))
    (photographs / "1.png").unlink()  # of three in the order of names: the first and the last stay
    monkeypatch.undo()
    assert some.triplet == weights(photographs, FitOptions(method="snr")).triplet
    assert some.images == 3


@pytest.mark.parametrize("method", ["ihe", "auto"])
def test_a_measurement_that_fails_does_not_end_the_run(
    photographs: Path, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    def fails(*_: object, **__: object) -> TrialResult:
        raise NativeError("no features today")

    monkeypatch.setattr(fitting, "measure", fails)
    found = fitted(photographs, FitOptions(method=method), trial=Trial())
    assert isinstance(found.main, Weights)
    assert found.main.blue < 0.1
    assert "no features today" in found.tried["coded"].as_dict()["in_words"]


def result(gain: float, then: float | None) -> TrialResult:
    """Of 10,000 matches each on two pairs and, unless None, on those that confirm, with an error of one per cent."""

    def of(gain: float) -> TrialResult:
        sums = {"rec709": 20_000, "ihe": round(20_000 * (1 + gain)), "green": round(20_000 * (1 + gain))}
        greys = {name: Candidate(0, 0, n, (n // 2, n // 2), n / 20_000 - 1, 0.01) for name, n in sums.items()}
        return TrialResult((("a", "b"), ("b", "c")), tuple(greys.items()))

    return replace(of(gain), held_out=None if then is None else of(then))


@pytest.mark.parametrize(
    ("gain", "then", "taken"),
    [
        (0.05, 0.05, True),
        (0.05, 0.015, False),
        (0.05, -0.05, False),
        (-0.01, 0.05, False),
        (-0.01, None, False),
    ],
)
def test_a_fitted_grey_of_coded_photographs_is_taken_where_it_is_confirmed(
    photographs: Path, monkeypatch: pytest.MonkeyPatch, gain: float, then: float | None, taken: bool
) -> None:
    monkeypatch.setattr(fitting, "measure", lambda *_: result(gain, then))
    fitted_without = weights(photographs)
    found = fitted(photographs, FitOptions(), trial=Trial())
    assert isinstance(found.main, Weights)
    assert found.main.triplet == (fitted_without.triplet if taken else (0.21, 0.72, 0.07))
    assert found.main.method == "ihe" and found.main.score is not None and found.main.images == 3
    told = found.tried["coded"].as_dict()
    assert told["chosen"] == ("ihe" if taken else "rec709")
    assert told.get("fitted") == (None if taken else list(fitted_without.triplet))
    assert told["in_words"].startswith("this set keeps COLMAP's default grey: ") == (not taken)


@pytest.mark.parametrize("options", [FitOptions(guard="none"), FitOptions(method="green")])
def test_what_was_asked_for_is_never_replaced(
    photographs: Path, monkeypatch: pytest.MonkeyPatch, options: FitOptions
) -> None:
    monkeypatch.setattr(fitting, "measure", lambda *_: result(-0.5, -0.5))
    found = fitted(photographs, options, trial=Trial())
    assert found.main == fitted(photographs, options).main
    assert found.tried["coded"].chosen == options.method
    assert "50 % fewer" in found.tried["coded"].as_dict()["in_words"]


def test_three_photographs_are_too_few_to_leave_the_default(photographs: Path) -> None:
    found = fitted(photographs, FitOptions(), trial=Trial())
    assert isinstance(found.main, Weights)
    assert found.main.triplet == (0.21, 0.72, 0.07)
    assert "could not be tried: no two of the 3 photographs" in found.tried["coded"].as_dict()["in_words"]


@pytest.mark.parametrize(
    ("gain", "then", "kept"),
    [(-0.05, -0.05, False), (-0.05, -0.015, True), (0.01, -0.05, True), (-0.05, None, True)],
)
def test_a_fitted_grey_of_raw_is_kept_unless_it_is_clearly_worse(
    small_demo: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    gain: float,
    then: float | None,
    kept: bool,
) -> None:
    shutil.copy(small_demo / "images/portico_01.dng", tmp_path)
    monkeypatch.setattr(fitting, "measure", lambda *_: result(gain, then))
    options = FitOptions(step=0.25, recount=False)
    found = fitted(tmp_path, options, trial=Trial())
    other = fitted(tmp_path, options if kept else FitOptions(method="rec709"))
    assert isinstance(found.main, Weights) and isinstance(other.main, Weights)
    assert (found.main.triplet, found.main.curve) == (other.main.triplet, other.main.curve)
    assert found.main.method == "ihe"
    assert ("fitted" in found.tried["linear"].as_dict()) == (not kept)


def test_the_default_grey_of_raw_weighs_balanced_channels(small_demo: Path, tmp_path: Path) -> None:
    """Else a sensor's red and blue, which it sees at half of green, would count for half."""
    for n in (1, 2):
        shutil.copy(small_demo / f"images/portico_0{n}.dng", tmp_path)
    captures = [replace(c, recipe=Recipe(white_balance=(2.0, 1.0, 1.5))) for c in discover(tmp_path).captures]
    with ThreadPoolExecutor(2) as executor:
        options = FitOptions(method="green", step=0.25)
        found = fit_captures(captures, options, executor, SILENT, strict=True, trial=Trial())
        default = fit_captures(captures, FitOptions(method="rec709"), executor, SILENT, strict=True)
    expected = np.array([2 * 0.2126, 0.7152, 1.5 * 0.0722]) / (2 * 0.2126 + 0.7152 + 1.5 * 0.0722)
    assert isinstance(default.main, Weights)
    assert default.main.triplet == pytest.approx(expected)
    words = found.tried["linear"].as_dict()["in_words"]
    assert "the default grey of developed photographs (Rec.709 after white balance)" in words


@pytest.mark.parametrize("method", ["ihe", pytest.param("auto", marks=pytest.mark.slow)])
def test_raw_weights_hold_a_curve_and_are_tried_with_it(
    small_demo: Path, tmp_path: Path, method: str
) -> None:
    for n in (1, 2, 3):
        shutil.copy(small_demo / f"images/portico_0{n}.dng", tmp_path)
    found = fitted(tmp_path, FitOptions(method=method, step=0.25), trial=Trial("equalise"))
    assert isinstance(found.main, Weights)
    assert len(found.main.curve) == 255
    assert found.tried["linear"].measured.candidates
    assert not fitted(tmp_path, FitOptions(method="value")).main.as_dict().get("curve")
