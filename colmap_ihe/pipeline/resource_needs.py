"""What the stages of a run will take of memory and disk, from what the survey of its photographs says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from colmap_ihe.colmap.features import features_bytes
from colmap_ihe.colmap.features_on_workers import extraction_options
from colmap_ihe.colmap.matching import choose_strategy, pairs_of
from colmap_ihe.colmap.pair_blocks import matches_bytes
from colmap_ihe.dense.backend import pick_backend
from colmap_ihe.dense.cost import ASPECT, dense_cost, pixels_within
from colmap_ihe.machine import memory
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.survey import Surveyed
from colmap_ihe.project.options import Options

_BASE = 600_000_000  # bytes of memory of any run: interpreter, libraries, memory that earlier stages freed and it keeps
_TABLE = 192_000_000  # of the fit: its tables of colours, here and in a decoder
_KEYPOINT = 160  # bytes on disk of a feature with its descriptor, of COLMAP's four floats, six or 128 bytes
_FEATURES = 1.6  # for each that COLMAP is asked for at the most, as it counts places and not directions
_FEATURES_A_PIXEL = 0.02  # of a small photograph
_MATCH = 4  # bytes on disk of a feature of an image, for a pair that overlaps
_PARTNERS = 25  # of an image that overlap it, at the most
_MODEL = 45  # bytes on disk of a feature, in the model
_POINTS_A_PIXEL = 0.15  # of the dense cloud
_FACE = 180  # bytes on disk of a face, in all files of the mesh; more than is there for a while of the cloud
_PAGE = 8_000_000
_MESHED, _FACED = 200, 4_500  # bytes of memory of the mesh, a point of the cloud and a face
_SHOWN, _DRAWN = 150, 75  # of the page, a point of the cloud and a pixel of the photographs of a pair
_HISTOGRAM, _MOST_HISTOGRAM = 0.05, 20_000_000  # bytes a pixel, and at all
_GREY_AND_COLOUR = {
    "png": {False: 2.9, True: 3.2},
    "tiff": {False: 4.1, True: 4.1},
    "jpeg": {False: 1.6, True: 2.0},
}
"""Bytes a pixel on disk, of photographs that are coded, or RAW and so with their noise. All measured with
`benchmarks/limits.py disk`, and so that what was measured lies below."""


@dataclass(frozen=True)
class PhotoSetSize:
    """A set of photographs. `largest` of them in pixels; `one_bytes` of memory that one takes while it is decoded."""

    images: int
    pixels: int
    largest: int
    raw: int
    with_gps: int
    one_bytes: int

    @classmethod
    def of(cls, record: dict[str, Any], captures: Sequence[Capture]) -> PhotoSetSize:
        """From the record of `captures`, and the photographs that it holds."""
        names = ("images", "pixels", "largest", "raw", "with_gps")
        return cls(**{name: int(record[name]) for name in names}, one_bytes=memory.needed(captures))

    @classmethod
    def of_survey(cls, surveyed: Sequence[Surveyed]) -> PhotoSetSize:
        captures = [replace(one.capture, pixels=one.width * one.height) for one in surveyed]
        return cls(
            images=len(captures),
            pixels=sum(c.pixels for c in captures),
            largest=max((c.pixels for c in captures), default=0),
            raw=sum(c.kind == "raw" for c in captures),
            with_gps=sum(one.metadata.has_gps for one in surveyed),
            one_bytes=memory.needed(captures),
        )


@dataclass(frozen=True)
class StageNeeds:
    """Of a stage. `base_bytes` of memory and `one_bytes` for each of its workers; `disk_bytes` that it writes.
    `more_bytes` of memory it takes besides where there are so many."""

    stage: str
    base_bytes: int
    one_bytes: int
    disk_bytes: int
    more_bytes: int = 0

    def memory_bytes(self, workers: int) -> int:
        return self.base_bytes + self.one_bytes * workers


def needs_of(options: Options, photographs: PhotoSetSize) -> list[StageNeeds]:
    """Of every stage that is not switched off, in their order, and of the page."""
    images, pixels = photographs.images, photographs.pixels
    share_raw = photographs.raw / max(1, images)
    of_format = _GREY_AND_COLOUR[options.convert.format]
    side = (photographs.largest * ASPECT) ** 0.5
    largest = (max(1, round(side)), max(1, round(side / ASPECT)))
    features = _features_of(options, pixels / max(1, images))
    pairs = pairs_of(choose_strategy(options.matches.strategy, images, images), images)
    found = [
        StageNeeds("captures", _BASE, photographs.one_bytes, 0),
        StageNeeds(
            "fit", _BASE + _TABLE, photographs.one_bytes, min(_MOST_HISTOGRAM, round(_HISTOGRAM * pixels))
        ),
        StageNeeds(
            "convert",
            _BASE,
            photographs.one_bytes,
            round(pixels * (of_format[True] * share_raw + of_format[False] * (1 - share_raw))),
        ),
        StageNeeds(
            "features",
            _BASE,
            features_bytes([largest], options.features, 1),
            round(images * features * _KEYPOINT),
        ),
        StageNeeds(
            "matches",
            _BASE + 10_000 * images,
            matches_bytes(round(features), images),
            round(min(pairs, _PARTNERS * images) * features * _MATCH),
        ),
        StageNeeds("sparse", _BASE + round(400 * features * images), 0, round(images * features * _MODEL)),
    ]
    if options.dense.enabled:
        found += _dense(options, largest, photographs)
    points = _POINTS_A_PIXEL * _seen(options, photographs) if options.dense.enabled else 0.0
    found.append(
        StageNeeds("page", _BASE + round(_SHOWN * points), round(_DRAWN * photographs.largest), _PAGE)
    )
    return found


def _features_of(options: Options, pixels: float) -> float:
    """About how many features COLMAP finds in an image."""
    most: int = extraction_options(options.features).sift.max_num_features
    return min(_FEATURES * most, _FEATURES_A_PIXEL * pixels)


def _dense(options: Options, largest: tuple[int, int], photographs: PhotoSetSize) -> list[StageNeeds]:
    size, backend = options.dense.max_image_size, pick_backend(options.dense.backend)
    one = dense_cost([largest], size, backend, 1, 0)
    seen = _seen(options, photographs)
    every = dense_cost([(round((seen * ASPECT) ** 0.5), round((seen / ASPECT) ** 0.5))], 10**9, backend, 1, 0)
    found = [StageNeeds("dense", _BASE, one.memory_bytes, every.disk_bytes, every.fusion_bytes)]
    if options.meshed:
        points = _POINTS_A_PIXEL * seen
        faces = min(options.mesh.faces, 1.5 * points)
        found.append(
            StageNeeds("mesh", _BASE + round(_MESHED * points + _FACED * faces), 0, round(faces * _FACE))
        )
    return found


def _seen(options: Options, photographs: PhotoSetSize) -> float:
    """Pixels that dense stereo looks at."""
    return pixels_within(options.dense.max_image_size, photographs.images, photographs.pixels)
