"""Write grey images of a folder of photographs, for any photogrammetry program; what is up to date is kept."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from colmap_ihe.errors import KnownError, WeightsError
from colmap_ihe.fit.fit_set import Fit, fit_captures
from colmap_ihe.fit.trial_bench import Trial
from colmap_ihe.grey.convert import Tone, check_tone
from colmap_ihe.grey.weights import Encoding, Grey, grey_from_dict
from colmap_ihe.machine.files import fingerprint_of, read_json
from colmap_ihe.machine.libraries import __version__, library_versions
from colmap_ihe.machine.progress import SILENT, RunProgress
from colmap_ihe.photographs.decode import encoding_of
from colmap_ihe.photographs.each import LeftOut
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.pipeline.output_folder import RECORD, FolderRun, Ledger, folder_run
from colmap_ihe.pipeline.run_stages import warn_of
from colmap_ihe.pipeline.stages.convert import ImageWriter, convert_captures, grey_name, weights_for
from colmap_ihe.pipeline.warnings import photographs as set_warnings
from colmap_ihe.pipeline.warnings.files import depth_warnings
from colmap_ihe.project.options import CamerasOptions, ConvertOptions, DevelopOptions, FitOptions

_OF_THE_FIT = ("score", "tones", "images", "pixels")  # which tell of the fit, and no pixel depends on


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
    options, cameras = options or ConvertOptions(), cameras or CamerasOptions()
    folders = [folder for folder in (out, colour) if folder is not None]
    with folder_run(images, folders, develop, calibration, strict, progress, cameras=cameras) as run:
        for ledger in run.ledgers:
            ledger.refuse({grey_name(s, options): s.capture.name for s in run.surveyed})
        if weights is not None:
            set_fit = _given_fit(run, weights, options.tone)
        else:
            set_fit = _fitted(run, fit or FitOptions(), run.ledgers[0], options.tone)
            _warn_of_the_fit(set_fit, run.surveyed, progress)
        run.left_out |= set_fit.left_out
        warn_of(set_warnings.wallis_warnings(options.wallis), progress)
        names, failed = _convert(run, set_fit, options)
        run.left_out |= failed
    return set_fit.main, names, run.left_out


def tried_in(out: Path, encoding: Encoding) -> dict[str, Any] | None:
    """Return what the fit of a folder of grey images tried on pairs of photographs of this encoding, as its record
    says; None where it tried nothing."""
    notes = (read_json(out / RECORD) or {}).get("notes")
    fit = notes.get("fit") if isinstance(notes, dict) else None
    tried = fit.get("tried") if isinstance(fit, dict) else None
    found = tried.get(encoding) if isinstance(tried, dict) else None
    return found if isinstance(found, dict) else None


def _convert(run: FolderRun, fit: Fit, options: ConvertOptions) -> tuple[dict[str, str], LeftOut]:
    """Write the files that are due; return the grey images of all by photograph, and what was left out. A kind without
    weights, and a tone that a grey cannot have, are refused before anything is written."""
    for grey in fit.weights.values():
        check_tone(grey, options.tone)
    usable = [s for s in run.surveyed if s.capture.name not in run.left_out]
    for photograph in usable:
        weights_for(photograph.capture, fit)
    names = {s.capture.name: grey_name(s, options) for s in usable}
    expected = {grey: name for name, grey in names.items()}
    due: set[str] = set()
    for ledger, is_colour in zip(run.ledgers, (False, True), strict=False):
        prints = {names[s.capture.name]: _fingerprint(run, s, fit, options, is_colour) for s in usable}
        due |= {expected[name] for name in ledger.begin(expected, prints)}
        for name in sorted(ledger.changed):
            run.progress.warn(
                f"{ledger.folder / name} was changed since it was written, and is left as it is;"
                " delete it to have it written again"
            )
    if not due:
        run.progress.kept("convert")
        return names, {}
    missing = [s for s in usable if s.capture.name in due]
    grey_folder, *others = [ledger.folder for ledger in run.ledgers]
    writer = ImageWriter(fit, options, grey_folder, others[0] if others else None, keep_finished=True)
    try:
        with run.progress.stage("convert") as stage_progress:
            _, left_out = convert_captures(missing, writer, run.executor, stage_progress, run.strict)
    except BaseException:
        with suppress(KnownError):
            _end(run.ledgers)
        raise
    _end(run.ledgers)
    return {name: grey for name, grey in names.items() if name not in left_out}, left_out


def _end(ledgers: Sequence[Ledger]) -> None:
    for ledger in ledgers:
        ledger.end()


def _fingerprint(
    run: FolderRun, photograph: Surveyed, fit: Fit, options: ConvertOptions, is_colour: bool
) -> str:
    """Return the fingerprint of everything that the bytes of a grey image, or of a colour twin, come from."""
    linear = encoding_of(photograph.capture) == "linear"
    unused = _OF_THE_FIT if options.tone == "equalise" else (*_OF_THE_FIT, "curve")
    weights = {k: v for k, v in weights_for(photograph.capture, fit).as_dict().items() if k not in unused}
    versions = library_versions("rawpy", "libraw") if linear else {}
    if is_colour:
        how: list[Any] = ["colour", fit.colour_white if linear else None]
    else:
        how = ["grey", weights, options.tone if linear else None, options.wallis]
    recipe = photograph.capture.recipe
    recipe = recipe if is_colour else recipe.unbalanced()
    about = [run.digests[photograph.capture.name], recipe.identity(), photograph.metadata.exif.hex()]
    return fingerprint_of(__version__, versions, about, options.format, how)


def _fitted(run: FolderRun, options: FitOptions, ledger: Ledger, tone: Tone) -> Fit:
    """Fit the set, or return the fit that the ledger holds of the same photographs and options."""
    trial = Trial(tone) if options.method == "auto" else None
    versions = library_versions("rawpy", "libraw", *(["pycolmap"] if trial else []))
    captures = [s.capture for s in run.surveyed]
    is_balanced = options.method in ("auto", "rec709")  # which weigh balanced channels of RAW
    recipes = [c.recipe if is_balanced else c.recipe.unbalanced() for c in captures]
    content = sorted(
        [c.name, run.digests[c.name], recipe.identity()] for c, recipe in zip(captures, recipes, strict=True)
    )
    key = fingerprint_of(
        __version__,
        versions,
        content,
        options.model_dump(exclude={"second"}),
        trial.as_dict() if trial else None,
    )
    kept = _kept_fit(ledger.notes.get("fit"), key)
    if kept is not None and not (run.strict and kept.left_out):
        run.progress.kept("fit")
        return kept
    with run.progress.stage("fit") as stage_progress:
        fit = fit_captures(captures, options, run.executor, stage_progress, strict=run.strict, trial=trial)
    warn_of(depth_warnings(captures, fit.gathered), run.progress)
    ledger.notes["fit"] = {
        "fingerprint": key,
        "weights": [w.as_dict() for w in fit.weights.values()],
        "colour_white": fit.colour_white,
        "left_out": fit.left_out,
        "tried": {encoding: tried.as_dict() for encoding, tried in fit.tried.items()},
    }
    return replace(fit, gathered={})  # which takes memory


def _kept_fit(note: Any, key: str) -> Fit | None:
    if not isinstance(note, dict) or note.get("fingerprint") != key:
        return None
    try:
        weights = [grey_from_dict(w) for w in note["weights"]]
        return Fit({w.encoding: w for w in weights}, float(note["colour_white"]), dict(note["left_out"]))
    except (KeyError, TypeError, ValueError, WeightsError):
        return None


def _given_fit(run: FolderRun, weights: Grey, tone: Tone) -> Fit:
    """Return given weights as a fit. Colour twins of RAW need the set's own white point besides."""
    if len(run.ledgers) < 2 or weights.encoding != "linear":
        return Fit({weights.encoding: weights})
    green = _fitted(replace(run, strict=False), FitOptions(method="green"), run.ledgers[1], tone)
    return Fit({weights.encoding: weights}, green.colour_white)


def _warn_of_the_fit(fit: Fit, surveyed: Sequence[Surveyed], progress: RunProgress) -> None:
    if len(fit.weights) > 1:
        progress.warn(
            "the set mixes RAW and gamma-coded photographs: each kind has weights of its own, and a colour is"
            " not the same grey in both"
        )
    warn_of(set_warnings.fit_warnings([s.capture for s in surveyed], fit.weights.values()), progress)
