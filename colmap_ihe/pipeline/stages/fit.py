"""Fit the one grey of the set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator

from colmap_ihe.colmap.database import remove_database
from colmap_ihe.errors import WeightsError
from colmap_ihe.fit import weights_file
from colmap_ihe.fit.fit_set import Fit, fit_captures
from colmap_ihe.fit.histogram_file import StoredCounts, write_stored
from colmap_ihe.fit.trial_bench import Trial
from colmap_ihe.grey.weights import Encoding, Weights, grey_from_dict
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.pipeline.input_digests import digest_if_there
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stage import Count, Inputs, Record, RunContext, Stage, StageRecord, StrictModel
from colmap_ihe.pipeline.warnings.files import depth_warnings
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import FitOptions, Options

_TABLE = 192_000_000  # bytes of memory for the tables of colours, here and in a decoder
_HISTOGRAM, _MOST_HISTOGRAM = 0.05, 20_000_000  # bytes on disk a pixel, and in all


def _require_grey(values: dict[str, Any]) -> dict[str, Any]:
    try:
        grey_from_dict(values)
    except WeightsError as error:
        raise ValueError(str(error)) from error
    return values


class _WeightsRecord(StrictModel):
    weights: list[float] | None
    score: float | None
    tones: int | None
    images: Count
    encoding: Encoding


class _TrialRecord(StrictModel):
    in_words: str
    pairs: list[Annotated[list[str], Field(min_length=2, max_length=2)]]


class FitRecord(StageRecord):
    """Hold the grey by encoding, the white point of colour twins as a share of saturation, and what was tried."""

    weights: Annotated[
        dict[Encoding, Annotated[dict[str, Any], AfterValidator(_require_grey)]], Field(min_length=1)
    ]
    colour_white: Annotated[float, Field(gt=0, le=1)]
    tried: dict[str, dict[str, Any]]

    @model_validator(mode="after")
    def _parts_are_whole(self) -> FitRecord:
        for encoding, values in self.weights.items():
            if _WeightsRecord.model_validate(values).encoding != encoding:
                raise ValueError(f"the weights for {encoding} photographs are for others")
        for trial in self.tried.values():
            _TrialRecord.model_validate(trial)
        return self


def run(run: RunContext, progress: Progress) -> FitRecord:
    """Count the photographs, fit the grey and try it on pairs."""
    options = run.options.fit
    remove_database(run.project.tried_features)
    is_tried = options.measure or options.method == "auto"
    trial = _trial_of(run.options, run.project.tried_features) if is_tried else None
    given = None if options.weights is None else weights_file.read_weights(run.project.root / options.weights)
    fit = fit_captures(
        run.captures(), options, run.executor, progress, strict=run.strict, trial=trial, given=given
    )
    develop = run.options.develop.model_dump(mode="json")
    write_stored(run.project.histogram_file, StoredCounts(fit.gathered, options.sample, develop))
    warnings = depth_warnings(run.captures(), fit.gathered)
    if len(fit.weights) > 1:
        counts = " and ".join(f"{w.images} {encoding}" for encoding, w in fit.weights.items())
        warnings.append(
            f"the set mixes {counts} photographs (RAW is linear, JPEG is coded): each kind has weights of its own,"
            " and a colour is not the same grey in both; for one grey use one kind"
        )
    if isinstance(given, Weights):
        warnings += weights_file.warnings_of(given, fit.gathered[given.encoding], options)
    return record_of(fit, warnings)


def record_of(fit: Fit, warnings: Sequence[str] = ()) -> FitRecord:
    """Return a fit as the record of this stage; `fit_of` reads it back."""
    return FitRecord(
        weights={encoding: w.as_dict() for encoding, w in fit.weights.items()},
        colour_white=fit.colour_white,
        tried={encoding: t.as_dict() for encoding, t in fit.tried.items()},
        left_out=fit.left_out,
        warnings=list(warnings),
    )


def fit_of(record: Record) -> Fit:
    """Return the fit that a record of this stage holds."""
    weights = [grey_from_dict(w, "records/fit.json") for w in record["weights"].values()]
    return Fit({w.encoding: w for w in weights}, record["colour_white"])


def write_weights_file(run: RunContext) -> None:
    """Write report/weights.yaml, which `convert --weights` reads."""
    weights_file.write_weights(run.project.weights_file, fit_of(run.records["fit"]).main)


def _trial_of(options: Options, keep: Path) -> Trial:
    """Return how the photographs will look to COLMAP, for trying greys on them."""
    return Trial(options.convert.tone, options.features, keep)


def _result_options(options: Options) -> dict[str, Any]:
    values = options.sections("fit")
    values["fit"]["weights"] = options.fit.weights is not None  # their content counts, not where they lie
    del values["fit"]["second"]  # which is fitted after `convert`
    if _trial_decides(options.fit):
        values |= _of_trial(options)
    return values


def _of_trial(options: Options) -> dict[str, Any]:
    """Return what of `_trial_of` is not the default."""
    features = options.features.model_dump(mode="json", exclude_defaults=True)
    tone = options.convert.model_dump(include={"tone"}, exclude_defaults=True)
    return ({"features": features} if features else {}) | ({"convert": tone} if tone else {})


def _trial_decides(options: FitOptions) -> bool:
    """Tell whether the grey depends on what is tried, and not the report alone."""
    guarded = (options.method, options.guard, options.measure) == ("ihe", "noise", True)
    return options.method == "auto" or (guarded and options.weights is None)


def _inputs(
    project: Project, options: Options, discovery: Discovery, digests: Mapping[str, Sequence[Any]]
) -> Inputs:
    if options.fit.weights is None:
        return {}
    return {"weights": {"their file": digest_if_there(project.root / options.fit.weights)}}


def _made(project: Project) -> list[Path]:
    return [project.histogram_file, project.tried_features]


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    histogram = min(_MOST_HISTOGRAM, round(_HISTOGRAM * size.pixels))
    return StageNeeds("fit", BASE_BYTES + _TABLE, size.one_bytes, histogram)


def _parts(options: Options, known: Known) -> list[Part]:
    return [Part("fit", "images", 0.005 * known.decoded_megapixels)]


STAGE = Stage(
    "fit",
    run,
    FitRecord,
    sections=("fit",),
    libraries=("rawpy", "libraw", "pillow", "simplejpeg", "tifffile", "numpy"),
    result_options=_result_options,
    inputs=_inputs,
    made=_made,
    needs=_needs,
    parts=_parts,
)
