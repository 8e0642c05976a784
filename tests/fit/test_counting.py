"""Chunks of photographs: counted by any executor, in any grouping, and whatever one of them does to its decoder."""

from __future__ import annotations

import multiprocessing
import pickle
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from running import StopsWhen

from colmap_ihe.errors import Cancelled, PhotographError, ProjectError
from colmap_ihe.fit import counting as gathering
from colmap_ihe.fit.counting import ChunkCounts, CountOptions, SetCounts, chunks, count, gather
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.histogram import Histogram, Weighting
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.machine.decoder_process import Decoder
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.photographs.colour_counts import ColourCounter, count_photograph, hand_over_counts
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import Capture


def photograph(folder: Path, number: int, does: str = "") -> Capture:
    """A JPEG of noise and detail whose comment is `does`; of a size of its own."""
    rng = np.random.default_rng(number)
    pixels = rng.integers(0, 256, (96 + number, 128, 1)) // 2 + rng.integers(0, 99, (96 + number, 128, 3))
    file = folder / f"{number}{does}.jpg"
    Image.fromarray(pixels.astype(np.uint8)).save(file, comment=f"do: {does}".encode())
    return Capture(file.name, file, "coded", file.stem)


def counting(
    method: str = "ihe", weighting: Weighting = "pixel", sample: float = 1.0, strict: bool = False
) -> CountOptions:
    return CountOptions(method, weighting, sample, contrast=True, strict=strict)


def expected(captures: Sequence[Capture], how: CountOptions) -> tuple[Histogram, Contrast]:
    """From pixels, in this process."""
    tally, contrast = ColourCounter("coded", how.weighting, how.sample), Contrast("coded")
    for capture in captures:
        contrast += tally.add(read_photograph(capture).rgb, True) or Contrast("linear")
    histogram = Histogram("coded", how.weighting)
    histogram.add_sums(tally.handed_over())
    return histogram, contrast


def counted(captures: Sequence[Capture], how: CountOptions) -> ChunkCounts:
    return count(how, frozenset(c.name for c in captures), captures)


def pooled(*found: ChunkCounts, weighting: Weighting = "pixel") -> tuple[Histogram, Contrast]:
    total = SetCounts(Histogram("coded", weighting))
    for one in found:
        total.add(one)
    return total.histogram, reduce(add, (c for one in found for c in one.contrasts.values()))


def same(found: tuple[Histogram, Contrast], wanted: tuple[Histogram, Contrast]) -> bool:
    return found[0].sums() == wanted[0].sums() and found[1].as_dict() == wanted[1].as_dict()


@given(
    kinds=st.lists(st.sampled_from(["raw", "coded"]), min_size=1, max_size=60),
    pixels=st.integers(0, 60_000_000),
    workers=st.integers(1, 16),
)
def test_chunks_hold_every_capture_once_and_leave_no_worker_idle(
    kinds: list[Literal["raw", "coded"]], pixels: int, workers: int
) -> None:
    captures = [Capture(str(n), Path(str(n)), kind, str(n), pixels=pixels) for n, kind in enumerate(kinds)]
    found = list(chunks(captures, workers))
    assert sorted(c.name for chunk in found for c in chunk) == sorted(c.name for c in captures)
    assert all(len({c.kind for c in chunk}) == 1 for chunk in found)
    for kind in set(kinds):
        of_kind = [chunk for chunk in found if chunk[0].kind == kind]
        assert len(of_kind) >= min(workers, kinds.count(kind)) / 2
        assert [c for chunk in of_kind for c in chunk] == [c for c in captures if c.kind == kind]


def test_large_photographs_do_not_wait_for_one_another() -> None:
    captures = [Capture(str(n), Path(str(n)), "raw", str(n), pixels=24_000_000) for n in range(100)]
    assert {len(chunk) for chunk in chunks(captures, 2)} == {1}


@pytest.fixture(params=["threads", "processes"])
def executor(request: pytest.FixtureRequest) -> Iterator[Executor]:
    if request.param == "threads":
        with ThreadPoolExecutor(3) as threads:
            yield threads
    else:
        with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as processes:
            yield processes


def test_any_executor_comes_to_the_same_sums(
    executor: Executor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    captures = [photograph(tmp_path, n) for n in range(5)]
    (tmp_path / "9.jpg").write_bytes(b"no photograph")
    broken = Capture("9.jpg", tmp_path / "9.jpg", "coded", "9")
    how = counting()
    monkeypatch.setattr(gathering, "width_of", lambda _: 3)
    left_out: dict[str, str] = {}
    found = gather([*captures, broken], how, executor, SILENT, left_out)
    assert same((found["coded"].histogram, found["coded"].contrast), expected(captures, how))
    assert list(left_out) == ["9.jpg"]
    assert "copy it from the card again" in left_out["9.jpg"]


@pytest.mark.parametrize("weighting", ["pixel", "image"])
@pytest.mark.parametrize("sample", [1.0, 0.5])
def test_grouping_changes_nothing(tmp_path: Path, weighting: Weighting, sample: float) -> None:
    captures = [photograph(tmp_path, n) for n in range(4)]
    how = counting(weighting=weighting, sample=sample)
    want = expected(captures, how)
    for groups in ([captures], [captures[2:], captures[:2]], [[c] for c in reversed(captures)]):
        found = [pickle.loads(pickle.dumps(counted(group, how))) for group in groups]
        assert same(pooled(*found, weighting=weighting), want)


@pytest.mark.parametrize(("does", "at"), [("crash", 0), ("exit", 1), ("late", 2)])
@pytest.mark.usefixtures("faulty")
def test_a_photograph_that_kills_its_decoder_costs_itself_only(tmp_path: Path, does: str, at: int) -> None:
    captures = [photograph(tmp_path, n, does if n == at else "") for n in range(3)]
    sound = [c for n, c in enumerate(captures) if n != at]
    how = counting("realtime-set")
    found = counted(captures, how)
    assert list(found.errors) == [captures[at].name]
    assert "crashed on it" in str(found.errors[captures[at].name])
    assert same(pooled(found), expected(sound, how))
    alone = [counted([c], how).formula for c in sound]
    assert found.formula is not None
    assert found.formula.finish() == reduce(add, alone).finish()  # type: ignore[union-attr]


@pytest.mark.usefixtures("faulty")
def test_several_killers_in_one_chunk(tmp_path: Path) -> None:
    captures = [photograph(tmp_path, n, "crash" if n % 2 else "") for n in range(4)]
    found = counted(captures, counting())
    assert set(found.errors) == {c.name for c in captures[1::2]}
    assert same(pooled(found), expected(captures[::2], counting()))


@pytest.mark.usefixtures("faulty")
def test_strict_stops_at_the_first_that_cannot_be_used(tmp_path: Path) -> None:
    captures = [photograph(tmp_path, n, "crash" if n == 1 else "") for n in range(3)]
    with ThreadPoolExecutor(2) as threads:
        with pytest.raises(PhotographError, match=r"1crash\.jpg: the decoder crashed"):
            gather(captures, counting(strict=True), threads, SILENT, {})
        with pytest.raises(ProjectError, match="the only photograph cannot be used: 1crash"):
            gather([captures[1]], counting(), threads, SILENT, {})


@pytest.mark.usefixtures("faulty")
def test_a_chunk_ends_soon_after_it_is_cancelled(tmp_path: Path) -> None:
    captures = [photograph(tmp_path, n, "hang" if n else "") for n in range(2)]
    began = time.monotonic()
    progress = StopsWhen(lambda _: time.monotonic() > began + 1)
    with ThreadPoolExecutor(1) as threads, pytest.raises(Cancelled):
        gather(captures, counting(), threads, progress, {})
    assert time.monotonic() - began < 8


@pytest.mark.parametrize("weighting", ["pixel", "image"])
def test_a_decoder_counts_one_chunk_after_another(tmp_path: Path, weighting: Weighting) -> None:
    """Whatever came before: a chunk handed over, one given up, one sampled, a photograph read."""
    captures = [photograph(tmp_path, number) for number in range(3)]
    how, sampled = counting(weighting=weighting), counting(weighting=weighting, sample=0.5)
    decoders.end_idle()

    def as_expected(some: Sequence[Capture], how: CountOptions) -> bool:
        return same(pooled(counted(some, how), weighting=weighting), expected(some, how))

    for some in (captures, captures[:1], captures[1:]):
        assert as_expected(some, how)
    with decoders.one_decoder() as decoder:
        asked = (True, False, False, ("coded", weighting, 1.0))
        decoder.run(count_photograph, captures[0], *asked, pixels=0)
    assert as_expected(captures[1:], how)
    assert as_expected(captures[1:], sampled)
    assert read_photograph(captures[0]).rgb.size
    assert as_expected(captures[:2], how)


@pytest.mark.parametrize(
    "lie", [{"images": 2}, {"pixels": 5, "mass": 5}, {"mass": -1}, {"encoding": "linear"}, {"more": 1}]
)
def test_what_a_decoder_says_is_checked(tmp_path: Path, lie: dict[str, Any]) -> None:
    capture = photograph(tmp_path, 1)
    real = Decoder.run

    def lies(self: Decoder, function: Any, *more: Any, **named: Any) -> tuple[Any, Any]:
        answer, array = real(self, function, *more, **named)
        return (answer | lie if function is hand_over_counts else answer), array

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Decoder, "run", lies)
        found = counted([capture], counting())
    assert not found.sums
    assert "the decoder lost its way on it" in str(found.errors[capture.name])
