"""Write grey images of a folder of photographs, for any photogrammetry program; what is up to date is kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack, suppress
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from colmap_ihe.errors import KnownError, ProjectError, WeightsError
from colmap_ihe.fit.fit_set import Fit, Trial, fit_captures
from colmap_ihe.grey.convert import Tone, check_tone
from colmap_ihe.grey.weights import Grey, grey_from_dict
from colmap_ihe.machine.executor import in_order, local_executor
from colmap_ihe.machine.files import digest_file, fingerprint_of
from colmap_ihe.machine.libraries import __version__, library_versions
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.photographs.decode import encoding_of
from colmap_ihe.photographs.discover import discover
from colmap_ihe.photographs.each import LeftOut, refused
from colmap_ihe.photographs.encode import SUFFIXES
from colmap_ihe.photographs.recipes import prepared_set
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.output_folder import Ledger, opened
from colmap_ihe.pipeline.stages.convert import convert_captures, weights_for
from colmap_ihe.pipeline.warnings import photographs as set_warnings
from colmap_ihe.project.options import CamerasOptions, ConvertOptions, DevelopOptions, FitOptions

_OF_THE_FIT = ("score", "tones", "images", "pixels")  # what a fit set_fit, and what no pixel depends on
_Digests = Mapping[str, str]


def convert_folder(
    images: Path,
    out: Path,
    *,
    colour: Path | None = None,
    fit: FitOptions | None = None,
    weights: Grey | None = None,
    options: ConvertOptions | None = None,
    develop: DevelopOptions | None = None,
    calibration: Path | None = None,
    cameras: CamerasOptions | None = None,
    strict: bool = False,
    progress: RunProgress = SILENT,
) -> tuple[Grey, dict[str, str], LeftOut]:
    """Write grey images of the folder `images`, with their EXIF, into the folder `out`; with `colour`, also an 8-bit
    colour twin of each in that folder, with the same name and the same pixels.

    `weights` are used if given, else fitted by `fit`. `calibration`: a folder with calibration frames; `cameras`
    fill in what EXIF does not say. Return the weights (of the larger part of a mixed set), the names of the grey
    images by photograph, and what was left out. Of an earlier run, finished or not, everything is kept that would
    come out the same. Raises `KnownError`s; `ProjectError` rather than write over anything that we did not write.
    """
    folders = [folder.resolve() for folder in (out, colour) if folder is not None]
    require_apart(images.resolve(), folders)
    options, cameras = options or ConvertOptions(), cameras or CamerasOptions()
    discovery = discover(images.absolute())
    not_read = refused(discovery, strict)
    with ExitStack() as stack:
        executor = stack.enter_context(local_executor())
        prepared = stack.enter_context(
            prepared_set(
                discovery.captures,
                develop,
                calibration,
                executor,
                progress,
                strict=strict,
                cameras=cameras,
            )
        )
        surveyed, left_out = prepared.surveyed, not_read | prepared.left_out
        digests = digests_of(surveyed, executor, progress)
        for text in set_warnings.warnings_of(surveyed, discovery.ignored):
            progress.warn(text)
        for text in set_warnings.camera_warnings(cameras, surveyed, left_out):
            progress.warn(text)
        ledgers = [stack.enter_context(opened(folder)) for folder in folders]
        expected = {s.capture.grey_stem + SUFFIXES[options.format]: s.capture.name for s in surveyed}
        for ledger in ledgers:
            ledger.refuse(expected)
        if weights is not None:
            set_fit = _fit_of(weights, surveyed, digests, ledgers, executor, progress)
        else:
            set_fit = _fitted(
                surveyed,
                digests,
                fit or FitOptions(),
                ledgers[0],
                executor,
                progress,
                strict,
                options.tone,
            )
            left_out |= set_fit.left_out
            _warn_of_the_fit(set_fit, surveyed, progress)
        for text in set_warnings.wallis_warnings(options.wallis):
            progress.warn(text)
        usable = [s for s in surveyed if s.capture.name not in left_out]
        _require_weights(usable, set_fit, options.tone)
        names, failed = _convert(usable, digests, set_fit, options, ledgers, executor, progress, strict)
        left_out |= failed
    for reason in left_out.values():
        progress.warn(f"left out: {reason}")
    return set_fit.main, names, left_out


def _convert(
    surveyed: Sequence[Surveyed],
    digests: _Digests,
    fit: Fit,
    options: ConvertOptions,
    ledgers: Sequence[Ledger],
    executor: Executor,
    progress: RunProgress,
    strict: bool,
) -> tuple[dict[str, str], LeftOut]:
    names = {s.capture.name: s.capture.grey_stem + SUFFIXES[options.format] for s in surveyed}
    expected = {grey: name for name, grey in names.items()}
    due: set[str] = set()
    for ledger, is_colour in zip(ledgers, (False, True), strict=False):
        prints = {
            names[s.capture.name]: _fingerprint(s, digests[s.capture.name], fit, options, is_colour)
            for s in surveyed
        }
        due |= {expected[name] for name in ledger.begin(expected, prints)}
        for name in sorted(ledger.changed):
            progress.warn(
                f"{ledger.folder / name} was changed since it was written, and is left as it is;"
                " delete it to have it written again"
            )
    if not due:
        progress.kept("convert")
        return names, {}
    try:
        with progress.stage("convert") as stage_progress:
            _, left_out = convert_captures(
                [s for s in surveyed if s.capture.name in due],
                fit,
                options,
                ledgers[0].folder,
                ledgers[1].folder if len(ledgers) > 1 else None,
                executor,
                stage_progress,
                strict=strict,
                keep_finished=True,
            )
    except BaseException:
        with suppress(KnownError):
            _end(ledgers)
        raise
    _end(ledgers)
    return {name: grey for name, grey in names.items() if name not in left_out}, left_out


def _end(ledgers: Sequence[Ledger]) -> None:
    for ledger in ledgers:
        ledger.end()


def _fingerprint(one: Surveyed, digest: str, fit: Fit, options: ConvertOptions, is_colour: bool) -> str:
    """Return the fingerprint of everything that the bytes of a grey image, or of a colour twin, come from."""
    linear = encoding_of(one.capture) == "linear"
    unused = _OF_THE_FIT if options.tone == "equalise" else (*_OF_THE_FIT, "curve")
    weights = {k: v for k, v in weights_for(one.capture, fit).as_dict().items() if k not in unused}
    versions = library_versions("rawpy", "libraw") if linear else {}
    if is_colour:
        how: list[Any] = ["colour", fit.colour_white if linear else None]
    else:
        how = ["grey", weights, options.tone if linear else None, options.wallis]
    recipe = one.capture.recipe.identity()
    about = [digest, recipe, one.metadata.exif.hex()]
    return fingerprint_of(__version__, versions, about, options.format, how)


def _fitted(
    surveyed: Sequence[Surveyed],
    digests: _Digests,
    options: FitOptions,
    ledger: Ledger,
    executor: Executor,
    progress: RunProgress,
    strict: bool,
    tone: Tone = "sqrt",
) -> Fit:
    """Fit the set, or return the fit that the ledger holds of the same photographs and options."""
    trial = Trial(tone) if options.method == "auto" else None
    versions = library_versions("rawpy", "libraw", *(["pycolmap"] if trial else []))
    about_trial = asdict(trial) if trial else None
    content = sorted([s.capture.name, digests[s.capture.name], s.capture.recipe.identity()] for s in surveyed)
    key = fingerprint_of(__version__, versions, content, options.model_dump(), about_trial)
    kept = _kept_fit(ledger.notes.get("fit"), key)
    if kept is not None and not (strict and kept.left_out):
        progress.kept("fit")
        return kept
    with progress.stage("fit") as stage_progress:
        captures = [s.capture for s in surveyed]
        fit = fit_captures(captures, options, executor, stage_progress, strict=strict, trial=trial)
        fit = replace(fit, gathered={})  # which takes memory
    ledger.notes["fit"] = {
        "fingerprint": key,
        "weights": [w.as_dict() for w in fit.weights.values()],
        "colour_white": fit.colour_white,
        "left_out": fit.left_out,
    }
    return fit


def _kept_fit(note: Any, key: str) -> Fit | None:
    if not isinstance(note, dict) or note.get("fingerprint") != key:
        return None
    try:
        weights = [grey_from_dict(w) for w in note["weights"]]
        return Fit({w.encoding: w for w in weights}, float(note["colour_white"]), dict(note["left_out"]))
    except (KeyError, TypeError, ValueError, WeightsError):
        return None


def _fit_of(
    weights: Grey,
    surveyed: Sequence[Surveyed],
    digests: _Digests,
    ledgers: Sequence[Ledger],
    executor: Executor,
    progress: RunProgress,
) -> Fit:
    """Return given weights as a fit. Colour twins of RAW need the set's own white point besides."""
    if len(ledgers) < 2 or weights.encoding != "linear":
        return Fit({weights.encoding: weights})
    green = FitOptions(method="green")
    white = _fitted(surveyed, digests, green, ledgers[1], executor, progress, False).colour_white
    return Fit({weights.encoding: weights}, white)


def _warn_of_the_fit(fit: Fit, surveyed: Sequence[Surveyed], progress: RunProgress) -> None:
    if len(fit.weights) > 1:
        progress.warn(
            "the set mixes RAW and gamma-coded photographs: each kind has weights of its own, and a colour is"
            " not the same grey in both"
        )
    for text in set_warnings.fit_warnings([s.capture for s in surveyed], fit.weights.values()):
        progress.warn(text)


def _require_weights(surveyed: Sequence[Surveyed], fit: Fit, tone: Tone) -> None:
    """Refuse a kind without weights, and a tone that a grey cannot have, before anything is written."""
    for grey in fit.weights.values():
        check_tone(grey, tone)
    for one in surveyed:
        weights_for(one.capture, fit)


def digests_of(surveyed: Sequence[Surveyed], executor: Executor, progress: RunProgress) -> dict[str, str]:
    """Return the digest of each photograph's content, by name."""
    digests = {}
    with progress.stage("content") as stage_progress:
        stage_progress.start(len(surveyed))
        files = [s.capture.path for s in surveyed]
        for one, digest in zip(surveyed, in_order(executor, digest_file, files), strict=True):
            digests[one.capture.name] = digest
            stage_progress.advance()
    return digests


def require_apart(images: Path, folders: Sequence[Path]) -> None:
    """Raise `ProjectError` where one of the folders lies in another."""
    for folder in folders:
        if folder.is_relative_to(images) or images.is_relative_to(folder):
            raise ProjectError(
                f"{folder}: lies in the folder of photographs or holds it", hint="use a folder of its own"
            )
    for folder, other in pairwise(folders):
        if folder.is_relative_to(other) or other.is_relative_to(folder):
            raise ProjectError(
                f"{other}: lies in the folder of grey images or holds it", hint="use a folder of its own"
            )
