"""List the stages in their order."""

from __future__ import annotations

from colmap_ihe.pipeline.stages import (
    captures,
    convert,
    dense,
    drawings,
    features,
    fit,
    matches,
    mesh,
    sparse,
    survey,
)

STAGES = (
    captures.STAGE,
    fit.STAGE,
    convert.STAGE,
    features.STAGE,
    matches.STAGE,
    sparse.STAGE,
    survey.STAGE,
    dense.STAGE,
    mesh.STAGE,
    drawings.STAGE,
)
STAGE_NAMES = tuple(stage.name for stage in STAGES)
