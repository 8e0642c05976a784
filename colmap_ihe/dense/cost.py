"""Estimate the memory, disk and time of dense reconstruction before it begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from colmap_ihe.dense.backend import Backend
from colmap_ihe.dense.fusion import FUSION_BYTES, fusion_bytes
from colmap_ihe.machine.memory import most_at_once

ASPECT = 1.5  # of photographs, by and large
STEREO_BYTES_A_PIXEL = 200
"""Of one depth map under way: five sources and their common frames. Measured with benchmarks/dense.py."""
_CORE_SECONDS_A_MEGAPIXEL = 7.2
"""Of semi-global matching with fusion, on a server's core of 2 to 3 GHz: 5.3 beside little other work, and up
to 13 beside other work."""
_FILES_BYTES_A_PIXEL = 31  # grey, colour, depth and normals of a pixel, and its share of the cloud


def pixels_within(largest: int, images: int, pixels: float) -> float:
    """Return the pixels of `images` photographs with `pixels` in all, once their longer side is `largest` at most."""
    return min(pixels, images * largest**2 / ASPECT)


@dataclass(frozen=True)
class DenseCost:
    """Hold an estimate.

    `at_once`: depth maps worked on at a time; None on a GPU. `memory_bytes` is the larger need of depth maps and of
    fusion, which needs `fusion_bytes` and follows them. `minutes`: None where it was never measured.
    """

    backend: Backend
    images: int
    megapixels: float
    at_once: int | None
    memory_bytes: int
    fusion_bytes: int
    disk_bytes: int
    minutes: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return the estimate as `doctor` prints it."""
        return {
            "dense_backend": self.backend,
            "dense_images": self.images,
            "dense_megapixels": round(self.megapixels, 1),
            "dense_maps_at_once": self.at_once,
            "dense_memory_gb": round(self.memory_bytes / 1e9, 1),
            "dense_disk_gb": round(self.disk_bytes / 1e9, 1),
            "dense_minutes": None if self.minutes is None else round(self.minutes, 1),
        }

    def in_words(self) -> str:
        """Return the estimate as a sentence for the log."""
        kind = "PatchMatch on the GPU" if self.backend == "patchmatch" else "semi-global matching on the CPU"
        time = "" if self.minutes is None else f"about {max(1, round(self.minutes))} min, "
        return (
            f"dense stereo of {self.images} images by {kind}: {time}up to {self.memory_bytes / 1e9:.1f} GB of"
            f" memory and {self.disk_bytes / 1e9:.1f} GB on disk"
        )


def dense_cost(
    sizes: Sequence[tuple[int, int]], max_image_size: int, backend: Backend, workers: int, free_bytes: int
) -> DenseCost:
    """Return the estimate for images of these sizes (width, height), their longer side bounded by `max_image_size`.

    `free_bytes` of memory, 0 if unknown, bound how many of `workers` may make a depth map at a time.
    """
    pixels = [_pixels(*size, max_image_size) for size in sizes]
    bytes_a_map = STEREO_BYTES_A_PIXEL * max(pixels, default=0)
    at_once = most_at_once(bytes_a_map, free_bytes, workers) if backend == "sgm" else None
    stereo = bytes_a_map * (at_once or 0)
    fusion = min(FUSION_BYTES, fusion_bytes(sum(pixels)))
    seconds = _CORE_SECONDS_A_MEGAPIXEL * sum(pixels) / 1e6 / (at_once or 1)
    return DenseCost(
        backend=backend,
        images=len(pixels),
        megapixels=sum(pixels) / 1e6,
        at_once=at_once,
        memory_bytes=max(stereo, fusion),
        fusion_bytes=fusion,
        disk_bytes=_FILES_BYTES_A_PIXEL * sum(pixels),
        minutes=seconds / 60 if backend == "sgm" else None,
    )


def _pixels(width: int, height: int, most: int) -> int:
    scale = min(1.0, most / max(width, height))
    return round(width * scale) * round(height * scale)
