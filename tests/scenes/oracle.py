"""The IHE fit as a plain loop over every triplet and every pixel, sharing nothing with the package.

After equations 4 to 6 of the paper: y is the share of pixels in each of 256 grey levels, beta = 1/256,
S = sum (y - beta)^2. Decisions are made in integers, so that ties are ties.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.histogram import Histogram, Weighting
from colmap_ihe.grey.weights import Encoding

REC709 = (0.2126, 0.7152, 0.0722)

Triplet = tuple[int, int, int]
Levels = Callable[[NDArray[Any], Triplet], NDArray[np.int64]]


@dataclass(frozen=True)
class Best:
    triplet: Triplet
    score: float
    tones: int


def grid(step_hundredths: int) -> list[Triplet]:
    every = range(0, 101, step_hundredths)
    return [(i, j, k) for i in every for j in every for k in every if i + j + k == 100]


def coded_levels(rgb: NDArray[Any], triplet: Triplet) -> NDArray[np.int64]:
    """Nearest whole grey, halves up."""
    return np.asarray((weighed(rgb, triplet) + 50) // 100)


def linear_levels(rgb: NDArray[Any], triplet: Triplet, white: int) -> NDArray[np.int64]:
    """256 even levels up to `white`, in units of hundredths of a 16-bit value; the last holds all above."""
    return np.asarray(np.minimum(255, weighed(rgb, triplet) * 256 // white))


def weighed(rgb: NDArray[Any], triplet: Triplet) -> NDArray[np.int64]:
    red, green, blue = (rgb[..., channel].astype(np.int64) * triplet[channel] for channel in range(3))
    return np.asarray(red + green + blue)


def fit(
    images: Sequence[NDArray[Any]],
    step_hundredths: int,
    levels: Levels = coded_levels,
    *,
    images_count_equally: bool = False,
) -> Best:
    pixels = [image.shape[0] * image.shape[1] for image in images]
    common = math.lcm(*pixels)
    masses = [common // n if images_count_equally else 1 for n in pixels]
    ranked = []
    for triplet in grid(step_hundredths):
        counts = np.zeros(256, np.int64)
        for image, mass in zip(images, masses, strict=True):
            counts += mass * np.bincount(levels(image, triplet).ravel(), minlength=256)
        squares = sum(int(n) ** 2 for n in counts)
        tones = int((counts > 0).sum())
        away = sum((w / 100 - r) ** 2 for w, r in zip(triplet, REC709, strict=True))
        share = counts / counts.sum()
        ranked.append((squares, -tones, away, triplet, float(((share - 1 / 256) ** 2).sum())))
    _, fewer, _, triplet, score = min(ranked)
    return Best(triplet, score, -fewer)


def scene(seed: int, height: int, width: int, colours: int = 40) -> NDArray[np.uint8]:
    """A picture of flat and shaded patches with noise, uint8, so that weights differ in what they give."""
    rng = np.random.default_rng(seed)
    palette = rng.integers(0, 256, (colours, 3))
    patches = palette[rng.integers(0, colours, ((height + 7) // 8, (width + 7) // 8))]
    rgb = patches.repeat(8, axis=0).repeat(8, axis=1)[:height, :width].astype(np.float64)
    rgb *= np.linspace(0.4, 1.1, width)[None, :, None]
    rgb += rng.normal(0, 4, rgb.shape)
    return np.clip(np.rint(rgb), 0, 255).astype(np.uint8)


def photograph(seed: int, height: int = 40, width: int = 60) -> NDArray[np.float32]:
    """A `scene` as conversions take it: float32 in [0, 1]."""
    return scene(seed, height, width).astype(np.float32) / np.float32(255)


def blobs(seed: int, width: int, height: int) -> NDArray[np.float64]:
    """(height, width): blobs of many sizes, of mean 0 and standard deviation 1."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width))
    for sigma in (1.5, 3.0, 6.0):
        blurred = cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), sigma)
        total += np.asarray(blurred) / np.std(blurred)
    return np.asarray(total / total.std())


def pooled(
    images: Sequence[NDArray[Any]], encoding: Encoding = "coded", weighting: Weighting = "pixel"
) -> Histogram:
    """The package's histogram of a set."""
    histogram = Histogram(encoding, weighting)
    for image in images:
        histogram.add(image)
    return histogram
