"""Describe a set of photographs by its size and by what is known of it, and what memory and disk a stage needs for it.

The figures in the stage files were measured with `benchmarks/limits.py disk`; what was measured lies below them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from colmap_ihe.dense.cost import ASPECT
from colmap_ihe.machine import memory
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.survey import Surveyed

BASE_BYTES = 600_000_000
"""Memory of any run: interpreter, libraries, memory that earlier stages freed and it keeps."""
_FEATURES = 12_000  # of a megapixel, and at the most of a photograph
_INLIERS = 0.7  # for each feature, in pairs that overlap as they do in most sets
_FEWER = 0.15  # of photographs by many cameras, as those of tourists
_MANY = 4  # times as many photographs as the most that one camera took
_RAW = 10  # times as long to decode


@dataclass(frozen=True)
class PhotoSetSize:
    """Hold the size of a set: `pixels` in all, `largest` of one photograph, and `one_bytes` of memory to decode one."""

    images: int
    pixels: int
    largest: int
    raw: int
    with_gps: int
    one_bytes: int

    @classmethod
    def of(cls, record: Mapping[str, Any], captures: Sequence[Capture]) -> PhotoSetSize:
        """Return the size from the record of `captures`, and the photographs that it holds."""
        names = ("images", "pixels", "largest", "raw", "with_gps")
        return cls(**{name: int(record[name]) for name in names}, one_bytes=memory.needed(captures))

    @classmethod
    def of_survey(cls, surveyed: Sequence[Surveyed]) -> PhotoSetSize:
        """Return the size of photographs whose headers were read."""
        captures = [replace(s.capture, pixels=s.width * s.height) for s in surveyed]
        return cls(
            images=len(captures),
            pixels=sum(c.pixels for c in captures),
            largest=max((c.pixels for c in captures), default=0),
            raw=sum(c.kind == "raw" for c in captures),
            with_gps=sum(s.metadata.has_gps for s in surveyed),
            one_bytes=memory.needed(captures),
        )

    @property
    def largest_sides(self) -> tuple[int, int]:
        """Return width and height of the largest photograph in pixels, with the usual aspect."""
        side = (self.largest * ASPECT) ** 0.5
        return max(1, round(side)), max(1, round(side / ASPECT))


@dataclass(frozen=True)
class StageNeeds:
    """Hold what a stage needs: `base_bytes` of memory and `one_bytes` for each of its workers; `disk_bytes` that it
    writes; `more_bytes` of memory besides, where there are so many; `saves`: what makes it need less, in words."""

    stage: str
    base_bytes: int
    one_bytes: int
    disk_bytes: int
    more_bytes: int = 0
    saves: str = ""

    def memory_bytes(self, workers: int) -> int:
        """Return the memory that the stage needs with so many workers."""
        return self.base_bytes + self.one_bytes * workers


@dataclass(frozen=True)
class Known:
    """Hold what is known of a set while it runs, or likely where the stages have not come so far: `pixels` and
    `raw_pixels` of all photographs, features of all images, inliers of all pairs, images in the model, points of the
    dense cloud, and whether it is known to be metric."""

    images: int
    pixels: int
    raw_pixels: int
    with_gps: int
    features: int
    inliers: int
    registered: int
    points: int | None = None
    metric: bool = False

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
            bool(records.get("survey", {}).get("method")),
        )

    @property
    def decoded_megapixels(self) -> float:
        """Return the megapixels of all photographs, RAW counted as often as they take longer to decode."""
        return (self.pixels + _RAW * self.raw_pixels) / 1e6

    @property
    def registered_megapixels(self) -> float:
        """Return the megapixels of the photographs in the model."""
        return self.pixels / 1e6 * self.registered / self.images
