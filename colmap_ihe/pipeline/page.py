"""Gather what the page of a project shows from its files and records, and write it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from colmap_ihe.dense.undistort import read_colour, read_grey
from colmap_ihe.errors import KnownError
from colmap_ihe.grey.weights import FIXED
from colmap_ihe.machine.executor import in_order, threads_of
from colmap_ihe.machine.files import read_json, write_bytes
from colmap_ihe.machine.libraries import library_versions
from colmap_ihe.machine.progress import Progress, RunProgress
from colmap_ihe.pipeline import model_view
from colmap_ihe.pipeline.page_drawings import drawings_of
from colmap_ihe.pipeline.page_pairs import drawn_pairs
from colmap_ihe.pipeline.page_size import page_within
from colmap_ihe.pipeline.second_grey import lost_colour
from colmap_ihe.pipeline.stage import RunContext, is_metric
from colmap_ihe.pipeline.surface_view import surface_of
from colmap_ihe.pipeline.survey_block import survey_block
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.report import contents, pictures
from colmap_ihe.report.camera_words import gain_in_words
from colmap_ihe.report.contents import Contents, PhotographEntry
from colmap_ihe.report.methods_sentence import citation, is_default, methods_sentence
from colmap_ihe.report.model_picture import model_picture
from colmap_ihe.report.survey_contents import SurveyBlock
from colmap_ihe.report.survey_words import survey_in_words
from colmap_ihe.report.tables import summary_rows, weights_in_words
from colmap_ihe.survey.control_files import read_control

_POINTS = 200_000  # of the cloud; a page is to be sent by mail
_THUMBNAIL, _SLIDER, _TILE, _OVER = 240, 1000, 96, 1000  # pixels
_PICTURE = (480, 320)  # pixels, of the model in a list of several
_SEEN = 1.0  # levels of 255, in the mean: less is what rounding to whole levels makes
_SLIDERS, _TILES, _PICTURED = 4, 144, 400  # photographs; a larger set is shown in part
_Records = Mapping[str, Mapping[str, Any]]
_U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class _Look:
    """Hold one photograph, small: what tiles, thumbnails and histograms are made of."""

    name: str
    thumbnail: contents.Picture
    larger: contents.Picture | None
    colour: _U8
    grey: _U8
    tones_chosen: NDArray[np.int64]
    tones_rec709: NDArray[np.int64]


def page_of(run: RunContext, summary: Mapping[str, Any], progress: RunProgress) -> float | None:
    """Write the page at the end of a run, and return the seconds. Where it cannot be written the model is there all
    the same, a warning, and None."""
    began = time.monotonic()
    try:
        with progress.stage("page") as stage_progress:
            write_page(run, summary, stage_progress, progress.warn)
    except KnownError as error:
        progress.warn(f"no page was written: {error}")
        return None
    return round(time.monotonic() - began, 2)


def seconds_in(summary_file: Path) -> float | None:
    """Return how long the page took, as an earlier summary says, None where it does not."""
    seconds = (read_json(summary_file) or {}).get("page_seconds")
    return float(seconds) if isinstance(seconds, int | float) and not isinstance(seconds, bool) else None


def write_page(
    run: RunContext, summary: Mapping[str, Any], progress: Progress, warn: Callable[[str], None]
) -> Path:
    """Write report/index.html of a project that is converted at least, and model.jpg beside it, and return the page.
    Raises `KnownError`s."""
    gathered = gather(run, summary, progress)
    if gathered.cloud is not None and len(gathered.cloud.positions):
        drawn = model_picture(gathered.surface, gathered.cloud, *_PICTURE)
        write_bytes(run.project.picture_file, pictures.picture(drawn, "the model", max(_PICTURE)).jpeg)
    write_bytes(run.project.page_file, page_within(gathered, run.options.report.max_mb, warn))
    return run.project.page_file


def gather(run: RunContext, summary: Mapping[str, Any], progress: Progress) -> Contents:
    """Return all that the page shows of a project that is converted at least. Raises `KnownError`s."""
    with threads_of(run.executor) as pool:
        return _gathered(run, summary, pool, progress)


def _gathered(run: RunContext, summary: Mapping[str, Any], pool: Executor, progress: Progress) -> Contents:
    """Return all of it. The surface is made smaller on a thread of `pool` while photographs and pairs are drawn."""
    began, project, records, options = time.monotonic(), run.project, run.records, run.options
    grey_of: Mapping[str, str] = records["convert"]["grey"]
    model = model_view.ModelView(run.model_folder, run.is_metric) if "sparse" in records else None
    surface = pool.submit(surface_of, project, records.get("mesh", {}), model) if model else None
    looks = _looks(project, grey_of, pool, progress)
    photographs = _photographs(summary, grey_of, looks, model)
    greys = [grey_of.get(p.name, "") for p in photographs]
    compared = not is_default(summary) and _differs(
        list(looks.values())
    )  # else the grey is compared with itself
    lost = pool.submit(lost_colour, project, records, summary, compared)
    matched = model_view.verified_matches(project.database, greys) if "matches" in records else None
    pairs = drawn_pairs(project, summary, grey_of, matched, photographs, compared, progress)
    cloud = _cloud(project, records, model) if model else None
    block = _block(run, summary, model) if model else None
    took = round(time.monotonic() - began, 2)  # all but the writing
    return Contents(
        title=project.root.name,
        result=block.verdict.headline if block else f"{summary['images']} photographs, converted to grey.",
        rows=[] if block else summary_rows({**summary, "page_seconds": took}),
        grey=_grey(summary, options, list(looks.values()), compared),
        photographs=photographs,
        cloud=cloud,
        surface=surface.result() if surface else None,
        frame=_frame(records, summary, model) if model else None,
        cameras=_cameras(grey_of, model, looks) if model else (),
        lenses=summary["cameras"] or (),
        calibration=gain_in_words(summary),
        sliders=[
            _slider(project, name, grey_of[name]) for name in _spread(sorted(looks), _SLIDERS) if compared
        ],
        pairs=pairs,
        points_by_images=model.points_by_images() if model else {},
        matches=matched,
        warnings=summary["warnings"],
        seconds={**summary["stages"], "page": took},
        versions=library_versions("pycolmap", "opencv", "rawpy", "libraw"),
        options=yaml.safe_dump(options.as_yaml(), sort_keys=False),
        methods_sentence=methods_sentence(summary, options, library_versions("pycolmap")["pycolmap"]),
        citation=citation(summary, options),
        lost_colour=lost.result(),
        survey_line=survey_in_words(summary),
        survey=records["survey"] if is_metric(records) else None,
        point_names=sorted(read_control(project.control).names),
        block=block,
        drawings=drawings_of(project),
    )


def _block(run: RunContext, summary: Mapping[str, Any], model: model_view.ModelView) -> SurveyBlock:
    return survey_block(run.project.database, run.records, summary, model, run.photographs_by_grey())


def _larger_side(photographs: int) -> int:
    """Return the longer side in pixels of the photographs that lie over the model: some 4 MB of them in all."""
    return int(min(_OVER, 4 * _OVER / max(photographs, 1) ** 0.5))


def _looks(
    project: Project, grey_of: Mapping[str, str], pool: Executor, progress: Progress
) -> dict[str, _Look]:
    some, side = _spread(sorted(grey_of), _PICTURED), _larger_side(len(grey_of))
    progress.start(len(some), "photographs looked at")
    looks = {}
    for look in in_order(
        pool, lambda name: _look(project, name, grey_of[name], side), some, progress=progress
    ):
        looks[look.name] = look
        progress.advance()
    return looks


def _look(project: Project, name: str, grey_name: str, larger_side: int) -> _Look:
    colour, grey = read_colour(project.colour / grey_name), read_grey(project.grey / grey_name)
    small = pictures.shrunk(colour, _THUMBNAIL)
    thumbnail = pictures.picture(small, f"photograph {name}", _THUMBNAIL)
    larger = pictures.picture(colour, thumbnail.alt, larger_side) if larger_side > _THUMBNAIL else None
    tones = [
        np.bincount(v.ravel(), minlength=256) for v in (grey[::2, ::2], pictures.rec709(colour[::2, ::2]))
    ]
    return _Look(name, thumbnail, larger, small, pictures.shrunk(grey, _THUMBNAIL), *tones)


def _differs(looks: Sequence[_Look]) -> bool:
    """Tell whether an eye can see that the grey of the set is not COLMAP's default."""
    away = [np.abs(look.grey.astype(np.int16) - pictures.rec709(look.colour)).mean() for look in looks]
    return bool(away) and float(np.mean(away)) >= _SEEN


def _grey(
    summary: Mapping[str, Any], options: Options, looks: Sequence[_Look], compared: bool
) -> contents.Grey:
    weights = summary["weights"]
    total = [sum(getattr(look, name) for look in looks) for name in ("tones_chosen", "tones_rec709")]
    shares = [tuple((counts / counts.sum()).tolist()) for counts in total]
    tiles = [look for look in looks if look.name in _spread([one.name for one in looks], _TILES)]
    coloured = pictures.patchwork([look.colour for look in tiles], _TILE)
    grey = pictures.patchwork([look.grey for look in tiles], _TILE)
    return contents.Grey(
        method=options.fit.method,
        weights=tuple(weights) if weights else None,
        in_words=weights_in_words(weights)
        if weights
        else f"the conversion {options.fit.method}, which has no weights",
        benefit=summary["tried"]["in_words"] if summary["tried"] else "",
        tones_chosen=shares[0],
        tones_rec709=shares[1] if compared else (),
        patchwork_colour=pictures.picture(coloured, "the set in colour", 12 * _TILE),
        patchwork_grey=pictures.picture(grey, "the set in the chosen grey", 12 * _TILE),
    )


def _photographs(
    summary: Mapping[str, Any],
    grey_of: Mapping[str, str],
    looks: Mapping[str, _Look],
    model: model_view.ModelView | None,
) -> list[PhotographEntry]:
    left_out = {name: why.removeprefix(f"{name}: ") for name, why in summary["left_out"].items()}
    found = []
    in_model = set(model.names) if model else set()
    for name in sorted(grey_of):
        thumbnail = looks[name].thumbnail if name in looks else None
        if model and grey_of[name] in in_model:
            seen = model.seen(grey_of[name])
            found.append(PhotographEntry(name, thumbnail, seen.points, seen.error_px, seen.coverage))
        else:
            why = left_out.get(name) or ("it is not registered" if model else "")
            found.append(PhotographEntry(name, thumbnail, left_out=why))
    others = sorted(set(left_out) - set(grey_of))
    return [*found, *(PhotographEntry(name, None, left_out=left_out[name]) for name in others)]


def _cloud(project: Project, records: _Records, model: model_view.ModelView) -> contents.Cloud:
    kind = "dense" if records.get("dense", {}).get("points") else "sparse"
    dense_file = project.dense / "fused.ply"
    points = model.dense_points(dense_file, _POINTS) if kind == "dense" else model.points(_POINTS)
    grey = np.rint(points.colours @ np.array(_grey_weights(records))).astype(np.uint8)
    return contents.Cloud(points.positions, points.colours, grey, kind, points.in_all)


def _grey_weights(records: _Records) -> tuple[float, float, float]:
    """Return R, G, B of the grey of the set; of a conversion without weights, of Rec.709."""
    weights = next(iter(records["fit"]["weights"].values()))["weights"] or FIXED["rec709"]
    return (float(weights[0]), float(weights[1]), float(weights[2]))


def _frame(records: _Records, summary: Mapping[str, Any], model: model_view.ModelView) -> contents.ModelFrame:
    return contents.ModelFrame(*model.frame, summary.get("metric") is True, _grey_weights(records))


def _cameras(
    grey_of: Mapping[str, str], model: model_view.ModelView, looks: Mapping[str, _Look]
) -> list[contents.CameraPose]:
    poses = []
    for name, grey in sorted(grey_of.items()):
        if grey in model.names:
            picture = looks[name].larger if name in looks else None
            view = model.camera(grey)
            poses.append(
                contents.CameraPose(name, view.centre, view.corners, view.box, view.grid, picture, view.size)
            )
    return poses


def _slider(project: Project, name: str, grey_name: str) -> contents.Slider:
    colour = pictures.shrunk(read_colour(project.colour / grey_name), _SLIDER)
    chosen = pictures.shrunk(read_grey(project.grey / grey_name), _SLIDER)
    default = pictures.rec709(colour)
    looks = {
        f"{name} in colour": colour,
        f"{name} in the chosen grey": chosen,
        f"{name} in Rec.709": default,
        f"{name}: chosen grey less Rec.709, middle grey is none": pictures.difference(chosen, default),
    }
    return contents.Slider(name, *(pictures.picture(look, alt, _SLIDER) for alt, look in looks.items()))


def _spread(names: Sequence[str], most: int) -> list[str]:
    """Return at most so many of them, evenly spread."""
    return list(names[:: -(-len(names) // most)]) if names else []
