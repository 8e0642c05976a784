"""Fit the one grey of the whole set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import DiskFullError, KnownError, WeightsError
from colmap_ihe.fit.counting import CountOptions, SetCounts, gather
from colmap_ihe.fit.histogram_file import StoredCounts
from colmap_ihe.fit.trial import Purpose, measure
from colmap_ihe.fit.trial_bench import Trial
from colmap_ihe.fit.trial_result import (
    REFERENCE,
    SAME,
    ChosenGrey,
    TrialResult,
    choose,
    is_clearly_worse,
)
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.grey.equalise import curve_of
from colmap_ihe.grey.histogram import Histogram, Weighting, mass_of
from colmap_ihe.grey.ihe import count_levels, fit_cells, fit_histogram, white_point
from colmap_ihe.grey.weights import (
    FIXED,
    Encoding,
    Formula,
    Grey,
    Triplet,
    Weights,
    are_alike,
    shares,
    triplets,
)
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.colour_counts import sampled
from colmap_ihe.photographs.decode import encoding_of, read_photograph
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.each import LeftOut
from colmap_ihe.project.options import FitOptions

_REC709: Triplet = (21, 72, 7)


@dataclass(frozen=True)
class Fit:
    """Hold the grey of the set, one for each encoding in it; `colour_white` is the white point of a linear
    set's colour twins, as a share of saturation. `tried`: what was measured on pairs of its photographs, if
    anything. `gathered`: what it was fitted to."""

    weights: Mapping[Encoding, Grey]
    colour_white: float = 1.0
    left_out: LeftOut = field(default_factory=dict)
    tried: Mapping[Encoding, ChosenGrey] = field(default_factory=dict)
    gathered: Mapping[Encoding, SetCounts] = field(default_factory=dict, compare=False, repr=False)

    @property
    def main(self) -> Grey:
        """Return the grey of the encoding with most images."""
        return max(self.weights.values(), key=lambda w: w.images)


def fit_captures(
    captures: Sequence[Capture],
    options: FitOptions,
    executor: Executor,
    progress: Progress,
    *,
    strict: bool,
    trial: Trial | None = None,
    stored: Sequence[StoredCounts] = (),
    given: Grey | None = None,
) -> Fit:
    """Fit one grey for the whole set, from every pixel of every capture, one image in memory a worker.

    A set that mixes gamma-coded and linear photographs gets one for each: a sensor's red is not
    sRGB's red, so one triplet for both would mean two different greys. With `trial` the grey is tried against
    Rec.709 on a few pairs, and what guarded IHE fitted is replaced by it: of coded photographs unless it is clearly
    better, of linear ones if it is clearly worse. Method "auto" always tries, and takes the best. What is `stored` of
    other photographs counts as if they were among the captures, of which there need then be none. `given` weights are
    taken instead of fitted ones. Raises `PhotographError` if strict, `ProjectError` if no photograph can be used,
    `WeightsError` if `stored` is of another kind or `given` of another encoding.
    """
    left_out: LeftOut = {}
    for encoding in sorted({encoding_of(c) for c in captures}):
        if given is not None and encoding != given.encoding:
            raise WeightsError(
                f"the weights are for {given.encoding} photographs, and some here are {encoding}",
                hint="RAW is linear, JPEG is gamma-coded: use weights of the same kind, or another folder",
            )
    wants_contrast = options.method in ("snr", "auto") or (options.method, options.guard) == ("ihe", "noise")
    counting = CountOptions(options.method, options.weighting, options.sample, wants_contrast, strict)
    gathered = gather(captures, counting, executor, progress, left_out) if captures or not stored else {}
    unseen = _pooled(gathered, stored, options, wants_contrast)
    weights: dict[Encoding, Grey] = {}
    tried: dict[Encoding, ChosenGrey] = {}
    colour_white = 1.0
    for encoding in sorted(gathered):
        members = [c for c in captures if c.name not in left_out and encoding_of(c) == encoding]
        recount = options.recount and encoding not in unseen
        fit = _SetFit(gathered[encoding], members, options, executor, progress, recount)
        if encoding == "linear":
            colour_white = fit.white_of(FIXED["green"])
        if given is None and options.method == "auto":
            grey, tried[encoding] = fit.tried(trial or Trial())
            weights[encoding] = fit.with_curve(grey)
            continue
        weights[encoding] = fit.with_curve(fit.grey(options.method)) if given is None else given
        if trial is not None:
            decides = given is None and (options.method, options.guard) == ("ihe", "noise")
            weights[encoding], tried[encoding] = fit.against_rec709(weights[encoding], trial, decides)
    return Fit(weights, colour_white, left_out, tried, gathered)


def _pooled(
    gathered: dict[Encoding, SetCounts], stored: Sequence[StoredCounts], options: FitOptions, contrast: bool
) -> set[Encoding]:
    """Add what is stored to what was gathered. Return the encodings of photographs that were not read now."""
    unseen: set[Encoding] = set()
    for counts in stored:
        if CONVERSIONS[options.method].new_fit is not None or options.method == "auto":
            raise WeightsError(
                f"{counts.source}: {options.method} looks at the photographs, and a histogram does not hold them",
                hint="name their folder, or use --method ihe, snr or a fixed one",
            )
        for encoding, other in counts.gathered.items():
            own = {"sample": counts.sample, "weighting": other.histogram.weighting}
            expected = {"sample": options.sample, "weighting": options.weighting}
            if own != expected:
                raise WeightsError(
                    f"{counts.source}: was counted with {_in_words(own)}; expected {_in_words(expected)}, as for the"
                    " others",
                    hint="fit with these options, or count its photographs again",
                )
            if contrast and not other.measured:
                raise WeightsError(
                    f"{counts.source}: holds no contrast, which the guard goes by",
                    hint="use --guard none, or count its photographs again with the guard",
                )
            if encoding not in gathered:
                gathered[encoding] = SetCounts(Histogram(encoding, options.weighting))
            gathered[encoding].pool(other)
            unseen.add(encoding)
    return unseen


def _in_words(values: Mapping[str, Any]) -> str:
    return " and ".join(f"{name} {value}" for name, value in values.items())


@dataclass(frozen=True)
class _SetFit:
    """Hold what is known of the photographs of one encoding, and the greys that follow."""

    gathered: SetCounts
    members: Sequence[Capture]
    options: FitOptions
    executor: Executor
    progress: Progress
    recount: bool

    @property
    def encoding(self) -> Encoding:
        return self.gathered.histogram.encoding

    def white_of(self, triplet: tuple[float, float, float]) -> float:
        return white_point(self.gathered.histogram, triplet) if self.encoding == "linear" else 1.0

    def grey(self, method: str) -> Grey:
        grid = triplets(self.options.step)
        if method == "ihe":
            guarded = self.options.guard == "noise"
            return self.flattest(self.gathered.contrast.admitted(grid) if guarded else grid)
        if method == "snr":
            return self.weights(method, shares(self.gathered.contrast.best(grid)))
        if method == REFERENCE:
            return self.weights(method, self.rec709)
        if method in FIXED:
            return self.weights(method, FIXED[method])
        histogram, formula = self.gathered.histogram, self.gathered.formula
        parameters: tuple[float, ...] = () if formula is None else formula.finish()
        white = 1.0 if formula is not None else self.white_of(FIXED["green"])  # as its fit saw the values
        return Formula(method, parameters, self.encoding, white, histogram.images, histogram.pixels)

    @property
    def rec709(self) -> tuple[float, float, float]:
        """Return the triplet of COLMAP's default grey. Of linear photographs it weighs balanced channels, since that is
        what any program would give COLMAP; sensors see red and blue at about half of green."""
        balances = [c.recipe.white_balance for c in self.members if c.recipe.white_balance]
        if self.encoding == "coded" or not balances:
            return FIXED[REFERENCE]
        weighed = np.array(FIXED[REFERENCE]) * np.median(balances, axis=0)
        red, green, blue = (float(w) for w in weighed / weighed.sum())
        return red, green, blue

    def weights(self, method: str, triplet: tuple[float, float, float]) -> Weights:
        images, pixels = self.gathered.histogram.images, self.gathered.histogram.pixels
        white, contrast = self.white_of(triplet), self.gathered.contrast.share_of(triplet)
        return Weights(*triplet, method, self.encoding, None, None, white, images, pixels, contrast)

    def with_curve(self, grey: Grey) -> Grey:
        """Return the same grey, able to be equalised where it is one that can be."""
        if self.encoding == "coded" or isinstance(grey, Formula) or grey.curve:
            return grey
        return replace(grey, curve=curve_of(self.gathered.histogram, grey.triplet))

    def flattest(self, grid: Sequence[Triplet]) -> Weights:
        """Return the winner of IHE among the triplets of `grid`."""
        options = self.options

        def recount(chosen: Sequence[Triplet], whites: Sequence[int]) -> NDArray[np.int64]:
            count = partial(_levels_of, options.sample, options.weighting, chosen, whites)
            self.progress.start(len(self.members), f"images, for {len(chosen)} triplets")
            total: NDArray[np.int64] = np.zeros((len(chosen), 256), np.int64)
            for counts in in_order(self.executor, count, self.members, progress=self.progress):
                total += counts
                self.progress.advance()
            return total

        self.progress.start(len(grid), "triplets")
        if self.encoding == "linear" and self.recount:
            fit = fit_histogram(self.gathered.histogram, grid, recount)
        else:
            fit = fit_cells(self.gathered.histogram, grid)
            self.progress.advance(len(grid))
        return replace(fit, contrast=self.gathered.contrast.share_of(fit.triplet))

    def tried(self, trial: Trial) -> tuple[Grey, ChosenGrey]:
        """Return the candidate that matches best on a few pairs; where there are too few of them Rec.709 of coded
        photographs and guarded IHE of linear ones. The paper's IHE of a linear set is estimated."""
        grid = triplets(self.options.step)
        greys: dict[str, Grey] = {
            "rec709": self.grey("rec709"),
            "ihe": self.flattest(self.gathered.contrast.admitted(grid)),
            "ihe of the paper": self.weights("ihe", fit_cells(self.gathered.histogram, grid).triplet),
            **{name: self.grey(name) for name in ("snr", "mean", "green")},
        }
        measured = self.measure(greys, trial, "choose")
        name = choose(measured) if measured.held_out or self.encoding == "coded" else "ihe"
        return replace(greys[name], method="auto"), ChosenGrey(name, measured, self.encoding)

    def against_rec709(self, grey: Grey, trial: Trial, decides: bool) -> tuple[Grey, ChosenGrey]:
        """Return what was measured, and the grey; Rec.709 instead where the trial `decides` for it."""
        is_coded = self.encoding == "coded"
        default = self.flattest([_REC709]) if is_coded and decides else self.grey(REFERENCE)
        if (
            isinstance(default, Weights)
            and isinstance(grey, Weights)
            and are_alike(grey.triplet, default.triplet)
        ):
            return grey, ChosenGrey(REFERENCE, TrialResult(reason=SAME), self.encoding)
        purpose: Purpose = "report" if not decides else "win" if is_coded else "choose"
        measured = self.measure({REFERENCE: default, grey.method: grey}, trial, purpose)
        won = choose(measured) == grey.method if is_coded else not is_clearly_worse(measured, grey.method)
        if won or not decides or not isinstance(grey, Weights):
            return grey, ChosenGrey(grey.method, measured, self.encoding)
        kept = self.with_curve(replace(default, method=grey.method))
        return kept, ChosenGrey(REFERENCE, measured, self.encoding, grey.triplet)

    def measure(self, greys: Mapping[str, Grey], trial: Trial, purpose: Purpose) -> TrialResult:
        """Measure greys on pairs; where that fails the result says so, for it is no reason to end a run."""
        try:
            if trial.tone == "equalise":
                greys = {name: self.with_curve(grey) for name, grey in greys.items()}
            return measure(self.members, greys, self.executor, self.progress, trial, purpose)
        except DiskFullError:
            raise
        except (KnownError, OSError, RuntimeError, KeyError) as error:
            return TrialResult(reason=f"it failed ({error})")


def _levels_of(
    sample: float, weighting: Weighting, chosen: Sequence[Triplet], whites: Sequence[int], capture: Capture
) -> NDArray[np.int64]:
    rgb = np.asarray(sampled(read_photograph(capture).rgb, sample), np.uint16)
    return count_levels(rgb, chosen, whites) * mass_of(rgb, weighting)
