"""Hold what a histogram counted in few bytes: to be sent to another process, kept in a file, and added to others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from colmap_ihe.grey import kernels
from colmap_ihe.grey.weights import Encoding

Weighting = Literal["pixel", "image"]

MOST = 2**47
"""Pixels of a set: a cell of `kernels.Table` holds twice as many."""
IMAGE_MASS = 1 << 36
"""The mass of one image under `weighting: image`: rounding per pixel shows in the 4th digit at most, and 2^53
holds 131,072 images."""
MOST_IMAGES = 1 << 26


@dataclass(frozen=True)
class Sums:
    """Hold what was counted: `cells` are the occupied cells as `kernels.packed` writes them, of `mass` in sum: as many
    as `pixels`, or under `weighting` "image" about as much for each image. Nothing of it is checked until it is added
    to a `Histogram`. Raises ValueError for a kind that there is not, or numbers that cannot be."""

    encoding: Encoding
    weighting: Weighting
    images: int
    pixels: int
    mass: int
    cells: bytes

    def __post_init__(self) -> None:
        if self.encoding not in ("coded", "linear") or self.weighting not in ("pixel", "image"):
            raise ValueError(f"encoding {self.encoding!r} and weighting {self.weighting!r}")
        numbers = (self.images, self.pixels, self.mass)
        if (
            any(type(n) is not int or n < 0 for n in numbers)
            or self.pixels >= MOST
            or self.images >= MOST_IMAGES
        ):
            raise ValueError(
                f"images, pixels and mass of {numbers!r:.80}, expected whole numbers in their range"
            )
        most = self.pixels if self.weighting == "pixel" else self.images * IMAGE_MASS
        least = self.pixels if self.weighting == "pixel" else min(1, self.pixels)
        if not least <= self.mass <= most or self.images > self.pixels:
            raise ValueError(f"a mass of {self.mass} for {self.images} images of {self.pixels} pixels")

    def checked(self) -> Sums:
        """Return the same. Raises ValueError if its cells are not what it says of them."""
        kernels.check_packed(self.cells, self.mass)
        return self

    def head(self) -> dict[str, Any]:
        """Return all but the cells, in plain values."""
        names = ("encoding", "weighting", "images", "pixels", "mass")
        return {name: getattr(self, name) for name in names}
