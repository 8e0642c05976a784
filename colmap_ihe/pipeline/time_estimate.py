"""What the parts of the road are expected to take, from what is known of the set; see `benchmarks/remaining.py`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from colmap_ihe.colmap.matching import choose_strategy, pairs_of
from colmap_ihe.dense.backend import pick_backend
from colmap_ihe.dense.cost import pixels_within
from colmap_ihe.machine.remaining_time import Part
from colmap_ihe.project.options import Options

_COLMAPS_LARGEST = 3200  # pixels along the longer side, of images in which features are sought
_FEATURES = 12_000  # of a megapixel, and at the most of a photograph
_INLIERS = 0.7  # for each feature, in pairs that overlap as they do in most sets
_FEWER = 0.15  # of photographs by many cameras, as those of tourists
_MANY = 4  # times as many photographs as the most that one camera took
_ENOUGH = 0.4  # inliers for each feature: with fewer, photographs see so much less of each other
_POINTS = 0.1  # of the dense cloud, for each pixel with depth
_RAW = 10  # times as long to decode


@dataclass(frozen=True)
class Known:
    """What is known of a set, or likely where the stages have not come so far: `pixels` and `raw_pixels` of all
    photographs, features of all images, inliers of all pairs, images in the model and points of the dense cloud."""

    images: int
    pixels: int
    raw_pixels: int
    with_gps: int
    features: int
    inliers: int
    registered: int
    points: int | None = None

    @classmethod
    def from_records(cls, records: Mapping[str, Mapping[str, Any]]) -> Known:
        """Of the records of the stages that are done, `captures` at least."""
        first = records["captures"]
        images, pixels = first["images"], first["pixels"]
        likely = int(min(images * _FEATURES, pixels / 1e6 * _FEATURES))
        features = records.get("features", {}).get("features", likely)
        by_many = _MANY * first.get("of_one_camera", images) <= images
        return cls(
            images,
            pixels,
            pixels * first["raw"] // max(1, images),
            first["with_gps"],
            features,
            records.get("matches", {}).get("inliers", int(features * (_FEWER if by_many else _INLIERS))),
            records["sparse"]["models"][0]["registered_images"] if "sparse" in records else images,
            records.get("dense", {}).get("points"),
        )


def stage_parts(options: Options, known: Known, until: str) -> list[Part]:
    """The parts after `captures` up to the end of the stage `until`, in order, with those of the page, which follows
    where there is a model."""
    images, megapixels = known.images, known.pixels / 1e6
    raw = _RAW * known.raw_pixels / 1e6
    pairs = pairs_of(choose_strategy(options.matches.strategy, images, known.with_gps), images)
    largest = options.features.max_image_size or _COLMAPS_LARGEST
    looked_at = pixels_within(largest, images, known.pixels) / 1e6
    parts = [
        Part("fit", "images", 0.005 * (megapixels + raw)),
        Part("convert", "images", 0.015 * (megapixels + raw)),
        Part("features", "images", 0.55 * looked_at + 0.4 * images),
        Part("matches", "pairs", 0.12 * pairs * known.features / images / 10_000),
        Part("sparse", "images", 1e-4 * known.inliers),
    ]
    if options.dense.enabled:
        parts += _dense(options, known)
    before = [n for n, part in enumerate(parts) if part.stage == until]
    parts = parts[: before[-1] + 1] if before else parts * (until != "captures")
    if any(part.stage == "sparse" for part in parts):
        parts += [
            Part("page", "photographs looked at", 0.045 * megapixels),
            Part("page", "pairs drawn", 2.5 + 0.8 * megapixels / images),
        ]
    return parts


def _dense(options: Options, known: Known) -> list[Part]:
    images = known.registered
    megapixels = known.pixels / 1e6 * images / known.images
    seen = pixels_within(options.dense.max_image_size, images, 1e6 * megapixels) / 1e6
    overlap = min(1.0, known.inliers / max(1, known.features) / _ENOUGH)
    points = 1e6 * seen * overlap * _POINTS if known.points is None else known.points
    if pick_backend(options.dense.backend) == "patchmatch":
        depth = Part("dense", "runs of PatchMatch", 3.0 * seen)
    else:
        depth = Part("dense", "depth maps", 1.8 * seen * overlap)
    parts = [
        Part("dense", "undistorted sets", 0.1 * megapixels + 0.2 * images),
        depth,
        Part("dense", "fusions", 0.5 + 4e-6 * points),
    ]
    if not options.mesh.enabled:
        return parts
    parts.append(Part("mesh", "parts of the surface", 5.0 + 7.5e-6 * points))
    if options.mesh.texture is False:
        return parts
    return [
        *parts,
        Part("mesh", "photographs looked through", 0.14 * megapixels + 0.04 * images),
        Part("mesh", "atlases", 0.5 + 6e-7 * points),
        Part("mesh", "photographs compared at seams", 0.03 * megapixels + 0.02 * images),
        Part("mesh", "seams", 1.5 + 3.5e-6 * points),
        Part("mesh", "photographs on the texture", 0.045 * megapixels + 0.03 * images),
        Part("mesh", "sets of files", 1.0),
    ]
