"""Reconstruct cameras and points from verified matches."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.calibration.calibrate import Calibration, Known
from colmap_ihe.colmap.calibration.models import Calibrations, Groups, calibrate_models
from colmap_ihe.colmap.measures import images_seeing
from colmap_ihe.colmap.native import apply_options, called, fill, pycolmap
from colmap_ihe.colmap.process import ColmapProcesses
from colmap_ihe.errors import MappingError, OptionError, ProjectError
from colmap_ihe.machine.files import replace_folder
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.project.options import SparseOptions

_FEW = 3  # images; points that more see are the most trustworthy

_MAPPERS: dict[str, tuple[Any, Any]] = {
    "incremental": (pycolmap.incremental_mapping, pycolmap.IncrementalPipelineOptions),
    "global": (pycolmap.global_mapping, pycolmap.GlobalPipelineOptions),
    "hierarchical": (pycolmap.hierarchical_mapping, pycolmap.HierarchicalPipelineOptions),
}


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
    """Hold the models of a mapping, that of most images first, with what came of its calibration, if anything; and the
    images by name in groups of one camera each, of cameras that were only assumed to have taken them all."""

    models: list[ModelStatistics]
    calibration: Calibration | None
    apart: list[list[str]]


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
) -> Mapped:
    """Reconstruct and write every model below `sparse`, the one with most images as 0.

    With `colour`, the folder of the colour twins, points have their colours, else grey. Cameras that are held, as
    `known` says, come out as they are in the database, to the bit; others are calibrated, unless that is left to
    COLMAP. Models are written beside `sparse` and replace it at the end. Raises `OptionError`, `NativeError`,
    `MappingError` if no image registers, `ProjectError` where a colour twin is missing, `Cancelled`.
    """
    known = known or Known()
    held = known.held
    refuse_partly_held(options, held, camera_ids(database) if held else frozenset())
    temporary = sparse.with_name(f".{sparse.name}.new")
    shutil.rmtree(temporary, ignore_errors=True)
    work = temporary / "work"
    work.mkdir(parents=True)
    pycolmap.set_random_seed(options.seed)
    progress.start(images)
    given = MappingInput(database, grey, work, options, images, held)
    map_all = _map_incrementally if options.mapper == "incremental" else map_in_process
    models = map_all(given, progress)
    if not models:
        shutil.rmtree(temporary)
        raise MappingError(f"none of the {images} photographs could be registered")
    ordered, calibrations, groups = _in_order(models), Calibrations(), Groups()
    if options.calibration == "auto":

        def map_again(other: Path) -> list[pycolmap.Reconstruction]:
            out = work / other.stem
            out.mkdir()
            progress.start(images, "images again")
            return _in_order(map_all(replace(given, database=other, out=out), progress))

        settings = calibration_settings(options)
        ordered, calibrations, groups = calibrate_models(
            ordered, database, known, settings, map_again, work, progress
        )
    shutil.rmtree(work)
    if colour is not None:
        _colour_points(ordered, colour, progress)
    for number, model in enumerate(ordered):
        folder = temporary / str(number)
        folder.mkdir()
        model.write(folder)
    replace_folder(temporary, sparse)
    return Mapped([describe(model) for model in ordered], next(iter(calibrations), None), groups)


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
    called(
        _MAPPERS[given.options.mapper][0],
        given.database,
        given.grey,
        given.out,
        options=native_options(given.options, given.held),
        progress=SILENT,
        cancellable=False,
    )


def camera_ids(database: Path) -> frozenset[int]:
    """Return the ids of all cameras in a database."""
    with pycolmap.Database.open(database) as opened:
        return frozenset(int(camera.camera_id) for camera in opened.read_all_cameras())


def refuse_partly_held(options: SparseOptions, held: frozenset[int], every: frozenset[int]) -> None:
    """Raise `OptionError` where the mapper cannot hold some cameras and refine the others."""
    if options.mapper == "global" and held and held != every:
        raise OptionError(
            f"sparse.mapper is global, which holds all cameras or none; camera.fixed would hold {len(held & every)} of"
            f" {len(every)}",
            hint="use --set sparse.mapper=incremental or hierarchical, or leave out camera.fixed",
        )


def native_options(options: SparseOptions, held: frozenset[int] = frozenset()) -> Any:
    """Return the pipeline options of the mapper in pycolmap, by which it holds cameras of these ids, for `global` all.
    The hierarchical one takes those of the incremental one, which maps its parts, by their own names too. Raises
    `OptionError`."""
    settings = _MAPPERS[options.mapper][1]()
    of_parts = getattr(settings, "incremental_options", None)
    values = options.colmap
    passed_on = {n: v for n, v in values.items() if not hasattr(settings, n) and hasattr(of_parts, n)}
    if passed_on:
        apply_options(settings, {"incremental_options": passed_on}, "sparse.colmap")
    apply_options(settings, {n: v for n, v in values.items() if n not in passed_on}, "sparse.colmap")
    if "random_seed" not in values:
        fill(settings, {"random_seed": options.seed})
    if held:
        _hold(settings, held)
    return settings


def calibration_settings(options: SparseOptions) -> pycolmap.IncrementalPipelineOptions:
    """Return COLMAP's options by which points are triangulated and filtered after a calibration: those of the mapper,
    or its defaults where the mapper has others."""
    settings = native_options(options)
    settings = getattr(settings, "incremental_options", settings)
    known = isinstance(settings, pycolmap.IncrementalPipelineOptions)
    return settings if known else pycolmap.IncrementalPipelineOptions(random_seed=options.seed)


def _hold(settings: Any, held: frozenset[int]) -> None:
    """Have a mapper hold cameras, over all that other options say."""
    if isinstance(settings, pycolmap.GlobalPipelineOptions):
        adjustment = settings.mapper.bundle_adjustment
        adjustment.refine_focal_length = adjustment.refine_principal_point = False
        adjustment.refine_extra_params = False
    else:
        getattr(settings, "incremental_options", settings).constant_cameras = set(held)


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
