"""Match the features of pairs of images and verify the matches."""

from __future__ import annotations

from dataclasses import asdict

from colmap_ihe.colmap import matching
from colmap_ihe.colmap.matching import choose_strategy, pairs_of
from colmap_ihe.colmap.pair_blocks import matches_bytes
from colmap_ihe.errors import MappingError
from colmap_ihe.machine.progress import Progress
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.pipeline.resource_needs import BASE_BYTES, Known, PhotoSetSize, StageNeeds
from colmap_ihe.pipeline.stage import Count, RunContext, Stage, StageRecord
from colmap_ihe.pipeline.stages.features import FEWER_FEATURES, features_an_image
from colmap_ihe.pipeline.warnings import model as model_warnings
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options

_MATCH = 4  # bytes on disk of a feature of an image, for a pair that overlaps
_PARTNERS = 25  # images that overlap one, at the most


class MatchesRecord(StageRecord):
    """Count pairs of images with verified matches, and these (inliers)."""

    strategy: str
    pairs_verified: Count
    inliers: Count


def run(run: RunContext, progress: Progress) -> MatchesRecord:
    """Match and verify the pairs that the strategy chooses."""
    project = run.project
    images = run.records["features"]["images"]
    try:
        counts = matching.match_features(
            project.database,
            project.workspace,
            run.options.matches,
            images,
            run.executor,
            progress,
        )
    except MappingError as error:
        reason, hint = model_warnings.why_no_match(project.database, run.photographs_by_grey(), images)
        raise MappingError(reason, hint) from error
    by_grey = run.photographs_by_grey()
    warnings = model_warnings.gps_warnings([by_grey[name] for name in counts.without_fix], images)
    return MatchesRecord(**asdict(counts), warnings=warnings)


def _remove(project: Project) -> None:
    if project.database.exists():
        matching.forget_matches(project.database)


def _check(options: Options, images: int) -> None:
    with_gps = images  # not known yet: spatial without GPS is refused when its turn comes
    strategy = choose_strategy(options.matches.strategy, images, with_gps)
    matching.native_options(options.matches, strategy)


def _needs(options: Options, size: PhotoSetSize) -> StageNeeds:
    images, features = size.images, features_an_image(options, size)
    pairs = pairs_of(choose_strategy(options.matches.strategy, images, images), images)
    memory = matches_bytes(round(features), images)
    disk = round(min(pairs, _PARTNERS * images) * features * _MATCH)
    return StageNeeds("matches", BASE_BYTES + 10_000 * images, memory, disk, saves=FEWER_FEATURES)


def _parts(options: Options, known: Known) -> list[Part]:
    images = known.images
    pairs = pairs_of(choose_strategy(options.matches.strategy, images, known.with_gps), images)
    return [Part("matches", "pairs", 0.12 * pairs * known.features / images / 10_000)]


STAGE = Stage(
    "matches",
    run,
    MatchesRecord,
    sections=("matches",),
    files=lambda project, record: [project.database],
    remove=_remove,
    is_sound=lambda project: True,  # `features` looks at the database that both fill
    check=_check,
    needs=_needs,
    parts=_parts,
)
