"""Find coded targets in all photographs of a model, and say which sights are left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import ProjectError
from colmap_ihe.machine import memory
from colmap_ihe.machine.executor import in_order, threads_of, width_of
from colmap_ihe.machine.progress import SILENT, Progress
from colmap_ihe.machine.words import listed
from colmap_ihe.survey.observations import Observation
from colmap_ihe.survey.targets import DEFAULT_DICTIONARY, Target, find_targets
from colmap_ihe.survey.triangulate import Triangulation

UNIT = "photographs searched for targets"
_LEAST_ACCURACY_PX = 0.05  # no print is flat, and no lens known, to less
BYTES_A_PIXEL = 12
"""Memory for a picture that is searched."""


@dataclass(frozen=True)
class SetTargets:
    """Hold where targets are seen, and by image the names of those that it shows more than once, which are not among
    the observations."""

    observations: tuple[Observation, ...]
    twice: Mapping[str, tuple[str, ...]]


def targets_of_set(
    model: pycolmap.Reconstruction,
    greys: Path,
    executor: Executor,
    dictionary: str = DEFAULT_DICTIONARY,
    progress: Progress = SILENT,
) -> SetTargets:
    """Return where the registered photographs of a model show targets, from their grey images in the folder `greys`:
    these have all pixels of the photographs, in the grid that COLMAP calibrates. Raises `ProjectError` for a grey that
    cannot be read, `OptionError` for an unknown dictionary."""
    images = sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: str(image.name))
    cameras = {str(image.name): model.cameras[image.camera_id] for image in images}
    largest = max((camera.width * camera.height for camera in cameras.values()), default=0)
    search = partial(_search, greys, dictionary, cameras)
    observations: list[Observation] = []
    twice: dict[str, tuple[str, ...]] = {}
    progress.start(len(cameras), UNIT)
    with threads_of(executor) as threads:
        workers = memory.workers_for("the search for targets", BYTES_A_PIXEL * largest, width_of(threads))
        at_once = None if workers == width_of(threads) else workers
        for name, targets in zip(cameras, in_order(threads, search, cameras, at_once, progress), strict=True):
            counts = Counter(target.name for target in targets)
            doubled = tuple(target for target, count in counts.items() if count > 1)
            if doubled:
                twice[name] = doubled
            observations += [_observation(name, target) for target in targets if counts[target.name] == 1]
            progress.advance()
    return SetTargets(tuple(observations), twice)


def _search(greys: Path, dictionary: str, cameras: Mapping[str, pycolmap.Camera], name: str) -> list[Target]:
    bitmap = pycolmap.Bitmap.read(greys / name, as_rgb=False)
    if bitmap is None:
        raise ProjectError(f"{greys / name} cannot be read as an image", hint="run again with --from convert")
    values = np.ascontiguousarray(bitmap.to_array())
    camera = cameras[name]
    if values.shape[:2] != (camera.height, camera.width):
        raise ProjectError(
            f"{greys / name} has {values.shape[1]} x {values.shape[0]} pixels, its camera"
            f" {camera.width} x {camera.height}",
            hint="run again with --from convert",
        )
    return find_targets(values.reshape(values.shape[:2]), dictionary, camera)


def _observation(image: str, target: Target) -> Observation:
    x, y = target.centre_px
    return Observation(image, target.name, x, y, max(_LEAST_ACCURACY_PX, target.deviation_px))


def left_out_in_words(found: SetTargets, triangulated: Triangulation) -> list[str]:
    """Return a sentence for each target that has no place in the model, that a photograph shows more than once, or that
    disagrees in some photographs."""
    sentences = []
    for name in sorted({name for names in found.twice.values() for name in names}):
        images = [image for image, names in found.twice.items() if name in names]
        sentences.append(
            f"target {name} is seen more than once in {listed(images, 3)} and left out there: each target must be"
            " there only once"
        )
    for name, reason in triangulated.not_located.items():
        sentences.append(f"target {name} has no place in the model: {reason}")
    for name, point in triangulated.points.items():
        reasons = [f"{image} ({reason})" for image, reason in point.left_out.items()]
        if reasons:
            sentences.append(f"target {name} disagrees in {listed(reasons, 3)} and is left out there")
    return sentences
