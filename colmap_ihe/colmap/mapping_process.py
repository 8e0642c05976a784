"""Mappers of COLMAP that cannot be asked to stop, in a process of their own, which can be ended.

pycolmap 4.2 gives neither `hierarchical_mapping` nor `global_mapping`, nor the classes behind them, a token to cancel
with. On a thread they would go on after Ctrl-C, for hours in a large set, beside whatever comes next.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_ihe.colmap.native import apply_options, called, fill, pycolmap
from colmap_ihe.colmap.process import ColmapProcesses
from colmap_ihe.machine.progress import SILENT, Progress

MAPPERS: dict[str, tuple[Any, Any]] = {
    "global": (pycolmap.global_mapping, pycolmap.GlobalPipelineOptions),
    "hierarchical": (pycolmap.hierarchical_mapping, pycolmap.HierarchicalPipelineOptions),
}


@dataclass(frozen=True)
class _Request:
    mapper: str
    database: Path
    grey: Path
    out: Path
    options: dict[str, Any]
    seed: int


def pipeline_options(mapper: str, values: Mapping[str, Any]) -> Any:
    """The options of one of `MAPPERS`. The hierarchical one takes those of the incremental mapper, with which it maps
    its parts, by their own names too. Raises `OptionError`."""
    settings = MAPPERS[mapper][1]()
    of_parts = getattr(settings, "incremental_options", None)
    passed_on = {n: v for n, v in values.items() if not hasattr(settings, n) and hasattr(of_parts, n)}
    if passed_on:
        apply_options(settings, {"incremental_options": passed_on}, "sparse.colmap")
    apply_options(settings, {n: v for n, v in values.items() if n not in passed_on}, "sparse.colmap")
    return settings


def map_apart(
    mapper: str,
    database: Path,
    grey: Path,
    out: Path,
    options: Mapping[str, Any],
    seed: int,
    progress: Progress,
) -> dict[int, pycolmap.Reconstruction]:
    """The models that one of `MAPPERS` finds; it writes them below `out`. Raises `NativeError`, also where its
    process died, and `Cancelled`, when it has ended."""
    request = _Request(mapper, database, grey, out, dict(options), seed)
    with ColmapProcesses() as apart:
        apart.call(_map, request, progress)
    folders = sorted((p for p in out.iterdir() if p.is_dir()), key=lambda p: p.name)
    return {number: pycolmap.Reconstruction(folder) for number, folder in enumerate(folders)}


def _map(request: _Request, _progress: Progress) -> None:
    settings = pipeline_options(request.mapper, request.options)
    fill(settings, {"random_seed": request.seed})
    called(
        MAPPERS[request.mapper][0],
        *(request.database, request.grey, request.out),
        options=settings,
        progress=SILENT,
        cancellable=False,
    )
