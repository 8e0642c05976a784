"""Say why photographs give no model, and what is doubtful about one, in sentences for its owner."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from colmap_ihe.colmap.checks.camera_motion import Motion, motions_of
from colmap_ihe.colmap.checks.plausibility import FLAT, Shape, SolvedCamera, cameras_of, shape_of
from colmap_ihe.colmap.checks.repeated_structure import Conflicts, conflicts_of
from colmap_ihe.colmap.mapping import ModelStatistics
from colmap_ihe.colmap.matching import EXHAUSTIVE_UP_TO
from colmap_ihe.colmap.measures import putative_and_inliers
from colmap_ihe.machine.words import listed

FOCAL_FACTOR = 1.15
"""Between a focal length found and that of EXIF: 1.05 at most in the sound sets of docs/degenerate.md."""
ASPECT_FACTOR = 1.05
"""Of a camera's focal lengths across and down: 1.02 at most there, and no real camera has another than 1."""
FOUND_AGAIN = 0.22
"""Share of features that match in the photograph most like theirs: 0.09 to 0.75 in sound sets, 0.20 before a crowd."""
TURNED_TO = 45.0
"""Degrees between the directions of two photographs of a wall, from which on it tells their focal length."""
SAME_PLACE = 0.1
"""Degrees between rays to one point of two photographs of one view."""
_TO_BEGIN_WITH = 100  # verified matches; COLMAP looks for so many first, init_min_num_inliers

Advice = tuple[str, str]
"""What was seen, and what to do."""


def why_no_match(database: Path, by_grey: Mapping[str, str], images: int) -> Advice:
    """Say why no pair was verified, and what to do. `by_grey`: photographs by the names of their grey images."""
    best = max(((n, *pair) for pair, (n, _) in putative_and_inliers(database).items()), default=None)
    said = f"no two of the {images} photographs match"
    if best is not None and best[0]:
        first, second = by_grey[best[1]], by_grey[best[2]]
        shared = f"share {best[0]} putative matches and no geometry"
        said += f": {first} and {second}, which are most alike, {shared}"
    return said, (
        "neighbours have to overlap by about two thirds; check that all show one object, sharp and not too"
        " dark, and that nothing was taken between them that is not here"
    )


def why_no_model(database: Path, images: int) -> Advice:
    """Say why pairs were verified and no photograph was registered, and what to do."""
    said = f"none of the {images} photographs could be registered"
    motions = motions_of(database)
    turned = [m for m in motions if m.only_turned]
    matching = "the only pair that matches" if len(motions) == 1 else f"the {len(motions)} pairs that match"
    if motions and all(m.parallax < SAME_PLACE and m.turn < SAME_PLACE for m in motions):
        return f"{said}: those that match show the same view from the same place", (
            "depth shows only from two places: step sideways between photographs, by about a tenth of the distance"
        )
    if len(turned) > len(motions) / 2:
        several = "in" if len(turned) == len(motions) else f"in {len(turned)} of"
        return f"{said}: {several} {matching} the camera only turned on the spot", (
            "a panorama holds no depth: step sideways between photographs, by about a tenth of the distance, and keep"
            " what they show"
        )
    most = max((m.matches for m in motions), default=0)
    if most < _TO_BEGIN_WITH:
        return (
            f"{said}: of {matching} the best shares {most} verified matches, which is little to begin a model with",
            "more overlap, sharper photographs, masks over what moved (people, foliage, water)",
        )
    return said, "photographs need overlap and the camera must move sideways between them, not only turn"


def gps_warnings(without_fix: Sequence[str], images: int) -> list[str]:
    """Warn of photographs that spatial matching could say nothing of, of so many `images`."""
    if not without_fix:
        return []
    others = "all others" if images <= EXHAUSTIVE_UP_TO else "those that look like them"
    return [
        f"{len(without_fix)} of {images} photographs have no GPS fix of their own, or none near another's, and were"
        f" compared with {others}: {listed(without_fix)}"
    ]


def model_warnings(
    models: Sequence[ModelStatistics],
    folder: Path,
    database: Path,
    by_grey: Mapping[str, str],
    missing: Sequence[str],
    found_again: float,
) -> list[str]:
    """Say what is doubtful about the `models` in `folder`. `by_grey`: photographs by the names of their grey images;
    `missing`: those without a place in the largest model; `found_again`: as in `MatchCounts`."""
    largest = folder / "0"
    cameras = cameras_of(largest, database)
    return [
        *_split(models, by_grey),
        *_without_a_place(models, database, by_grey, missing),
        *few_found_again(found_again, missing),
        *fold_warnings(conflicts_of(largest, database), by_grey),
        *camera_warnings(cameras, by_grey),
        *flat_warnings(shape_of(largest), cameras),
    ]


def _split(models: Sequence[ModelStatistics], by_grey: Mapping[str, str]) -> list[str]:
    if len(models) == 1:
        return []
    placed = set(models[0].image_names)
    parts = []
    for i, model in enumerate(models[1:], start=1):
        new = sorted(by_grey[n] for n in model.image_names if n not in placed)
        parts.append(f"workspace/sparse/{i} has {model.registered_images} images, {listed(new)} among them")
    return [
        f"the photographs fell into {len(models)} models; the largest, of {models[0].registered_images} images, goes"
        f" on; {'; '.join(parts)}: more photographs between the parts would join them"
    ]


def _without_a_place(
    models: Sequence[ModelStatistics], database: Path, by_grey: Mapping[str, str], missing: Sequence[str]
) -> list[str]:
    elsewhere = {by_grey[n] for model in models[1:] for n in model.image_names}
    lost = [name for name in missing if name not in elsewhere]
    if not lost:
        return []
    placed = set(models[0].image_names)
    best: dict[str, Motion] = {}
    for motion in motions_of(database):  # those with most matches come first
        for one, other in ((motion.first, motion.second), (motion.second, motion.first)):
            if other in placed:
                best.setdefault(by_grey[one], motion)
    alone = [n for n in lost if n not in best]
    turned = [n for n in lost if n in best and best[n].only_turned]
    weak = [n for n in lost if n in best and not best[n].only_turned]
    reasons = []
    if alone:
        reasons.append(f"{listed(alone)}: no verified matches with any that has one")
    if turned:
        reasons.append(f"{listed(turned)}: the camera only turned, and did not move sideways")
    if weak:
        least, most = (f(best[n].matches for n in weak) for f in (min, max))
        count = f"at most {most}" if least == most else f"at most {least} to {most}"
        reasons.append(f"{listed(weak)}: {count} verified matches with any that has one, or none that agree")
    return [f"{len(lost)} of {len(by_grey)} photographs are not registered. {'; '.join(reasons)}"]


def few_found_again(found_again: float, missing: Sequence[str]) -> list[str]:
    """Say that few features are found again where photographs are `missing` from the model, for it may be why.

    A low share alone is no fault: it falls with the overlap, the angle, fine texture and the number of features too,
    in still scenes, and a model that has all photographs is none the worse for it.
    """
    if not missing or found_again >= FOUND_AGAIN:
        return []
    return [
        f"only {100 * found_again:.0f} % of a photograph's features are found again in the one most like it, which may"
        " be why photographs are missing from the model: they overlap little, the light was another, or"
        " something moved (people, foliage, water), which masks keep out (docs/dense.md)"
    ]


def fold_warnings(found: Conflicts, by_grey: Mapping[str, str]) -> list[str]:
    """Warn where like parts of the object were, or may have been, taken for one."""
    advice = (
        "take photographs that show unlike parts together, mask what is repeated, or match neighbours only, if names"
        " are in order, by `--set matches.strategy=sequential --set matches.pairing.overlap=2 --set"
        " matches.pairing.quadratic_overlap=false`"
    )
    if found.many_blind:
        first, second, share = found.blind[0]
        return [
            f"like parts of the object were taken for one and the model is folded, as {len(found.blind)} of"
            f" {found.near} pairs show that it puts side by side: {by_grey[first]} and {by_grey[second]} share only"
            f" {100 * (1 - share):.0f} % of what both should see. Do not measure in it: {advice}"
        ]
    if found.many_torn:
        first, second, count = found.torn[0]
        return [
            f"the object has like parts, and the model may be folded: {len(found.torn)} of {found.matched} pairs match"
            f" well and are at different places in it. See whether {by_grey[first]} and {by_grey[second]} ({count}"
            f" matches) show the same place: if they do, do not measure in it, and {advice}"
        ]
    return []


def camera_warnings(cameras: Sequence[SolvedCamera], by_grey: Mapping[str, str]) -> list[str]:
    """Warn where a model has cameras that cannot be, or others than the photographs say."""
    warnings = []
    for camera in cameras:
        who = f"{len(camera.images)} photographs ({listed([by_grey[n] for n in camera.images])})"
        if max(camera.aspect, 1 / camera.aspect) > ASPECT_FACTOR:
            warnings.append(
                f"the camera of {who} came out with focal lengths that differ by a factor of"
                f" {max(camera.aspect, 1 / camera.aspect):.2f} across and down, which no camera has: the model is"
                f" stretched. Photographs on a straight line that all look the same way do not tell a focal length:"
                f" add some that are turned to the side, or {_hold(camera)}"
            )
        elif camera.prior and not 1 / FOCAL_FACTOR < camera.focal / camera.prior < FOCAL_FACTOR:
            warnings.append(
                f"the focal length of {who} came out {camera.focal / camera.prior:.2f} times what they say"
                f" ({camera.focal:.0f} px, not {camera.prior:.0f}): if EXIF is wrong, as after a crop or with a lens"
                " without contacts, give the true one in `cameras:` with override; if it is right, the model is"
                f" stretched: add photographs that are turned to the side, or {_hold(camera)}"
            )
    return warnings


def _hold(camera: SolvedCamera) -> str:
    held = "hold the focal length by `--set sparse.colmap.ba_refine_focal_length=false`"
    return held if camera.prior else f"give the focal length (docs/options.md) and {held}"


def flat_warnings(shape: Shape, cameras: Sequence[SolvedCamera]) -> list[str]:
    if shape.thickness >= FLAT or shape.turned >= TURNED_TO or not cameras:
        return []
    unknown = next((camera for camera in cameras if not camera.prior), cameras[0])
    return [
        f"all points lie within {max(0.1, 100 * shape.thickness):.1f} % of one plane, and all photographs look much the"
        " same way: that hardly tells focal lengths, and the model may be bent a little; add photographs that are"
        f" turned by 45 degrees and more, or that show something before the wall, or {_hold(unknown)}"
    ]
