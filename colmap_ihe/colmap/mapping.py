"""Reconstruct cameras and points from verified matches."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from colmap_ihe.colmap.calibration.calibrate import Calibration, Known
from colmap_ihe.colmap.calibration.models import Calibrated, Setting, calibrate_models
from colmap_ihe.colmap.mapper_options import (
    calibration_settings,
    camera_ids,
    mapper_of,
    native_options,
    refuse_partly_held,
)
from colmap_ihe.colmap.measures import images_seeing
from colmap_ihe.colmap.native import called, pycolmap
from colmap_ihe.colmap.process import ColmapProcesses
from colmap_ihe.colmap.second_try import SecondTry, second_try_options, with_changes
from colmap_ihe.errors import MappingError, NativeError, ProjectError
from colmap_ihe.machine.files import replace_folder
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.project.options import SparseOptions

_FEW = 3  # images; points that more see are the most trustworthy


@dataclass(frozen=True)
class ModelStatistics:
    """Describe one model of the set. `points_over_3_views`: seen in more than three images; `mean_track_length`:
    observations a point, as COLMAP counts; `mean_reprojection_error_px` in pixels of the grey images."""

    registered_images: int
    points3d: int
    points_over_3_views: int
    mean_track_length: float
    mean_reprojection_error_px: float
    image_names: tuple[str, ...]


@dataclass(frozen=True)
class Mapped:
    """Hold the models of a mapping, that of most images first, with what came of its calibration, if anything; the
    images by name in groups of one camera each, of cameras that were only assumed to have taken them all; and what went
    wrong in calibrating (`problems`)."""

    models: list[ModelStatistics]
    calibration: Calibration | None
    apart: list[list[str]]
    problems: list[str]


@dataclass(frozen=True)
class MappingInput:
    """Hold what a mapper works on: the database, the folders of the grey images and of its result, options, and the ids
    of the cameras that it holds as they are."""

    database: Path
    grey: Path
    out: Path
    options: SparseOptions
    images: int
    held: frozenset[int] = frozenset()


def map_images(
    database: Path,
    grey: Path,
    sparse: Path,
    options: SparseOptions,
    images: int,
    progress: Progress,
    *,
    colour: Path | None = None,
    known: Known | None = None,
    on_second_try: Callable[[SecondTry], object] = lambda _: None,
) -> Mapped:
    """Reconstruct and write every model below `sparse`, the one with most images as 0.

    With `colour`, the folder of the colour twins, points have their colours, else grey. Cameras that are held, as
    `known` says, come out as they are in the database, to the bit; others are calibrated, unless that is left to
    COLMAP. Where few photographs are registered there is a second try, of which `on_second_try` is told. Models are
    written beside `sparse` and replace it at the end. Raises `OptionError`, `NativeError`, `MappingError` if no image
    registers, `ProjectError` where a colour twin is missing, `Cancelled`.
    """
    known = known or Known()
    held = known.held
    refuse_partly_held(options, held, camera_ids(database) if held else frozenset())
    temporary = sparse.with_name(f".{sparse.name}.new")
    shutil.rmtree(temporary, ignore_errors=True)
    work = temporary / "work"
    work.mkdir(parents=True)
    models, given = _map_up_to_twice(
        MappingInput(database, grey, work, options, images, held), progress, on_second_try
    )
    if not models:
        shutil.rmtree(temporary)
        raise MappingError(f"none of the {images} photographs could be registered")
    calibrated = Calibrated(_in_order(models), [None], [])
    problems: list[str] = []
    if options.calibration == "auto":

        def map_again(other: Path) -> list[pycolmap.Reconstruction]:
            out = Path(tempfile.mkdtemp(prefix=other.stem, dir=work))
            progress.start(images, "images again")
            return _in_order(_map_once(replace(given, database=other, out=out), progress))

        setting = Setting(database, known, calibration_settings(options), map_again, work, progress, problems)
        calibrated = calibrate_models(calibrated.models, setting)
    shutil.rmtree(work)
    if colour is not None:
        _colour_points(calibrated.models, colour, progress)
    for number, model in enumerate(calibrated.models):
        folder = temporary / str(number)
        folder.mkdir()
        model.write(folder)
    replace_folder(temporary, sparse)
    described = [describe(model) for model in calibrated.models]
    return Mapped(described, calibrated.calibrations[0], calibrated.apart, problems)


def _map_up_to_twice(
    given: MappingInput, progress: Progress, on_second_try: Callable[[SecondTry], object]
) -> tuple[list[pycolmap.Reconstruction], MappingInput]:
    """Map, and if few photographs are registered once more with easier options; return the models of the better try,
    and what that worked on."""
    progress.start(given.images)
    models = _map_once(given, progress)
    registered = _most_registered(models)
    changes = second_try_options(given.options, registered, given.images, given.database)
    if not changes:
        return models, given
    easier = replace(given, options=with_changes(given.options, changes), out=given.out / "second")
    easier.out.mkdir()
    progress.start(given.images, "images, second try")
    others = _map_once(easier, progress)
    on_second_try(SecondTry(changes, given.images, registered, _most_registered(others)))
    return (others, easier) if _most_registered(others) > registered else (models, given)


def _most_registered(models: Sequence[pycolmap.Reconstruction]) -> int:
    return max((model.num_reg_images() for model in models), default=0)


def _map_once(given: MappingInput, progress: Progress) -> list[pycolmap.Reconstruction]:
    pycolmap.set_random_seed(given.options.seed)
    map_all = _map_incrementally if given.options.mapper == "incremental" else map_in_process
    return map_all(given, progress)


def _colour_points(models: Sequence[pycolmap.Reconstruction], colour: Path, progress: Progress) -> None:
    """Give each point the mean colour of its observations in the colour twins, which COLMAP saw in grey."""
    progress.start(len(models), "coloured models")
    for model in models:
        names = [str(model.images[i].name) for i in model.reg_image_ids()]
        missing = next((name for name in names if not (colour / name).is_file()), None)
        if missing is not None:  # COLMAP would make its points black
            raise ProjectError(
                f"{colour / missing}: no such colour twin, from which points have their colours",
                hint="run the same command with --from convert",
            )
        called(
            model.extract_colors_for_all_images,
            colour,
            num_threads=local_workers(),
            progress=progress,
            cancellable=False,
        )
        progress.advance()


def _in_order(models: Sequence[pycolmap.Reconstruction]) -> list[pycolmap.Reconstruction]:
    """Return the models, that of most images first, without those whose images are all registered in one before: COLMAP
    begins anew with registered images."""
    models = sorted(models, key=lambda model: (-model.num_reg_images(), -model.num_points3D()))
    kept: list[pycolmap.Reconstruction] = []
    registered: list[set[str]] = []
    for model in models:
        names = {str(model.images[i].name) for i in model.reg_image_ids()}
        if not any(names <= before for before in registered):
            kept.append(model)
            registered.append(names)
    return kept


def _map_incrementally(given: MappingInput, progress: Progress) -> list[pycolmap.Reconstruction]:
    settings = native_options(given.options, given.held)
    triangulation = given.options.colmap.get("triangulation") or {}
    if given.images == 2 and "ignore_two_view_tracks" not in triangulation:
        settings.triangulation.ignore_two_view_tracks = False  # of two photographs there are no others
    registered = [0]

    def count() -> None:
        registered[0] += 1

    models = called(
        pycolmap.incremental_mapping,
        given.database,
        given.grey,
        given.out,
        options=settings,
        initial_image_pair_callback=count,
        next_image_callback=count,
        progress=progress,
        units_done=lambda: min(registered[0], given.images),
    )
    return list(models.values())


def map_in_process(given: MappingInput, progress: Progress) -> list[pycolmap.Reconstruction]:
    """Return the models of the global or hierarchical mapper, run in a process of its own, which can be ended.

    pycolmap 4.2 gives neither a token to cancel with. On a thread they would go on after Ctrl-C, for hours in a large
    set, beside whatever comes next. Raises `NativeError`, also where the process died, and `Cancelled`, when it has
    ended.
    """
    with ColmapProcesses() as processes:
        processes.call(_map, given, progress)
    return [pycolmap.Reconstruction(p) for p in sorted(given.out.iterdir()) if p.is_dir()]


def _map(given: MappingInput, _progress: Progress) -> None:
    try:
        called(
            mapper_of(given.options),
            _with_focal_lengths(given),
            given.grey,
            given.out,
            options=native_options(given.options, given.held),
            progress=SILENT,
            cancellable=False,
        )
    except NativeError as error:
        # Of no model at all, the hierarchical mapper asks for the first.
        if given.options.mapper != "hierarchical" or not isinstance(error.__cause__, IndexError):
            raise


def _with_focal_lengths(given: MappingInput) -> Path:
    """Return the database; for the global mapper, which begins with all cameras as they are, a copy in which COLMAP has
    calibrated focal lengths that were guessed, from the pairs."""
    with pycolmap.Database.open(given.database) as opened:
        guessed = [c for c in opened.read_all_cameras() if not c.has_prior_focal_length]
    if given.options.mapper != "global" or not guessed or given.held:
        return given.database
    copy = given.out / "focal-lengths.db"
    shutil.copyfile(given.database, copy)
    options = pycolmap.ViewGraphCalibrationOptions(random_seed=given.options.seed)
    calibrated = called(pycolmap.calibrate_view_graph, copy, options, progress=SILENT, cancellable=False)
    return copy if calibrated else given.database


def describe(model: pycolmap.Reconstruction) -> ModelStatistics:
    """Return the statistics of a model."""
    return ModelStatistics(
        registered_images=model.num_reg_images(),
        points3d=model.num_points3D(),
        points_over_3_views=sum(images_seeing(p) > _FEW for p in model.points3D.values()),
        mean_track_length=model.compute_mean_track_length(),
        mean_reprojection_error_px=model.compute_mean_reprojection_error(),
        image_names=tuple(sorted(model.image(i).name for i in model.reg_image_ids())),
    )
