"""Gather what the fit needs of a set in chunks: some photographs in, their sums out, in any process.

A chunk is counted by one decoder, where its photographs are decoded, so that only sums leave it; what sums to add
and in what order makes no difference. If a photograph kills the decoder, what it had counted is lost with it, and is
counted again, one photograph at a time.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial, reduce
from itertools import groupby
from operator import add
from pathlib import Path

from colmap_ihe.errors import PhotographError
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.conversions import CONVERSIONS, SetFit
from colmap_ihe.grey.convert import coded_share
from colmap_ihe.grey.histogram import Histogram, Sums, Weighting
from colmap_ihe.grey.weights import Encoding
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.machine.decoder_process import nonsense
from colmap_ihe.machine.executor import in_order, width_of
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.colour_counts import count_photograph, hand_over_counts, sampled
from colmap_ihe.photographs.decode import encoding_of
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import LeftOut, at_once, leave_out, none_usable

_CONTRAST_OF = 64
"""Photographs in which contrast is measured, which costs more than counting colours: a thousand tiles are enough."""

_MOST, _LEAST = 64e6, 32e6  # pixels of a chunk
_UNKNOWN = 1.3e6  # pixels of a photograph whose header was not read
_RAW = 8  # times as long takes a pixel
_SAMPLED_BYTES = 4096  # of a file, twice, for its key


@dataclass(frozen=True)
class CountOptions:
    """Describe how photographs are counted: `method` of the fit, whose own sums are gathered too; whether `contrast`
    is measured. `strict`: a chunk ends at the first photograph that cannot be used."""

    method: str
    weighting: Weighting
    sample: float
    contrast: bool
    strict: bool = False


@dataclass(frozen=True)
class ChunkCounts:
    """Hold what came of a chunk: of those photographs that can be used the sums, one or more to be added, and the
    contrast where it was measured; of the others the errors, both by name."""

    sums: tuple[Sums, ...] = ()
    contrasts: Mapping[str, Contrast] = field(default_factory=dict)
    formula: SetFit | None = None
    errors: Mapping[str, PhotographError] = field(default_factory=dict)


@dataclass
class SetCounts:
    """Hold what the fit has to know of the photographs of one encoding. Adding two is pooling their photographs.

    `keys` tell photographs apart, of those that were counted. `measured` are key and contrast of the
    photographs with the least keys, `_CONTRAST_OF` of them at the most; nothing of those that could not be used. Of
    two sets the least keys are among the least of either, so what is kept of each is enough for both.
    """

    histogram: Histogram
    keys: list[str] = field(default_factory=list)
    measured: list[tuple[str, Contrast]] = field(default_factory=list)
    formula: SetFit | None = None

    @property
    def encoding(self) -> Encoding:
        return self.histogram.encoding

    @property
    def contrast(self) -> Contrast:
        return reduce(add, (contrast for _, contrast in self.measured), Contrast(self.encoding))

    def add(self, counted: ChunkCounts) -> None:
        """Count in what came of a chunk. Raises ValueError for sums of another kind."""
        for sums in counted.sums:
            self.histogram.add_sums(sums)
        self.formula = _sum_of(self.formula, counted.formula)

    def pool(self, other: SetCounts) -> None:
        """Add the photographs of another set. Raises ValueError for sums of another kind."""
        self.histogram.add_sums(other.histogram.sums())
        self.keys = sorted(self.keys + other.keys)
        self.measured = _least(self.measured + other.measured)
        self.formula = _sum_of(self.formula, other.formula)


def _sum_of(first: SetFit | None, second: SetFit | None) -> SetFit | None:
    if first is None or second is None:
        return first or second
    return first + second  # type: ignore[no-any-return]


def _least(measured: Iterable[tuple[str, Contrast]]) -> list[tuple[str, Contrast]]:
    return sorted(measured, key=lambda pair: (pair[0], str(pair[1].as_dict())))[:_CONTRAST_OF]


def key_of(path: Path) -> str:
    """Return a key that tells a photograph from others, wherever it lies: a digest of its size and some bytes."""
    digest = hashlib.blake2b(digest_size=8)
    try:
        with path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            digest.update(str(size).encode())
            for offset in (size // 2, size - _SAMPLED_BYTES):
                file.seek(max(0, offset))
                digest.update(file.read(_SAMPLED_BYTES))
    except OSError:  # it will be left out
        digest.update(os.fsencode(path))
    return digest.hexdigest()


class _Lost(Exception):
    """Say that the decoder is gone, and what it counted."""


def chunks(captures: Sequence[Capture], workers: int) -> Iterator[tuple[Capture, ...]]:
    """Yield captures of one encoding each, in their order; large enough that handing sums over is little beside
    counting, small enough that all of `workers` have some to the end."""
    for _, members in groupby(sorted(captures, key=encoding_of), encoding_of):
        left = list(members)
        most = -(-len(left) // workers)
        rest = sum(map(_pixels, left))
        while left:
            enough = min(_MOST, max(_LEAST, rest / (2 * workers)))
            chunk: list[Capture] = []
            while left and len(chunk) < most and (not chunk or sum(map(_pixels, chunk)) < enough):
                chunk.append(left.pop(0))
            rest -= sum(map(_pixels, chunk))
            yield tuple(chunk)


def _pixels(capture: Capture) -> float:
    return (capture.pixels or _UNKNOWN) * (_RAW if capture.kind == "raw" else 1)


def gather(
    captures: Sequence[Capture],
    counting: CountOptions,
    executor: Executor,
    progress: Progress,
    left_out: LeftOut,
) -> dict[Encoding, SetCounts]:
    """Return the sums of all captures that can be used, by encoding; the others go to `left_out`. Contrast is measured,
    if at all, in the photographs with the least keys. Raises `PhotographError` if strict, `ProjectError` if none can be
    used."""
    progress.start(len(captures))
    keys = {capture.name: key_of(capture.path) for capture in captures}
    chosen: set[str] = set()
    for encoding in {encoding_of(c) for c in captures} if counting.contrast else ():
        names = sorted((keys[c.name], c.name) for c in captures if encoding_of(c) == encoding)
        chosen |= {name for _, name in names[:_CONTRAST_OF]}
    gathered: dict[Encoding, SetCounts] = {}
    contrasts: dict[str, Contrast] = {}
    parts = list(chunks(captures, width_of(executor)))
    work, by_name = partial(count, counting, frozenset(chosen)), {c.name: c for c in captures}
    results = in_order(executor, work, parts, at_once(captures, executor), progress)
    for chunk, counts in zip(parts, results, strict=True):
        progress.advance(len(chunk))
        for name, error in counts.errors.items():
            leave_out(by_name[name], error, counting.strict, left_out)
        if counts.sums:
            encoding = counts.sums[0].encoding
            if encoding not in gathered:
                gathered[encoding] = SetCounts(Histogram(encoding, counting.weighting))
            gathered[encoding].add(counts)
            contrasts |= counts.contrasts
    if not gathered:
        raise none_usable(left_out)
    for encoding, counts_of_kind in gathered.items():
        members = [c.name for c in captures if encoding_of(c) == encoding]
        counts_of_kind.keys = sorted(keys[name] for name in members if name not in left_out)
        nothing = Contrast(encoding)
        counts_of_kind.measured = _least((keys[n], contrasts.get(n, nothing)) for n in members if n in chosen)
    return gathered


def count(counting: CountOptions, contrast_in: frozenset[str], chunk: Sequence[Capture]) -> ChunkCounts:
    """Count the photographs of a chunk, all of one encoding, and measure contrast in those named. Plain values in and
    out, which can be pickled. Raises `Cancelled` within `stoppable`, `CapabilityError` if no decoder can be started."""
    errors: dict[str, PhotographError] = {}
    try:
        return _together(counting, contrast_in, chunk, errors)
    except _Lost:
        total = ChunkCounts(errors=errors)
    for capture in chunk:
        if capture.name in errors:
            if counting.strict:
                break
            continue
        with suppress(_Lost):
            alone = _together(counting, contrast_in, [capture], errors)
            contrasts = {**total.contrasts, **alone.contrasts}
            formula = _sum_of(total.formula, alone.formula)
            total = ChunkCounts((*total.sums, *alone.sums), contrasts, formula, errors)
    return total


def _together(
    counting: CountOptions,
    contrast_in: frozenset[str],
    chunk: Sequence[Capture],
    errors: dict[str, PhotographError],
) -> ChunkCounts:
    """Count the photographs of a chunk in one decoder. Raises `_Lost` where a photograph, whose error is then in
    `errors`, took its decoder along."""
    encoding = encoding_of(chunk[0])
    how = (encoding, counting.weighting, counting.sample)
    new_formula = CONVERSIONS[counting.method].new_fit
    formula = new_formula() if new_formula else None
    contrasts: dict[str, Contrast] = {}
    used = 0
    with decoders.one_decoder() as decoder:
        for capture in chunk:
            contrast = capture.name in contrast_in
            asked = (not used, contrast, formula is not None, how)
            try:
                measured, rgb = decoder.run(count_photograph, capture, *asked, pixels=capture.pixels)
                if measured is not None:
                    contrasts[capture.name] = Contrast.from_dict(measured, encoding)
            except (PhotographError, ValueError, KeyError, TypeError) as error:
                errors[capture.name] = _as_of(capture, error)
                if decoder.dead or not isinstance(error, PhotographError):
                    raise _Lost from error
                if counting.strict:
                    break
                continue
            used += 1
            if formula is not None and rgb is not None:
                formula.add(coded_share(sampled(rgb, counting.sample)))
        if not used:
            return ChunkCounts(errors=errors)
        try:
            head, cells = decoder.run(hand_over_counts, chunk[0])
            sums = Sums(**head, cells=cells.tobytes()).checked()
            if (sums.encoding, sums.weighting, sums.images) != (encoding, counting.weighting, used):
                raise ValueError("sums of something else")
        except (PhotographError, ValueError, KeyError, TypeError) as error:
            if len(chunk) == 1:
                errors[chunk[0].name] = _as_of(chunk[0], error)
            raise _Lost from error
    return ChunkCounts((sums,), contrasts, formula, errors)


def _as_of(capture: Capture, error: Exception) -> PhotographError:
    return error if isinstance(error, PhotographError) else nonsense(capture.name, error)
