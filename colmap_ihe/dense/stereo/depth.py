"""Depth and normals of one photograph from its neighbours: the entrance to this room."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from colmap_ihe.dense.stereo.match import match_around, match_whole_range
from colmap_ihe.dense.stereo.merge import filled, merge, without_speckles
from colmap_ihe.dense.stereo.normals import normals_from_inverse_depth
from colmap_ihe.dense.stereo.rectify import PairLeftOutError, RectifiedPair, rectify
from colmap_ihe.dense.stereo.refine import compare, prepared, refined
from colmap_ihe.dense.stereo.views import Float32, Float64, StereoView, UInt8, sizes_coarse_to_fine


@dataclass(frozen=True, kw_only=True)
class StereoOptions:
    """What may be set; the defaults were measured with benchmarks/dense.py."""

    # Longer side of the size at which the whole range of depths is searched.
    coarsest_px: int = 400
    # Gauss-Newton steps at each size.
    iterations: int = 2
    # A source supports a pixel whose window correlates with it at least so well.
    min_correlation: float = 0.4
    # One supporting source is enough if it correlates at least so well.
    min_single_correlation: float = 0.6
    # Where windows are too flat to correlate, sources that agree in depth are enough if the grey values
    # vary by at least so much (variance of 8-bit values): a wall does, the sky does not.
    min_variance: float = 1.0
    # Smaller patches are dropped, in pixels of each size.
    speckle_px: int = 60
    # Half of the window of the normals, in pixels.
    normal_radius_px: int = 6


@dataclass(frozen=True)
class DepthResult:
    """What is known of one reference.

    `depth` (H, W) float32 along the optical axis in world units, 0 for none; `normals` (H, W, 3)
    float32 unit vectors in the camera frame towards the camera, 0 for none; `support` (H, W) uint8 how
    many sources confirm each pixel; `pairs_used` and `pairs_left_out` (with the reason) name sources by
    their place in the given order.
    """

    depth: Float32
    normals: Float32
    support: UInt8
    pairs_used: tuple[int, ...]
    pairs_left_out: Mapping[int, str]


def depth_and_normals(
    reference: StereoView,
    sources: Sequence[StereoView],
    points_world: Float64,
    options: StereoOptions | None = None,
    check: Callable[[], None] = lambda: None,
) -> DepthResult:
    """Depth and normals of `reference` from `sources`.

    `points_world` (N, 3): sparse points that the reference sees; they bound the search. `check` is called
    between steps and may raise to stop. With no usable source the maps are empty.
    """
    if points_world.ndim != 2 or points_world.shape[1] != 3:
        raise ValueError(f"{points_world.shape=}, expected (N, 3)")
    options = options or StereoOptions()
    sizes = sizes_coarse_to_fine(reference.size, options.coarsest_px)
    pairs, left_out = _rectified(reference, sources, sizes, points_world)
    inverse = np.zeros(reference.grey_u8.shape, np.float32)
    support = np.zeros(reference.grey_u8.shape, np.uint8)
    known: Float32 | None = None
    for place, size in enumerate(sizes if pairs else []):
        small = reference.resized(size)
        smaller = [sources[index].resized(_scaled(sources[index], size, reference)) for index in pairs]
        at_size = [by_size[place] for by_size in pairs.values()]
        inverse, support = _match_at_size(small, smaller, at_size, known, options, check)
        if not support.any():
            inverse, support = np.zeros_like(reference.grey_u8, np.float32), np.zeros_like(reference.grey_u8)
            break
        known = filled(inverse)
    held = inverse > 0
    depth = np.where(held, 1 / np.where(held, inverse, 1), 0).astype(np.float32)
    normals = normals_from_inverse_depth(inverse, reference.K, options.normal_radius_px)
    return DepthResult(depth, normals, support, tuple(pairs), left_out)


def _rectified(
    reference: StereoView,
    sources: Sequence[StereoView],
    sizes: Sequence[tuple[int, int]],
    points_world: Float64,
) -> tuple[dict[int, list[RectifiedPair]], dict[int, str]]:
    """The common frames of each usable source at every size, and the reasons of the others, by place in
    `sources`.
    """
    pairs: dict[int, list[RectifiedPair]] = {}
    left_out: dict[int, str] = {}
    for index, source in enumerate(sources):
        try:
            pairs[index] = [
                rectify(
                    reference.camera_resized(size),
                    source.camera_resized(_scaled(source, size, reference)),
                    points_world,
                )
                for size in sizes
            ]
        except PairLeftOutError as reason:
            left_out[index] = str(reason)
    return pairs, left_out


def _match_at_size(
    reference: StereoView,
    sources: Sequence[StereoView],
    pairs: Sequence[RectifiedPair],
    known: Float32 | None,
    options: StereoOptions,
    check: Callable[[], None],
) -> tuple[Float32, UInt8]:
    """Inverse depth (H, W) float32, 0 for none, and its support at the size of `reference`.

    `known` is the inverse depth of the size before, without holes, or None at the coarsest.
    """
    prior = None
    if known is not None:
        prior = np.asarray(cv2.resize(known, reference.size, interpolation=cv2.INTER_LINEAR), np.float32)
    maps = []
    for pair, source in zip(pairs, sources, strict=True):
        check()
        if prior is None:
            maps.append(match_whole_range(pair, reference, source))
        else:
            maps.append(match_around(pair, reference, source, prior))
    one_pixel = [_one_pixel(pair) for pair in pairs]
    inverse, merged = merge(maps, one_pixel)
    if not merged.any():
        return inverse, merged
    inverse, support = _confirmed(
        reference, sources, inverse, merged, float(np.median(one_pixel)), options, check
    )
    # Speckles by the coarsest pair: by the finest, a steep surface falls apart into single pixels.
    inverse = without_speckles(inverse, options.speckle_px, max(one_pixel))
    support[inverse == 0] = 0
    return inverse, support


def _confirmed(
    view: StereoView,
    sources: Sequence[StereoView],
    inverse: Float32,
    merged: UInt8,
    one_pixel: float,
    options: StereoOptions,
    check: Callable[[], None],
) -> tuple[Float32, UInt8]:
    """`inverse` refined, and kept where enough sources look alike at it."""
    reference = prepared(view)
    moved = refined(reference, sources, filled(inverse), one_pixel, options.iterations)
    check()
    support = np.zeros(inverse.shape, np.uint8)
    alike = np.zeros(inverse.shape, np.uint8)
    best = np.full(inverse.shape, -1, np.float32)
    for source in sources:
        found = compare(reference, source, moved)
        support += found.correlation >= options.min_correlation
        alike += found.likeness >= options.min_correlation
        np.maximum(best, found.correlation, out=best)
    keep = (inverse > 0) & (moved > 0)
    if view.mask_u8 is not None:
        keep &= view.mask_u8 > 0
    agree = (merged >= 2) & (alike >= 2) & (reference.variance >= options.min_variance)
    keep &= (support >= 2) | agree | (best >= options.min_single_correlation)
    support = np.maximum(support, np.minimum(alike, merged))
    return np.where(keep, moved, 0).astype(np.float32), np.where(keep, support, 0).astype(np.uint8)


def _scaled(source: StereoView, size: tuple[int, int], reference: StereoView) -> tuple[int, int]:
    """The size of `source` when `reference` has `size`."""
    scale = size[0] / reference.size[0]
    return max(1, round(source.size[0] * scale)), max(1, round(source.size[1] * scale))


def _one_pixel(pair: RectifiedPair) -> float:
    """Change of inverse depth in the middle of the frame that moves a match by one pixel."""
    per_inverse_depth = pair.disparity_per_inverse_depth()
    return 1.0 / float(per_inverse_depth[pair.height // 2, pair.width // 2])
