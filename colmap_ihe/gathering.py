"""What the fit has to know of a set, gathered in chunks: some photographs in, their sums out, in any process.

A chunk is counted by one decoder, where its photographs are decoded, so that only sums leave it; what sums to add
and in what order makes no difference. If a photograph kills the decoder, what it had counted is lost with it, and is
counted again, one photograph at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby

from colmap_ihe.captures import decoders
from colmap_ihe.captures.decode import encoding_of, message_of
from colmap_ihe.captures.discover import Capture
from colmap_ihe.captures.tally import sampled
from colmap_ihe.errors import PhotographError
from colmap_ihe.executor import in_order, local_workers
from colmap_ihe.grey.contrast import Contrast
from colmap_ihe.grey.conversions import CONVERSIONS, SetFit
from colmap_ihe.grey.convert import coded_share
from colmap_ihe.grey.histogram import Histogram
from colmap_ihe.grey.sums import Sums, Weighting
from colmap_ihe.grey.weights import Encoding
from colmap_ihe.per_image import LeftOut, at_once, leave_out, none_usable
from colmap_ihe.progress import Watch

_MOST, _LEAST = 64e6, 32e6  # pixels of a chunk
_UNKNOWN = 1.3e6  # pixels of a photograph whose header was not read
_RAW = 8  # times as long takes a pixel


@dataclass(frozen=True)
class Counting:
    """How photographs are counted: `method` of the fit, whose own sums are gathered too; in `contrast_in` contrast is
    measured, by name. `strict`: a chunk ends at the first photograph that cannot be used."""

    method: str
    weighting: Weighting
    sample: float
    contrast_in: frozenset[str]
    strict: bool = False


@dataclass(frozen=True)
class Counted:
    """What came of a chunk: of those photographs that can be used the sums, one or more to be added; of the others the
    errors, by name."""

    sums: tuple[tuple[Sums, Contrast], ...] = ()
    formula: SetFit | None = None
    errors: Mapping[str, PhotographError] = field(default_factory=dict)


@dataclass
class Gathered:
    """What the fit has to know of the photographs of one encoding; what is counted is added to it."""

    histogram: Histogram
    contrast: Contrast
    formula: SetFit | None = None

    def add(self, counted: Counted) -> None:
        """Raises ValueError for sums of another kind."""
        for sums, contrast in counted.sums:
            self.histogram.add_sums(sums)
            self.contrast = self.contrast + contrast
        if counted.formula is not None:
            self.formula = counted.formula if self.formula is None else self.formula + counted.formula


class _Lost(Exception):
    """The decoder is gone, and what it counted."""


def chunks(captures: Sequence[Capture], workers: int) -> Iterator[tuple[Capture, ...]]:
    """Captures of one encoding each, in their order; large enough that handing sums over is little beside counting,
    small enough that all of `workers` have some to the end."""
    for _, members in groupby(sorted(captures, key=encoding_of), encoding_of):
        left = list(members)
        most = -(-len(left) // workers)
        rest = sum(map(_pixels, left))
        while left:
            wanted = min(_MOST, max(_LEAST, rest / (2 * workers)))
            chunk: list[Capture] = []
            while left and len(chunk) < most and (not chunk or sum(map(_pixels, chunk)) < wanted):
                chunk.append(left.pop(0))
            rest -= sum(map(_pixels, chunk))
            yield tuple(chunk)


def _pixels(capture: Capture) -> float:
    return (capture.pixels or _UNKNOWN) * (_RAW if capture.kind == "raw" else 1)


def gather(
    captures: Sequence[Capture],
    counting: Counting,
    executor: Executor,
    watch: Watch,
    left_out: LeftOut,
) -> dict[Encoding, Gathered]:
    """The sums of all captures that can be used, by encoding; the others go to `left_out`.

    Raises `PhotographError` if strict, `ProjectError` if none can be used.
    """
    watch.start(len(captures))
    gathered: dict[Encoding, Gathered] = {}
    parts = list(chunks(captures, local_workers()))
    counted = in_order(executor, partial(count, counting), parts, at_once(captures), watch)
    for chunk, found in zip(parts, counted, strict=True):
        watch.advance(len(chunk))
        for name, error in found.errors.items():
            leave_out(name, error, counting.strict, left_out)
        if found.sums:
            encoding = found.sums[0][0].encoding
            if encoding not in gathered:
                gathered[encoding] = Gathered(Histogram(encoding, counting.weighting), Contrast(encoding))
            gathered[encoding].add(found)
    if not gathered:
        raise none_usable(captures, left_out)
    return gathered


def count(counting: Counting, chunk: Sequence[Capture]) -> Counted:
    """Counts the photographs of a chunk, all of one encoding. Plain values in and out, which can be pickled.

    Raises `Cancelled` within `stoppable`, `CapabilityError` if no decoder can be started.
    """
    errors: dict[str, PhotographError] = {}
    try:
        return _together(counting, chunk, errors)
    except _Lost:
        found = Counted(errors=errors)
    for capture in chunk:
        if capture.name in errors:
            if counting.strict:
                break
            continue
        try:
            one = _together(counting, [capture], errors)
        except _Lost:
            continue
        formula = one.formula if found.formula is None else found.formula + one.formula
        found = Counted((*found.sums, *one.sums), formula, errors)
    return found


def _together(counting: Counting, chunk: Sequence[Capture], errors: dict[str, PhotographError]) -> Counted:
    """Raises `_Lost` where a photograph, whose error is then in `errors`, took its decoder along."""
    encoding = encoding_of(chunk[0])
    how = {"encoding": encoding, "weighting": counting.weighting, "sample": counting.sample}
    new_formula = CONVERSIONS[counting.method].new_fit
    formula = new_formula() if new_formula else None
    used = 0
    with decoders.kept() as decoder:
        for capture in chunk:
            try:
                _, rgb = decoder.ask(
                    "count",
                    capture.name,
                    capture.pixels,
                    capture=message_of(capture),
                    first=not used,
                    contrast=capture.name in counting.contrast_in,
                    returned=formula is not None,
                    **how,
                )
            except PhotographError as error:
                errors[capture.name] = error
                if decoder.is_lost:
                    raise _Lost from error
                if counting.strict:
                    break
                continue
            used += 1
            if formula is not None and rgb is not None:
                formula.add(coded_share(sampled(rgb, counting.sample)))
        if not used:
            return Counted(errors=errors)
        try:
            head, cells = decoder.ask("tally", chunk[0].name)
            sums = Sums(**head["sums"], cells=b"" if cells is None else cells.tobytes()).checked()
            if (sums.encoding, sums.weighting, sums.images) != (encoding, counting.weighting, used):
                raise ValueError("sums of something else")
            contrast = Contrast.from_dict(head["contrast"], encoding)
        except (PhotographError, ValueError, KeyError, TypeError) as error:
            if len(chunk) == 1:
                errors[chunk[0].name] = _as_of(chunk[0], error)
            raise _Lost from error
    return Counted(((sums, contrast),), formula, errors)


def _as_of(capture: Capture, error: Exception) -> PhotographError:
    if isinstance(error, PhotographError):
        return error
    return PhotographError(f"{capture.name}: the decoder lost its way on it ({error})", hint=decoders.BROKEN)
