"""Calibrate the cameras of a model: choose what is free, adjust all, and triangulate anew by the cameras found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from colmap_ihe.colmap.calibration.block import Block, Part, part_of, thinned
from colmap_ihe.colmap.calibration.choose import Chooser, Fit
from colmap_ihe.colmap.calibration.covisible import covisible
from colmap_ihe.colmap.calibration.deviations import Deviations, deviations_of
from colmap_ihe.colmap.calibration.freedom import Freedom, Lens, plain
from colmap_ihe.colmap.calibration.held_out import HeldOut, held_out
from colmap_ihe.colmap.calibration.rebuild import Triangulation, adjust_poses, give, triangulate
from colmap_ihe.colmap.calibration.sharing import focal_lengths, groups_of
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine import threads
from colmap_ihe.machine.progress import SILENT, Progress

FEWEST = 3
"""Photographs by a camera from which on it is calibrated: with two, no point is seen once more than it takes."""
FEWEST_POINTS = 60
"""Points of a model from which on its cameras are calibrated."""
MOST_IMAGES = 200
"""Images adjusted together here. In larger models COLMAP adjusts the poses to the cameras that these gave."""
_MOST_LENSES = 8
_POINTS_AN_IMAGE = 600  # that cameras and poses are adjusted by, those that most images see
_TO_CHOOSE = 1_500  # points that the choice is made by
_CHANGED = 0.01  # of the observations, from which on what was triangulated anew counts
_OTHER_LENS = 1.4  # times the error, where COLMAP's model could not show the lens


@dataclass(frozen=True)
class Known:
    """Hold what is known before: all cameras of the database by id, those that are `held`, those only `assumed` to have
    taken all their images, what others have free to begin with (`starts`), pairs of `partners` that are one camera
    whose pictures an editor turned, whether the user gave the cameras' model (`given_model`), and whether to check that
    cameras without a focal length from EXIF took all their images (`check_shared`)."""

    cameras: Mapping[int, pycolmap.Camera] = field(default_factory=dict)
    held: frozenset[int] = frozenset()
    assumed: frozenset[int] = frozenset()
    starts: Mapping[int, Freedom] = field(default_factory=dict)
    partners: Sequence[tuple[int, int]] = ()
    given_model: bool = False
    check_shared: bool = False


@dataclass(frozen=True)
class Calibration:
    """Say what came of a calibration: by camera id what was freed and how sure it is; the gain by points held out; and
    whether COLMAP's own model could not show a lens (`other_lens`): then mapping by the cameras found places more."""

    freedoms: Mapping[int, Freedom]
    deviations: Mapping[int, Deviations]
    gain: HeldOut
    other_lens: bool


@dataclass(frozen=True)
class Apart:
    """Hold images, by name, in groups of one focal length each, whose camera was only assumed to have taken them."""

    groups: list[list[str]]


def calibrate(
    model: pycolmap.Reconstruction, known: Known, triangulation: Triangulation, progress: Progress = SILENT
) -> Calibration | Apart | None:
    """Change cameras, poses and points of a model to what its observations say of its lenses. None where no camera took
    enough photographs or too many points are wrong; and `Apart` where a camera clearly did not take all of its own.
    Nothing was changed then, nor where equations have no solution (raises `LinAlgError`). Raises `Cancelled`."""
    camera_ids = sorted({model.images[i].camera_id for i in model.reg_image_ids()})
    if any(model.cameras[i].is_spherical() for i in camera_ids):
        return None  # a panorama has no focal length
    lenses = lenses_of(model, camera_ids, known)
    free = [number for number, lens in enumerate(lenses) if lens.freedom]
    image_ids = covisible(model, [[camera_ids[c] for c in lenses[n].cameras] for n in free], MOST_IMAGES)
    part = part_of(model, image_ids, camera_ids)
    if not free or len(part.block.points) < FEWEST_POINTS:
        return None
    known_cameras = [known.cameras[i] for i in camera_ids]
    chooser = Chooser(_thinned(part, _TO_CHOOSE), known_cameras, progress)
    progress.start(len(free) + 2, "calibration steps")
    with threads.limited(1):  # the matrices are small; and one thread gives the same to the bit
        as_mapped = [model.cameras[i] for i in camera_ids]
        base = chooser.again(chooser.fit(chooser.block, lenses, as_mapped, most=0))
        progress.advance()
        if len(base.adjusted.block.points) < FEWEST_POINTS // 2:
            return None
        best, number = base, 0
        while number < len(best.lenses):  # a lens whose pictures were turned may become two
            best = _calibrated(chooser, best, number, known.given_model)
            progress.advance(number in free)
            number += 1
        assumed = [camera_ids.index(i) for i in sorted(known.assumed) if i in camera_ids]
        # Not what only COLMAP's model sees, of a lens that it cannot show; nor as the richer one, which bent to them.
        groups = _apart(base, assumed, progress) if _apart(best, assumed, progress) else []
        if groups:
            return Apart([[str(model.images[image_ids[i]].name) for i in group] for group in groups])
        gain = held_out(chooser, base, best)
        other_lens = base.adjusted.sigma > _OTHER_LENS * best.adjusted.sigma
        best = base if gain.worse else best
        if as_colmap_has_them(model, camera_ids, best.lenses):
            final, before = _as_it_is(model, part, best.lenses)
        else:
            final = _finish(model, part, best, chooser, triangulation, not known.given_model, progress)
            before = known_cameras
        deviations = deviations_of(final, before)
    progress.advance()
    by_id = {camera_ids[c]: lens.freedom for lens in final.lenses if lens.freedom for c in lens.cameras}
    return Calibration(
        by_id, {i: deviations[camera_ids.index(i)] for i in by_id}, gain, other_lens and not gain.worse
    )


def _apart(fit: Fit, assumed: Sequence[int], progress: Progress) -> list[list[int]]:
    """Return the images of the block, by number, in groups, of each camera by its place that took several groups."""
    counts = np.bincount(fit.adjusted.block.cameras, minlength=len(fit.cameras))
    several = [
        groups
        for camera in assumed
        if counts[camera] >= FEWEST and len(groups := groups_of(*focal_lengths(fit, camera, progress))) > 1
    ]
    return [[one.image for one in group] for groups in several for group in groups]


def lenses_of(model: pycolmap.Reconstruction, camera_ids: Sequence[int], known: Known) -> tuple[Lens, ...]:
    """Return the lenses of a model's cameras, free as COLMAP has them; not free those that are held, and those with
    too few photographs."""
    images = [model.images[i].camera_id for i in model.reg_image_ids()]
    partner = {a: b for a, b in known.partners if a in camera_ids and b in camera_ids}
    lenses = []
    for camera_id in camera_ids:
        if camera_id in partner.values():
            continue
        together = [camera_id, *([partner[camera_id]] if camera_id in partner else [])]
        enough = sum(images.count(i) for i in together) >= FEWEST and not known.held & set(together)
        places = tuple(camera_ids.index(i) for i in together)
        freedom = known.starts.get(camera_id, plain(model.cameras[camera_id])) if enough else None
        lenses.append(Lens(places, (0, 1)[: len(places)], freedom))
    counts = {lens: sum(images.count(camera_ids[c]) for c in lens.cameras) for lens in lenses if lens.freedom}
    kept = set(sorted(counts, key=lambda lens: (-counts[lens], lens.cameras))[:_MOST_LENSES])
    return tuple(lens if lens in kept else replace(lens, freedom=None) for lens in lenses)


def _calibrated(chooser: Chooser, start: Fit, number: int, given_model: bool) -> Fit:
    start = chooser.turned(start, number)
    if given_model:  # the user's choice; its principal point is not
        return chooser.climb(start, number, steps=False)
    return chooser.chosen(start, number)


def _thinned(part: Part, most: int) -> Block:
    return part.block.of_points(thinned(part.block, most))


def as_colmap_has_them(
    model: pycolmap.Reconstruction, camera_ids: Sequence[int], lenses: Sequence[Lens]
) -> bool:
    """Tell whether nothing of the lenses is free but what COLMAP frees of the cameras of a model: then they are as
    good as after another adjustment of the same."""
    return all(
        lens.freedom is None
        or (len(lens.cameras) == 1 and lens.freedom == plain(model.cameras[camera_ids[lens.cameras[0]]]))
        for lens in lenses
    )


def _as_it_is(
    model: pycolmap.Reconstruction, part: Part, lenses: tuple[Lens, ...]
) -> tuple[Fit, list[pycolmap.Camera]]:
    """Return the fit of a model as it stands, and its cameras without a focal length from EXIF, which COLMAP does not
    weigh."""
    block = _thinned(part, _POINTS_AN_IMAGE * len(part.image_ids))
    cameras = [copy(model.cameras[i]) for i in part.camera_ids]
    for camera in cameras:
        camera.has_prior_focal_length = False
    return Chooser(block, cameras).fit(block, lenses, cameras, most=0), cameras


def _finish(
    model: pycolmap.Reconstruction,
    part: Part,
    best: Fit,
    chooser: Chooser,
    triangulation: Triangulation,
    steps: bool,
    progress: Progress,
) -> Fit:
    """Adjust the images by many points, by which what is free is chosen once more, in the models of the lenses without
    `steps`, and rebuild the model; adjusted once more where that brought other observations."""
    whole = len(part.image_ids) == model.num_reg_images()
    for rebuilt in (False, True):
        if rebuilt:
            part = part_of(model, part.image_ids, part.camera_ids)
        block = _thinned(part, _POINTS_AN_IMAGE * len(part.image_ids))
        try:
            larger = replace(chooser, block=block)
            best = larger.again(best)
            if not rebuilt:  # of more points it takes less to see a coefficient
                for number in range(len(best.lenses)):
                    best = larger.climb(best, number, steps)
        except np.linalg.LinAlgError:
            if rebuilt:  # the model is one of these cameras
                break
            raise
        observations = model.compute_num_observations()
        give(model, part, best.cameras, best.adjusted.block, best.adjusted.sigma)
        progress.check()
        if not whole:
            adjust_poses(model, progress, triangulation.threads)
        triangulate(model, triangulation, progress)
        progress.check()
        if abs(model.compute_num_observations() - observations) < _CHANGED * observations:
            break
    return best
