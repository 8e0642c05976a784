"""One fit over campaigns: what is stored pools to the very weights of one fit over all photographs."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from told import Told

from colmap_ihe.cli import main
from colmap_ihe.errors import KnownError, OptionError, WeightsError
from colmap_ihe.fit import counting as gathering
from colmap_ihe.fit.counting import SetCounts, key_of
from colmap_ihe.fit.fit_set import fit_captures
from colmap_ihe.fit.histogram_file import StoredCounts, digest_of, read_stored, stored_of, write_stored
from colmap_ihe.fit.weights_file import misfit, read_weights, warnings_of
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.histogram import Histogram, Weighting
from colmap_ihe.grey.ihe import fit_cells
from colmap_ihe.grey.weights import Encoding, Weights, triplets
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.pipeline.fit_files import fit_files
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.options import FitOptions, Options
from colmap_ihe.project.options_file import load_options

COUNT = 5


@cache
def scene(number: int, linear: bool = False) -> np.ndarray:
    """Detail that channels share unequally, and noise; each another."""
    rng = np.random.default_rng(number)
    detail = rng.normal(0, 14, (70 + number, 90, 1)) * (np.arange(90) > 40)[:, None]
    rgb = 110 + np.linspace(-30, 30, 90)[:, None] + detail * (1.0, 0.8, 0.6)
    rgb = rgb + rng.normal(0, 2 + number, (1, 1, 3))
    rgb += rng.normal(0, 1, rgb.shape) * (1.5, 1.5, 25)
    values = np.clip(np.rint(rgb), 0, 255).astype(np.uint8)
    return values.astype(np.uint16) * 150 if linear else values


def counted(numbers: Sequence[int], linear: bool, weighting: Weighting = "pixel") -> StoredCounts:
    """As `gather` would count them."""
    encoding: Encoding = "linear" if linear else "coded"
    one = SetCounts(Histogram(encoding, weighting))
    for number in numbers:
        one.histogram.add(scene(number, linear))
        contrast = Contrast(encoding)
        contrast.add(scene(number, linear), weighting=weighting)
        one.keys.append(f"{number * 7919 % 101:03}")
        one.measured.append((one.keys[-1], contrast))
    one.keys.sort()
    one.measured = gathering._least(one.measured)
    return StoredCounts({encoding: one}, 1.0, {})


def fitted(stored: Sequence[StoredCounts], options: FitOptions) -> dict[str, object]:
    with ThreadPoolExecutor(1) as threads:
        found = fit_captures([], options, threads, SILENT, strict=True, stored=stored)
    return found.main.as_dict()


@settings(max_examples=5)
@given(
    order=st.permutations(range(COUNT)),
    cuts=st.sets(st.integers(1, COUNT - 1), max_size=2),
    linear=st.booleans(),
    weighting=st.sampled_from(["pixel", "image"]),
    guard=st.sampled_from(["noise", "none"]),
    most=st.sampled_from([3, 64]),
)
def test_pooled_histograms_give_the_weights_of_one_fit(
    order: list[int], cuts: set[int], linear: bool, weighting: Weighting, guard: str, most: int
) -> None:
    options = FitOptions.model_validate({"guard": guard, "weighting": weighting, "step": 0.25})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gathering, "_CONTRAST_OF", most)
        whole = fitted([counted(range(COUNT), linear, weighting)], options)
        ends = [0, *sorted(cuts), COUNT]
        groups = [order[a:b] for a, b in pairwise(ends)]
        parts = [counted(group, linear, weighting) for group in groups]
        stored = [stored_of(part.to_bytes(), "part") for part in parts]
        assert json.dumps(fitted(stored, options)) == json.dumps(whole)
    assert whole["images"] == COUNT


def folder_of(folder: Path, numbers: Sequence[int]) -> Path:
    folder.mkdir(parents=True)
    for number in numbers:
        Image.fromarray(scene(number)).save(folder / f"{number}.png")
    return folder


def test_files_of_histograms_and_folders_in_any_mixture(tmp_path: Path) -> None:
    first, second = folder_of(tmp_path / "a", range(2)), folder_of(tmp_path / "b", range(2, COUNT))
    whole = folder_of(tmp_path / "all", range(COUNT))
    one = fit_files([whole], output=tmp_path / "one.yaml", histogram=tmp_path / "one.histogram").grey
    parts = [tmp_path / "a.histogram", tmp_path / "b.histogram"]
    for folder, part in zip((first, second), parts, strict=True):
        fit_files([folder], histogram=part)
    shutil.rmtree(first)
    fit_files(parts, output=tmp_path / "two.yaml", histogram=tmp_path / "two.histogram")
    assert (tmp_path / "two.yaml").read_bytes() == (tmp_path / "one.yaml").read_bytes()
    alone, pooled = (read_stored(tmp_path / f"{n}.histogram").gathered["coded"] for n in ("one", "two"))
    assert pooled.keys == alone.keys
    assert fit_files([second, tmp_path / "a.histogram"]).grey == one
    folder_of(tmp_path / "c", range(2))
    assert fit_files([tmp_path / "c", second]).grey == one  # the same names in both would be confused


def test_a_photograph_that_is_in_two_campaigns_is_told_of(tmp_path: Path) -> None:
    first, second = folder_of(tmp_path / "a", [1, 2]), folder_of(tmp_path / "b", [2, 3])
    told = Told()
    fit_files([first, second], progress=told)
    assert [w for w in told.warnings if "1 photographs are in the set more than once" in w]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"method": "realtime-set"}, "realtime-set looks at the photographs"),
        ({"sample": 0.5}, "was counted with sample 1.0 and weighting pixel; expected sample 0.5"),
        ({"weighting": "image"}, "expected sample 1.0 and weighting image"),
    ],
)
def test_what_does_not_pool_is_refused(tmp_path: Path, options: dict[str, object], said: str) -> None:
    write_stored(tmp_path / "a.histogram", counted([1], False))
    with pytest.raises(WeightsError, match=said) as caught:
        fit_files([tmp_path / "a.histogram"], FitOptions.model_validate(options))
    assert "a.histogram" in str(caught.value)
    assert caught.value.hint


def test_without_contrast_there_is_no_guard(tmp_path: Path) -> None:
    folder_of(tmp_path / "a", [1, 2])
    plain = fit_files([tmp_path / "a"], FitOptions(guard="none"), histogram=tmp_path / "a.histogram").grey
    assert fit_files([tmp_path / "a.histogram"], FitOptions(guard="none")).grey == plain
    with pytest.raises(WeightsError, match="holds no contrast"):
        fit_files([tmp_path / "a.histogram"])


def test_a_broken_histogram_is_refused_whatever_is_broken(tmp_path: Path) -> None:
    good = counted([1, 2], False).to_bytes()
    kind, _, rest = good.split(b"\n", 2)
    line, body = rest.split(b"\n", 1)
    head = json.loads(line)

    def with_head(**more: object) -> bytes:
        part = {**head["parts"][0], **more.pop("part", {})}  # type: ignore[dict-item]
        new = b"\n".join([json.dumps({**head, "parts": [part], **more}).encode(), body])
        return b"\n".join([kind, digest_of(new), new])

    contrast = head["parts"][0]["contrast"]
    nonsense = [{**contrast[0], "signal": [float("nan")] * 9}]
    broken = {
        "not a histogram": b"PK\x03\x04",
        "not a histogram of a set": b"",
        "version '2'": good.replace(b"version 1", b"version 2"),
        "damaged": good[:-1],
        "not as it was written": good.replace(b'"sample": 1.0', b'"sample": 0.5'),
        "expected": with_head(part={"bytes": 3}),
        "bytes of cells": with_head(part={"bytes": 1 << 60}),
        "do not fit": with_head(part={"deflated": 1 << 60}),
        "names for": with_head(part={"photographs": ["x"]}),
        "sums of contrast": with_head(part={"contrast": nonsense}),
        "a mass of": with_head(part={"sums": {**head["parts"][0]["sums"], "pixels": 5}}),
        "images, pixels": with_head(part={"sums": {**head["parts"][0]["sums"], "images": -1}}),
        "sample": with_head(sample=7),
        "parts": with_head(parts=[]),
    }
    assert stored_of(with_head(), "same").gathered["coded"].keys
    for said, content in broken.items():
        (tmp_path / "x.histogram").write_bytes(content)
        with pytest.raises(WeightsError, match=said) as caught:
            read_stored(tmp_path / "x.histogram")
        assert "x.histogram" in str(caught.value)
        assert caught.value.hint
    with pytest.raises(WeightsError, match="cannot be read"):
        read_stored(tmp_path / "none.histogram")


@settings(max_examples=60)
@given(st.data())
def test_no_byte_can_be_changed_unnoticed(data: st.DataObject) -> None:
    good = bytearray(SMALL)
    place = data.draw(st.integers(0, len(good) - 1))
    good[place] ^= data.draw(st.integers(1, 255))
    with pytest.raises(WeightsError):
        stored_of(bytes(good), "x")


SMALL = counted([1], False).to_bytes()


def test_keys_are_of_content(tmp_path: Path) -> None:
    for name, content in (("a", b"1" * 9000), ("b", b"1" * 9000), ("c", b"1" * 9001), ("d", b"")):
        (tmp_path / name).write_bytes(content)
    a, b, c, d = (key_of(tmp_path / name) for name in "abcd")
    assert a == b
    assert len({a, c, d, key_of(tmp_path / "none")}) == 4


def test_weights_of_another_campaign_and_whether_they_fit() -> None:
    rng = np.random.default_rng(1)
    detail = rng.normal(0, 14, (240, 320, 1)) * (np.arange(320) > 120)[:, None]
    rgb = 110 + detail * (1.0, 0.8, 0.6) + rng.normal(0, 1, (240, 320, 3)) * (1.5, 1.5, 45)
    pixels = np.clip(np.rint(rgb), 0, 255).astype(np.uint8)
    one = SetCounts(Histogram(), ["1"], [("1", Contrast())])
    one.histogram.add(pixels)
    one.measured[0][1].add(pixels)
    own = fit_cells(one.histogram, one.contrast.admitted(triplets()))
    found = misfit(own, one, FitOptions())
    assert found.contrast == pytest.approx(1)
    assert found.levels == pytest.approx(1)
    assert not warnings_of(own, one, FitOptions())
    (words,) = warnings_of(Weights(0, 0, 1), one, FitOptions())
    assert "detail stands out of noise" in words
    (words,) = warnings_of(own, one, FitOptions(guard="none"))
    assert "of the levels that a fitted one does" in words
    dark = counted(range(3), True).gathered["linear"]
    bright = Weights(0.4, 0.4, 0.2, encoding="linear", white=0.1)
    assert "become white" in warnings_of(bright, dark, FitOptions())[0]
    assert "reach" in warnings_of(Weights(0.4, 0.4, 0.2, encoding="linear", white=1), dark, FitOptions())[0]


def test_a_project_keeps_its_histogram_and_takes_weights(
    new_project: Callable[..., Path], quick_options: Callable[..., Options], tmp_path: Path
) -> None:
    options = quick_options("fit.measure=false")
    first, second = new_project(3, name="a"), new_project(2, name="b", suffixes=(".dng",))
    done = reconstruct(first, options, until="fit")
    same = fit_files([first], FitOptions(step=0.1)).grey
    assert same.as_dict()["weights"] == done.summary["weights"]
    weights = tmp_path / "blue.yaml"
    weights.write_text("weights: [0, 0, 1]\n")
    given = quick_options("fit.measure=false", f"fit.weights={weights}")
    again = reconstruct(first, given, until="fit")
    assert again.summary["weights"] == [0, 0, 1]
    assert any("no longer fit" in w for w in again.summary["warnings"])
    assert reconstruct(first, given, until="fit").stages_run == ()
    moved = weights.rename(first / "blue.yaml")
    beside = quick_options("fit.measure=false", "fit.weights=blue.yaml")
    assert reconstruct(first, beside, until="fit").stages_run == ()
    moved.write_text("weights: [0, 1, 0]\n")
    there = reconstruct(first, beside, until="fit")
    assert there.summary["weights"] == [0, 1, 0]
    with pytest.raises(WeightsError, match="the weights are for coded photographs, and some here are linear"):
        reconstruct(second, quick_options(f"fit.weights={moved}"), until="fit")
    with pytest.raises(KnownError, match=r"none\.yaml: cannot be read"):
        reconstruct(first, quick_options("fit.weights=none.yaml"), until="fit")
    with pytest.raises(OptionError, match="expected weights or a method"):
        load_options(None, ["fit.weights=a.yaml", "fit.method=snr"])
    shutil.copy(first / "images/portico_01.jpg", first / "images/portico_09.jpg")
    told = Told()
    fit_files([first], FitOptions(step=0.1), progress=told)
    assert any("so its photographs are read" in w for w in told.warnings)


def test_the_command_line_fits_over_campaigns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder_of(tmp_path / "a", [1, 2])
    weights, histogram = tmp_path / "w.yaml", tmp_path / "a.histogram"
    assert main(["fit", str(tmp_path / "a"), "-q", "-o", str(weights), "--histogram", str(histogram)]) == 0
    capsys.readouterr()
    assert main(["fit", str(histogram), "-q", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["weights"] == list(getattr(read_weights(weights), "triplet"))  # noqa: B009
    assert main(["fit", str(histogram), "-q", "--weights", str(weights), "--json"]) == 0
    assert main(["fit", str(tmp_path / "a"), "-q", "--histogram", str(tmp_path / "a.txt")]) == 1
    assert "expected a name that ends in .histogram" in capsys.readouterr().err
