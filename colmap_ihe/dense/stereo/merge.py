"""Merge the depth maps of one reference, one from each source, where they agree; fill holes, enlarge, drop speckles."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from colmap_ihe.dense.camera import Float32, UInt8
from colmap_ihe.dense.stereo.strips import overwrite, strips

_STEP = 0.03  # relative change of inverse depth between neighbours beside an edge


def merge(inverse_depths: Sequence[Float32], one_pixel: Sequence[float]) -> tuple[Float32, UInt8]:
    """Return the inverse depth that most sources agree on, and how many they are.

    `inverse_depths` K x (H, W) float32, 0 for none; `one_pixel` K values: the change of inverse depth
    that moves a match by one pixel in each. Two agree when they differ by at most the larger of their
    two pixels. Of equally large groups the one with the finest member wins; its members are averaged
    with weights 1 / one_pixel^2, as for matches of the same precision. Returns (H, W) float32
    and (H, W) uint8.
    """
    best = np.zeros(inverse_depths[0].shape, np.float32)
    support = np.zeros(best.shape, np.uint8)
    finest_first = sorted(range(len(one_pixel)), key=lambda index: one_pixel[index])
    ordered = [one_pixel[index] for index in finest_first]
    for strip in strips(best.shape):
        parts = [inverse_depths[index][strip.own] for index in finest_first]
        _merge_rows(parts, ordered, best[strip.own], support[strip.own])
    return best, support


def _merge_rows(
    inverse_depths: Sequence[Float32], one_pixel: Sequence[float], best: Float32, support: UInt8
) -> None:
    """Do as `merge` does, the finest first, and write to `best` and `support`, which are 0."""
    weights = [np.float32((one_pixel[0] / pixel) ** 2) for pixel in one_pixel]
    weighted = [values * weight for values, weight in zip(inverse_depths, weights, strict=True)]
    held = [values > 0 for values in inverse_depths]
    for row, candidate in enumerate(inverse_depths):
        count = np.zeros(best.shape, np.uint8)
        total, sum_of_weights = np.zeros((2, *best.shape), np.float32)
        for other, values in enumerate(inverse_depths):
            tolerance = np.float32(max(one_pixel[row], one_pixel[other]))
            agrees = np.abs(values - candidate) <= tolerance
            agrees &= held[other] & held[row]
            count += agrees
            total += agrees * weighted[other]
            sum_of_weights += agrees * weights[other]
        better = count > support
        with np.errstate(invalid="ignore"):
            overwrite(best, total / sum_of_weights, better)
        overwrite(support, count, better)


def filled(inverse_depth: Float32) -> Float32:
    """Return `inverse_depth` (H, W) float32 with its holes (0) filled smoothly from around them.

    Each hole takes the average at the finest level of an image pyramid that holds a depth there. Raises
    ValueError if no pixel has a depth.
    """
    if not (inverse_depth > 0).any():
        raise ValueError("no pixel has a depth, expected at least one to fill the others from")
    return _pull_push(inverse_depth, (inverse_depth > 0).astype(np.float32))


def _pull_push(total: Float32, weight: Float32) -> Float32:
    height, width = weight.shape
    mean = total / np.maximum(weight, np.float32(1e-6))
    if weight.min() > 0:
        return mean.astype(np.float32)
    half = ((width + 1) // 2, (height + 1) // 2)
    coarser = _pull_push(
        np.asarray(cv2.resize(total, half, interpolation=cv2.INTER_AREA), np.float32),
        np.asarray(cv2.resize(weight, half, interpolation=cv2.INTER_AREA), np.float32),
    )
    enlarged = cv2.resize(coarser, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.where(weight > 0, mean, enlarged).astype(np.float32)


def enlarged(inverse_depth: Float32, size: tuple[int, int]) -> Float32:
    """Return `inverse_depth` (H, W) float32, > 0, at a larger `size` (width, height). Pixels beside an edge take the
    value of one side: between the two there is nothing, and of a thing two pixels wide hardly a pixel would keep its
    own."""
    around = np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.dilate(inverse_depth, around), cv2.erode(inverse_depth, around)
    edge = (nearest - farthest > _STEP * farthest).astype(np.uint8)
    beside = cv2.resize(edge, size, interpolation=cv2.INTER_NEAREST) > 0
    sharp = cv2.resize(inverse_depth, size, interpolation=cv2.INTER_NEAREST)
    smooth = cv2.resize(inverse_depth, size, interpolation=cv2.INTER_LINEAR)
    return np.where(beside, sharp, smooth).astype(np.float32)


def without_speckles(inverse_depth: Float32, smallest_px: int, one_pixel: float) -> Float32:
    """Return `inverse_depth` (H, W) without connected patches of fewer than `smallest_px` pixels.

    Neighbours are connected if they differ by at most two of `one_pixel`.
    """
    # cv2.filterSpeckles takes 16-bit integers: an eighth of a pixel a step leaves 4,000 pixels of range.
    low = float(inverse_depth[inverse_depth > 0].min(initial=np.inf))
    steps = (inverse_depth - low) * (8.0 / one_pixel)
    levels = np.where(inverse_depth > 0, np.clip(steps, 0, 32000), -100).astype(np.int16)
    cv2.filterSpeckles(levels, -100, smallest_px, 16)
    return np.where(levels >= 0, inverse_depth, 0).astype(np.float32)
