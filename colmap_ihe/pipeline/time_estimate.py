"""Hold what is known of a set while it runs, from which the stages estimate their time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

_FEATURES = 12_000  # of a megapixel, and at the most of a photograph
_INLIERS = 0.7  # for each feature, in pairs that overlap as they do in most sets
_FEWER = 0.15  # of photographs by many cameras, as those of tourists
_MANY = 4  # times as many photographs as the most that one camera took
_RAW = 10  # times as long to decode


@dataclass(frozen=True)
class Known:
    """Hold what is known of a set, or likely where the stages have not come so far: `pixels` and `raw_pixels` of all
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
        """Return it from the records of the stages that are done, `captures` at least."""
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

    @property
    def decoded_megapixels(self) -> float:
        """Return the megapixels of all photographs, RAW counted as often as they take longer to decode."""
        return (self.pixels + _RAW * self.raw_pixels) / 1e6

    @property
    def registered_megapixels(self) -> float:
        """Return the megapixels of the photographs in the model."""
        return self.pixels / 1e6 * self.registered / self.images
