"""Sparse reconstruction: cameras and points from verified matches."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.mapping_process import map_apart, pipeline_options
from colmap_ihe.colmap.native import apply_options, called, pycolmap
from colmap_ihe.errors import MappingError
from colmap_ihe.machine.files import replace_folder
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.options import SparseOptions

_LONG_TRACK = 3


@dataclass(frozen=True)
class ModelStatistics:
    """One model of the set. `mean_reprojection_error_px` in pixels of the grey images."""

    registered_images: int
    points3d: int
    points_over_3_views: int
    mean_track_length: float
    mean_reprojection_error_px: float
    image_names: tuple[str, ...]


def map_images(
    database: Path, grey: Path, sparse: Path, options: SparseOptions, images: int, progress: Progress
) -> list[ModelStatistics]:
    """Reconstructs and writes every model below `sparse`, the one with most images as 0.

    Models are written beside `sparse` and put in its place at the end. Raises `OptionError`,
    `NativeError`, `MappingError` if no image registers, `Cancelled`.
    """
    temporary = sparse.with_name(f".{sparse.name}.new")
    shutil.rmtree(temporary, ignore_errors=True)
    work = temporary / "work"
    work.mkdir(parents=True)
    pycolmap.set_random_seed(options.seed)
    found = _run(database, grey, work, options, images, progress)
    if not found:
        shutil.rmtree(temporary)
        raise MappingError(f"none of the {images} photographs could be placed in a model")
    ordered = _with_news(sorted(found.values(), key=lambda r: (-r.num_reg_images(), -r.num_points3D())))
    shutil.rmtree(work)
    for number, model in enumerate(ordered):
        folder = temporary / str(number)
        folder.mkdir()
        model.write(folder)
    replace_folder(temporary, sparse)
    return [describe(model) for model in ordered]


def _with_news(models: Sequence[pycolmap.Reconstruction]) -> list[pycolmap.Reconstruction]:
    """Without those whose images all have a place in one before: COLMAP begins anew with what it has placed."""
    kept: list[pycolmap.Reconstruction] = []
    placed: list[set[str]] = []
    for model in models:
        names = {str(model.images[i].name) for i in model.reg_image_ids()}
        if not any(names <= before for before in placed):
            kept.append(model)
            placed.append(names)
    return kept


def _run(
    database: Path, grey: Path, work: Path, options: SparseOptions, images: int, progress: Progress
) -> Mapping[int, pycolmap.Reconstruction]:
    progress.start(images)
    settings = native_options(options)
    if options.mapper == "incremental":
        if images == 2 and "ignore_two_view_tracks" not in (options.colmap.get("triangulation") or {}):
            settings.triangulation.ignore_two_view_tracks = False  # of two photographs there are no others
        registered = [0]

        def one_more() -> None:
            registered[0] += 1

        return called(
            pycolmap.incremental_mapping,
            database,
            grey,
            work,
            options=settings,
            initial_image_pair_callback=one_more,
            next_image_callback=one_more,
            progress=progress,
            units_done=lambda: min(registered[0], images),
        )
    return map_apart(options.mapper, database, grey, work, options.colmap, options.seed, progress)


def native_options(options: SparseOptions) -> Any:
    """The pipeline options of the mapper in pycolmap. Raises `OptionError`."""
    if options.mapper != "incremental":
        return pipeline_options(options.mapper, options.colmap)
    settings = pycolmap.IncrementalPipelineOptions(random_seed=options.seed)
    apply_options(settings, options.colmap, "sparse.colmap")
    return settings


def describe(model: pycolmap.Reconstruction) -> ModelStatistics:
    return ModelStatistics(
        registered_images=model.num_reg_images(),
        points3d=model.num_points3D(),
        points_over_3_views=sum(p.track.length() > _LONG_TRACK for p in model.points3D.values()),
        mean_track_length=model.compute_mean_track_length(),
        mean_reprojection_error_px=model.compute_mean_reprojection_error(),
        image_names=tuple(sorted(model.image(i).name for i in model.reg_image_ids())),
    )
