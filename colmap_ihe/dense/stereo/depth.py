"""Compute depth and normals of one photograph from its neighbours."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from colmap_ihe.dense.camera import Float32, Float64, UInt8
from colmap_ihe.dense.stereo.edges import sharpened
from colmap_ihe.dense.stereo.match import match_around, match_whole_range
from colmap_ihe.dense.stereo.merge import enlarged, filled, merge, without_speckles
from colmap_ihe.dense.stereo.normals import normals_from_inverse_depth
from colmap_ihe.dense.stereo.rectify import PairLeftOutError, RectifiedPair, rectify
from colmap_ihe.dense.stereo.refine import compare, prepared, refined
from colmap_ihe.dense.stereo.rims import without_rims
from colmap_ihe.dense.stereo.strips import overwrite
from colmap_ihe.dense.stereo.views import StereoView, sizes_coarse_to_fine

# Measured with benchmarks/dense.py.
_COARSEST_PX = 400  # longer side of the size at which the whole range of depths is searched
# Thin things are lost in small pictures, so it is twice as large where two pairs take no more disparities there; wider
# ones take part from the next size on.
_LARGER_PX, _MOST_DISPARITIES = 800, 320
_ITERATIONS = 1  # Gauss-Newton steps at each size: a second one made the error larger, on true depth too
_MIN_CORRELATION = 0.37  # of the window of a pixel with a source that supports it
_MIN_SINGLE_CORRELATION = 0.6  # with which one supporting source is enough
# Variance of 8-bit values. Where windows are too flat to correlate, sources that agree in depth are enough if the
# grey values vary by at least so much: a wall does, the sky does not.
_MIN_VARIANCE = 1.0
_SPECKLE_PX = 40  # smaller patches are dropped, in pixels of each size
_COARSE_SPECKLE_PX = 15  # at the coarsest, where pieces of a thin thing are found, which the next size joins
_NORMAL_RADIUS_PX = 10  # half of the window of the normals


_Match = tuple[RectifiedPair, StereoView]


@dataclass(frozen=True)
class DepthResult:
    """Hold the maps of one reference.

    `depth` (H, W) float32 along the optical axis in world units, 0 for none; `normals` (H, W, 3)
    float32 unit vectors in the camera frame towards the camera, 0 for none; `pairs_left_out` the reasons
    by the index of a source.
    """

    depth: Float32
    normals: Float32
    pairs_left_out: Mapping[int, str]


def depth_and_normals(
    reference: StereoView,
    sources: Sequence[StereoView],
    points_world: Float64,
    check: Callable[[], None] = lambda: None,
) -> DepthResult:
    """Return depth and normals of `reference` from `sources`.

    `points_world` (N, 3): sparse points that the reference sees; they bound the search. `check` is called
    between steps and may raise to stop. With no usable source the maps are empty.
    """
    if points_world.ndim != 2 or points_world.shape[1] != 3:
        raise ValueError(f"{points_world.shape=}, expected (N, 3)")
    sizes = sizes_coarse_to_fine(reference.size, _COARSEST_PX)
    pairs: dict[int, list[RectifiedPair]] = {}
    left_out: dict[int, str] = {}
    for index, source in enumerate(sources):
        cameras = [
            (reference.camera_resized(s), source.camera_resized(_scaled(source, s, reference))) for s in sizes
        ]
        try:
            pairs[index] = [rectify(*pair, points_world) for pair in cameras]
        except PairLeftOutError as reason:
            left_out[index] = str(reason)
    inverse = np.zeros(reference.grey_u8.shape, np.float32)
    first, narrow = first_step(sizes, list(pairs.values())) if pairs else (len(sizes), [])
    for step, size in list(enumerate(sizes))[first:]:
        smaller = [sources[index].resized(_scaled(sources[index], size, reference)) for index in pairs]
        matches = [(by_size[step], source) for by_size, source in zip(pairs.values(), smaller, strict=True)]
        if step == first:
            matches = [matches[row] for row in narrow]
        prior = None
        if step > first:
            prior = enlarged(filled(inverse), size)
        inverse = _match_at_size(reference.resized(size), matches, prior, check)
        if not inverse.any():
            inverse = np.zeros(reference.grey_u8.shape, np.float32)
            break
    inverse = without_rims(reference, [sources[index] for index in pairs], inverse)
    held = inverse > 0
    depth = np.where(held, 1 / np.where(held, inverse, 1), 0).astype(np.float32)
    normals = normals_from_inverse_depth(inverse, reference.K, _NORMAL_RADIUS_PX)
    return DepthResult(depth, normals, left_out)


def first_step(
    sizes: Sequence[tuple[int, int]], pairs: Sequence[Sequence[RectifiedPair]]
) -> tuple[int, list[int]]:
    """Return the step of `sizes` at which the whole range of depths is searched, and the rows of `pairs` that are
    matched there; `pairs` has the frames of each source at each step."""
    for step in range(len(sizes) - 1, 0, -1):
        ranges = [by_size[step].disparities for by_size in pairs]
        narrow = [row for row, (low, high) in enumerate(ranges) if high - low <= _MOST_DISPARITIES]
        if max(sizes[step]) <= _LARGER_PX and len(narrow) >= min(2, len(pairs)):
            return step, narrow
    return 0, list(range(len(pairs)))


def _match_at_size(
    reference: StereoView, matches: Sequence[_Match], prior: Float32 | None, check: Callable[[], None]
) -> Float32:
    """Return inverse depth (H, W) float32, 0 for none, at the size of `reference`.

    `matches` are the frames and views of its sources at that size; `prior` (H, W) is the inverse depth from the size
    before, without holes, or None at the coarsest.
    """
    maps = []
    for pair, source in matches:
        check()
        if prior is None:
            maps.append(match_whole_range(pair, reference, source))
        else:
            maps.append(match_around(pair, reference, source, prior))
    # The change of inverse depth in the middle of the frame that moves a match by one pixel.
    one_pixel = [
        1.0 / float(pair.disparity_per_inverse_depth()[pair.height // 2, pair.width // 2])
        for pair, _ in matches
    ]
    inverse, merged = merge(maps, one_pixel)
    if not merged.any():
        return inverse
    sources = [source for _, source in matches]
    inverse = _confirmed(reference, sources, inverse, merged, float(np.median(one_pixel)), check)
    # Speckles by the coarsest pair: by the finest, a steep surface falls apart into single pixels.
    smallest_px = _COARSE_SPECKLE_PX if prior is None else _SPECKLE_PX
    inverse = without_speckles(inverse, smallest_px, max(one_pixel))
    check()
    return sharpened(reference, sources, inverse, float(np.median(one_pixel)))


def _confirmed(
    view: StereoView,
    sources: Sequence[StereoView],
    inverse: Float32,
    merged: UInt8,
    one_pixel: float,
    check: Callable[[], None],
) -> Float32:
    """Refine `inverse`, and keep it where enough sources look like the reference there."""
    reference = prepared(view)
    moved = refined(reference, sources, filled(inverse), one_pixel, _ITERATIONS)
    check()
    support = np.zeros(inverse.shape, np.uint8)
    alike = np.zeros(inverse.shape, np.uint8)
    best = np.full(inverse.shape, -1, np.float32)
    for source in sources:
        fit = compare(reference, source, moved)
        support += fit.same & (fit.correlation >= _MIN_CORRELATION)
        alike += fit.same & (fit.likeness >= _MIN_CORRELATION)
        overwrite(best, np.maximum(best, fit.correlation), fit.same)
    keep = (inverse > 0) & (moved > 0)
    if view.mask_u8 is not None:
        keep &= view.mask_u8 > 0
    agree = (merged >= 2) & (alike >= 2) & (reference.variance >= _MIN_VARIANCE)
    keep &= (support >= 2) | agree | (best >= _MIN_SINGLE_CORRELATION)
    return np.where(keep, moved, 0).astype(np.float32)


def _scaled(source: StereoView, size: tuple[int, int], reference: StereoView) -> tuple[int, int]:
    """Return the size of `source` when `reference` has `size`."""
    scale = size[0] / reference.size[0]
    return max(1, round(source.size[0] * scale)), max(1, round(source.size[1] * scale))
