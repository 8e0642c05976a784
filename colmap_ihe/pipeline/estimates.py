"""Estimate what the stages of a run, and the page after them, need of memory, disk and time."""

from __future__ import annotations

from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stages import STAGES
from colmap_ihe.pipeline.stages.dense import POINTS_A_PIXEL, pixels_seen
from colmap_ihe.pipeline.time_estimate import Known
from colmap_ihe.project.options import Options

_PAGE = 8_000_000  # bytes on disk
_POINT, _PIXEL = 150, 75  # bytes of memory, a point of the cloud and a pixel of the photographs of a pair


def needs_of(options: Options, size: PhotoSetSize) -> list[StageNeeds]:
    """Return the needs of every stage that is not switched off, in their order, and of the page."""
    needs = [stage.needs(options, size) for stage in STAGES if not stage.switched_off(options)]
    points = POINTS_A_PIXEL * pixels_seen(options, size) if options.dense.enabled else 0.0
    page = StageNeeds("page", BASE_BYTES + round(_POINT * points), round(_PIXEL * size.largest), _PAGE)
    return [*(need for need in needs if need is not None), page]


def stage_parts(options: Options, known: Known, until: str) -> list[Part]:
    """Return the parts of the stages after `captures` up to the end of `until`, with those of the page, which follows
    where there is a model. Measured with `benchmarks/remaining.py`."""
    parts: list[Part] = []
    for stage in STAGES:
        if not stage.switched_off(options):
            parts += stage.parts(options, known)
        if stage.name == until:
            break
    if any(part.stage == "sparse" for part in parts):
        megapixels = known.pixels / 1e6
        parts += [
            Part("page", "photographs looked at", 0.045 * megapixels),
            Part("page", "pairs drawn", 2.5 + 0.8 * megapixels / known.images),
        ]
    return parts
