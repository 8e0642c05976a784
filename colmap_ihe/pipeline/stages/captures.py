"""Survey the photographs: sizes, EXIF, and how each RAW file is developed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.discover import Discovery
from colmap_ihe.photographs.each import refused
from colmap_ihe.photographs.raw.denoise import require_wavelets
from colmap_ihe.photographs.recipes import recipe_notes, with_recipes
from colmap_ihe.photographs.survey import survey
from colmap_ihe.pipeline.input_digests import FRAMES
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stage import Count, Inputs, Record, RunContext, Stage, StageRecord, require_plain
from colmap_ihe.pipeline.warnings import photographs as set_warnings
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.project.recipe import FILES, recipe_from_dict


def _require_recipe(values: dict[str, Any]) -> dict[str, Any]:
    """Check a recipe as `Recipe.identity` writes it: files are named without a folder, no cache folder is named."""
    recipe = recipe_from_dict(values)
    if recipe.cache_folder or not all(
        isinstance(v, str | bool | int | float | tuple) for v in vars(recipe).values()
    ):
        raise ValueError("is no recipe of a record")
    for name in FILES:
        if name in values:
            require_plain(values[name])
    return values


class CapturesRecord(StageRecord):
    """Count the photographs that can be used; `pixels` of all, `largest` of one; `recipes` by photograph; `taken`: when
    each was, as EXIF writes it, of those that say it."""

    images: Count
    raw: Count = 0
    paired: dict[str, Any] = Field(default_factory=dict)
    pixels: Count
    largest: Count
    with_gps: Count
    of_one_camera: Count = 1
    recipes: dict[str, Annotated[dict[str, Any], AfterValidator(_require_recipe)]]
    development: dict[str, Any] = Field(default_factory=dict)
    ignored: list[Any] = Field(default_factory=list)
    taken: dict[str, str] = Field(default_factory=dict)
    left_out: dict[str, str]


def run(run: RunContext, progress: Progress) -> CapturesRecord:
    """Survey the photographs and note how each is developed."""
    cameras, project = run.options.cameras, run.project
    refused_files = refused(run.discovery.refused, run.strict)
    surveyed, left_out = survey(
        run.discovery.captures,
        run.executor,
        progress,
        strict=run.strict,
        cameras=cameras,
        refused=refused_files,
    )
    prepared = with_recipes(
        surveyed,
        run.options.develop,
        project.calibration,
        project.masters,
        run.executor,
        progress,
        strict=run.strict,
    )
    run.surveyed = [replace(s, capture=run.kept(s.capture)) for s in prepared.surveyed]
    recipes = {name: dict(recipe) for name, recipe in recipe_notes(run.surveyed).items()}
    _remove_masters(project, recipes)
    sizes = Counter((s.metadata.make, s.metadata.model, s.width, s.height) for s in run.surveyed)
    return CapturesRecord(
        images=len(run.surveyed),
        raw=sum(s.capture.kind == "raw" for s in run.surveyed),
        paired={s.capture.name: list(s.capture.paired) for s in run.surveyed if s.capture.paired},
        with_gps=sum(s.metadata.has_gps for s in run.surveyed),
        of_one_camera=max(sizes.values()),
        pixels=sum(s.capture.pixels for s in run.surveyed),
        largest=max(s.capture.pixels for s in run.surveyed),
        development=prepared.steps,
        recipes=recipes,
        ignored=list(run.discovery.ignored),
        taken={s.capture.name: s.metadata.taken for s in run.surveyed if s.metadata.taken},
        left_out=left_out,
        warnings=[
            *set_warnings.copies(run.surveyed, run.contents),
            *set_warnings.odd_sizes(run.surveyed, sizes),
            *set_warnings.warnings_of(run.surveyed, run.discovery.ignored, run.discovery.notes),
            *prepared.warnings,
            *set_warnings.camera_warnings(cameras, run.surveyed, left_out),
        ],
    )


def _inputs(
    project: Project, options: Options, discovery: Discovery, digests: Mapping[str, Sequence[Any]]
) -> Inputs:
    frames = {
        name.removeprefix(FRAMES): values for name, values in digests.items() if name.startswith(FRAMES)
    }
    return {
        "photographs": {c.name: str(digests[c.name][-1]) for c in discovery.captures},
        "names of grey images": {c.name: c.grey_stem for c in discovery.captures},
        "JPEG files beside RAW": {c.name: ", ".join(c.paired) for c in discovery.captures if c.paired},
        "calibration frames": {name: str(values[-1]) for name, values in frames.items()},
    }


def _files(project: Project, record: Record) -> list[Path]:
    return [project.masters / name for name in sorted(_master_names(record["recipes"]))]


def _remove_masters(project: Project, recipes: Mapping[str, Mapping[str, Any]]) -> None:
    """Remove means of calibration frames that no recipe names any more."""
    for file in project.masters.glob("*.npy"):
        if file.name not in _master_names(recipes):
            file.unlink()


def _master_names(recipes: Mapping[str, Mapping[str, Any]]) -> set[str]:
    return {recipe[key] for recipe in recipes.values() for key in FILES if key in recipe}


def _check(options: Options, images: int) -> None:
    if options.develop.denoise > 0:
        require_wavelets()


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    return StageNeeds("captures", BASE_BYTES, size.one_bytes, 0)


STAGE = Stage(
    "captures",
    run,
    CapturesRecord,
    sections=("develop", "cameras"),
    libraries=("rawpy", "libraw"),
    inputs=_inputs,
    files=_files,
    check=_check,
    needs=_needs,
)
