"""Turn the options for mapping into those of COLMAP's mappers, and have them hold cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from colmap_ihe.colmap.native import apply_options, fill, pycolmap
from colmap_ihe.errors import OptionError
from colmap_ihe.project.options import SparseOptions

_SETTLED = {"ba_local_function_tolerance": 1e-3, "ba_global_function_tolerance": 1e-4}
"""Relative change of its cost at which an adjustment ends. At COLMAP's 0 most go on for all of their 25 or 50 steps, of
which the last change nothing that is left in the model (benchmarks/overhead.md)."""


def mapper_of(options: SparseOptions) -> Any:
    """Return COLMAP's mapper that the options name."""
    return getattr(pycolmap, f"{options.mapper}_mapping")


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
    settings = getattr(pycolmap, f"{options.mapper.title()}PipelineOptions")()
    of_parts = getattr(settings, "incremental_options", None)
    incremental = _incremental(settings)
    if incremental is not None:
        incremental.mergedict(_SETTLED)
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
    settings = _incremental(native_options(options))
    return settings or pycolmap.IncrementalPipelineOptions(random_seed=options.seed)


def _incremental(settings: Any) -> pycolmap.IncrementalPipelineOptions | None:
    """Return the options of incremental mapping in those of a mapper; None for the global one, which has none."""
    settings = getattr(settings, "incremental_options", settings)
    return settings if isinstance(settings, pycolmap.IncrementalPipelineOptions) else None


def _hold(settings: Any, held: frozenset[int]) -> None:
    """Have a mapper hold cameras, over all that other options say."""
    if isinstance(settings, pycolmap.GlobalPipelineOptions):
        adjustment = settings.mapper.bundle_adjustment
        adjustment.refine_focal_length = adjustment.refine_principal_point = False
        adjustment.refine_extra_params = False
    else:
        getattr(settings, "incremental_options", settings).constant_cameras = set(held)
