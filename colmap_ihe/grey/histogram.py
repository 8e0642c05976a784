"""Count the joint colour histogram of a set of photographs, all that the fit needs of them; in few bytes where it is
to be sent to another process, kept in a file, and added to others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey import kernels
from colmap_ihe.grey.weights import Encoding, Triplet
from colmap_ihe.machine.threads import local_workers

_CODES = 256

LINEAR_EDGES: NDArray[np.int64] = np.ceil(65535 * (np.arange(_CODES + 1) / _CODES) ** 2).astype(np.int64)
"""Cell c of linear 16-bit input holds the values LINEAR_EDGES[c] <= v < LINEAR_EDGES[c + 1]: even steps
of the square root, so that cells are about as wide as the photon noise in them."""
LINEAR_EDGES[-1] = 65536

_LINEAR_CODE: NDArray[np.uint8] = np.repeat(np.arange(_CODES, dtype=np.uint8), np.diff(LINEAR_EDGES))


Weighting = Literal["pixel", "image"]

Cells = tuple[NDArray[np.uint64], NDArray[np.uint64]]
"""Keys of cells, as `kernels.occupied` has them, and their masses, (M,) each."""

MOST = 2**47
"""Pixels of a set: a cell of `kernels.Table` holds twice as many."""
IMAGE_MASS = 1 << 36
"""Mass of an image under `weighting: image`: rounding a pixel shows in the 4th digit; 2^53 holds 131,072 images."""
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
        whole = all(type(n) is int and n >= 0 for n in numbers)
        if not whole or self.pixels >= MOST or self.images >= MOST_IMAGES:
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


class Histogram:
    """Count how many pixels of the set have each colour. Adding histograms is pooling their photographs.

    Coded 8-bit input is counted exactly, one cell a colour. Linear 16-bit input is counted in 256
    cells a channel, even in the square root, see `LINEAR_EDGES`. Counts are integers: order and grouping of the
    images cannot change them. `weighting="image"` gives every photograph the same mass.
    """

    def __init__(self, encoding: Encoding = "coded", weighting: Weighting = "pixel") -> None:
        self.encoding: Encoding = encoding
        self.weighting: Weighting = weighting
        self.images = 0
        self.pixels = 0
        self._counted = kernels.Table()
        self._weighed: NDArray[np.uint64] | None = (
            None if weighting == "pixel" else np.zeros(kernels.CELLS, np.uint64)
        )

    def add(self, rgb: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        """Count one photograph.

        rgb: (H, W, 3); uint8 gamma-coded for `coded`, uint16 linear with 65535 at sensor saturation
        for `linear`. Raises ValueError on another shape or dtype.
        """
        expected = np.uint8 if self.encoding == "coded" else np.uint16
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != expected or not rgb.size:
            raise ValueError(f"{rgb.shape=} {rgb.dtype=}, expected (H, W, 3) {np.dtype(expected)}")
        pixels = rgb.shape[0] * rgb.shape[1]
        kernels.count_colours(rgb, self._counted, _LINEAR_CODE)
        if self._weighed is not None:
            place = np.flatnonzero(self._counted.low)
            self._weighed[place] += self._counted.at(place) * np.uint64(mass_of(rgb, "image"))
            self._counted.clear(place)
        self.images += 1
        self.pixels += pixels

    def table(self) -> NDArray[np.uint64]:
        """Return the mass of every cell, (2^24,), at the places of `kernels.Table`."""
        return self._counted.at(slice(None)) if self._weighed is None else self._weighed

    def occupied(self) -> Cells:
        """Return keys and masses of the occupied cells, (M,) each, in the order of `kernels.occupied`."""
        some = self._counted.low if self._weighed is None else (self._weighed > 0).astype(np.uint16)
        keys = kernels.occupied(some)
        return keys, self._masses((keys & np.uint64(kernels.CELLS - 1)).astype(np.intp))

    def _masses(self, place: NDArray[Any]) -> NDArray[np.uint64]:
        return self._counted.at(place) if self._weighed is None else self._weighed[place]

    def levels(self, triplets: Sequence[Triplet]) -> dict[Triplet, NDArray[np.int64]]:
        """Return the grey histograms, (256,) each, of a coded set by weights in hundredths."""
        ordered = sorted(triplets, key=lambda t: (t[2], t[0]))  # as they are counted quickest
        masses = self._counted if self._weighed is None else self._weighed
        workers = local_workers()
        with ThreadPoolExecutor(workers) as pool:
            parts = pool.map(lambda n: kernels.count_levels(masses, ordered, n, workers), range(workers))
            return dict(zip(ordered, np.asarray(sum(parts), np.int64), strict=True))

    def __add__(self, other: Histogram) -> Histogram:
        total = _of_sums(self.sums())
        total.add_sums(other.sums())
        return total

    def colours(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the codes R, G, B of the occupied cells in their order, (M, 3), and the mass in each, (M,)."""
        table = self.table()
        places = np.flatnonzero(table)
        codes = kernels.codes_at(places).astype(np.int64)
        order = np.lexsort(codes.T[::-1])
        return codes[order], table[places[order]].astype(np.int64)

    def taken(self) -> Sums:
        """Return what was counted, and empty the histogram, which counts on in the same memory."""
        sums = self.sums(emptied=True)
        self.images = self.pixels = 0
        return sums

    def sums(self, *, emptied: bool = False) -> Sums:
        """Return what was counted."""
        if self._weighed is None:
            return self._sums(self.pixels, kernels.held(self._counted, emptied=emptied))
        place = np.flatnonzero(self._weighed)
        mass = self._weighed[place]
        if emptied:
            self._weighed[place] = 0
        return self._sums(int(mass.sum()), kernels.packed(place.astype(np.uint32), mass))

    def _sums(self, mass: int, cells: bytes) -> Sums:
        return Sums(self.encoding, self.weighting, self.images, self.pixels, mass, cells)

    def add_sums(self, sums: Sums) -> None:
        """Pool what another histogram counted. Raises ValueError, and adds nothing, where it is of another kind, or
        its cells are not what it says of them."""
        if (self.encoding, self.weighting) != (sums.encoding, sums.weighting):
            raise ValueError(
                f"{self.encoding=} {self.weighting=} and {sums.encoding=} {sums.weighting=} do not add: "
                "their values differ in kind"
            )
        images, pixels = self.images + sums.images, self.pixels + sums.pixels
        if pixels >= MOST or images >= MOST_IMAGES:
            raise ValueError(f"{images=} of {pixels=}, expected less than {MOST_IMAGES} of {MOST}")
        kernels.add_packed(sums.cells, sums.mass, self._counted if self._weighed is None else self._weighed)
        self.images, self.pixels = images, pixels

    def __reduce__(self) -> tuple[Any, ...]:
        return _of_sums, (self.sums(),)


def _of_sums(sums: Sums) -> Histogram:
    histogram = Histogram(sums.encoding, sums.weighting)
    histogram.add_sums(sums)
    return histogram


def mass_of(rgb: NDArray[Any], weighting: Weighting) -> int:
    """Return what one pixel of this photograph counts."""
    return 1 if weighting == "pixel" else IMAGE_MASS // math.prod(rgb.shape[:2])
