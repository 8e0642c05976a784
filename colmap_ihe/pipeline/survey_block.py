"""Gather the block of the page that a surveyor reads: verdict, figures, maps, plan and residuals of a model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from colmap_ihe.colmap.checks.overlap import Places, places_of
from colmap_ihe.colmap.observations import Float64, points_of_two
from colmap_ihe.pipeline.model_verdict import ModelFigures, verdict_of
from colmap_ihe.pipeline.model_view import ModelView
from colmap_ihe.pipeline.overlap_maps import camera_plan, overlap_map, views_of, weak_parts
from colmap_ihe.pipeline.survey_facts import Measures, fixes_of, pixel_sizes, survey_facts
from colmap_ihe.report.survey_contents import Residuals, SurveyBlock

_BINS = 24
_MOST_PERCENT = 95
_STEPS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)  # pixels a bar

_Records = Mapping[str, Mapping[str, Any]]


def survey_block(
    database: Path, records: _Records, summary: Mapping[str, Any], view: ModelView, by_grey: Mapping[str, str]
) -> SurveyBlock:
    """Return the block of a model that has a sparse model at least. `by_grey`: photographs by the names of their grey
    images."""
    seen = view.observations
    names = [by_grey.get(name, name) for name in seen.names]
    measures = Measures(pixel_sizes(seen), view.extent, summary.get("metric") is True)
    fixes = fixes_of(database) if records["captures"]["with_gps"] else []
    facts = survey_facts(summary, records["captures"], measures, fixes)
    residuals = _residuals(seen.errors_px, records.get("survey", {}))
    doubts = sum(len(records.get(stage, {}).get("warnings", ())) for stage in ("sparse", "survey"))
    places = _places(view, database)
    if places is None:
        figures = ModelFigures(None, None, gsd_mm=measures.gsd_mm, doubts=doubts)
        return SurveyBlock(verdict_of(summary, figures), facts, residuals=residuals)
    directions = view.turned(seen.block.rotations[:, 2])
    views = views_of(directions)
    figures = ModelFigures(
        float(places.few.mean()),
        float(places.narrow.mean()),
        weak_parts(places, places.few, views, names),
        weak_parts(places, places.narrow, views, names),
        measures.gsd_mm,
        doubts,
    )
    return SurveyBlock(
        verdict_of(summary, figures),
        facts,
        [overlap_map(places, each) for each in views],
        _square(places, measures),
        camera_plan(places, view.moved(seen.centres), directions, names),
        residuals,
    )


def _places(view: ModelView, database: Path) -> Places | None:
    """Return the places of a model, in the frame of the view, with those that only matches of two photographs show."""
    seen = view.observations
    block = seen.block
    points, images = points_of_two(view.model, database, seen)
    return places_of(
        view.moved(np.concatenate([block.points, points])).astype(np.float64),
        np.concatenate([block.point, len(block.points) + np.repeat(np.arange(len(points)), 2)]),
        np.concatenate([block.image, images.ravel()]),
        view.moved(seen.centres).astype(np.float64),
    )


def _square(places: Places, measures: Measures) -> str:
    if measures.metric:
        return f"{places.side:.2g} m"
    longest = float(np.max(measures.extent, initial=0.0)) or places.side
    return f"1/{round(longest / places.side)} of the model's longest side"


def _residuals(errors_px: Float64, survey: Mapping[str, Any]) -> list[Residuals]:
    """Return the residuals of the points of the model, and of the surveyed and measured ones."""
    sights = [length for point in survey.get("points", ()) for length in point.get("residuals_px", ())]
    found = (
        residuals_of("points of the model", errors_px),
        residuals_of("named points of the survey", np.array(sights, np.float64)),
    )
    return [residuals for residuals in found if residuals is not None]


def residuals_of(what: str, errors_px: Float64) -> Residuals | None:
    """Count errors (M,) in pixels by steps that suit them; None where none is known."""
    errors = errors_px[np.isfinite(errors_px)]
    if not len(errors):
        return None
    most = float(np.percentile(errors, _MOST_PERCENT))
    step = next((s for s in _STEPS if s * _BINS >= 1.5 * most), _STEPS[-1])
    counts = np.bincount(np.minimum((errors / step).astype(np.intp), _BINS - 1), minlength=_BINS)
    return Residuals(what, counts.tolist(), step, float(np.median(errors)), most)
