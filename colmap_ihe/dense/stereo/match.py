"""Match one pair semi-globally: first over the whole range of depths, then around a given depth.

Hirschmueller 2008, "Stereo processing by semiglobal matching and mutual information", as OpenCV has it.
The second step samples the source where the given depth puts the reference's pixels. So its search is a few pixels
wide however deep the scene is, and slanted surfaces look fronto-parallel to it.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from colmap_ihe.dense.camera import Bool, Float32, UInt8
from colmap_ihe.dense.stereo.rectify import RectifiedPair, inside
from colmap_ihe.dense.stereo.strips import overwrite
from colmap_ihe.dense.stereo.views import StereoView

SUBPIXELS = 16
LEFT_RIGHT_TOLERANCE_PX = 1.0
RESIDUAL_RANGE_PX = 32


def match_whole_range(pair: RectifiedPair, reference: StereoView, source: StereoView) -> Float32:
    """Return inverse depth in the reference (H, W) float32, 0 for none, from the pair's whole range of disparities.

    Matched from both sides; kept where the two agree within `LEFT_RIGHT_TOLERANCE_PX`.
    """
    first = math.floor(pair.disparities[0])
    count = max(16, math.ceil((pair.disparities[1] - first) / 16) * 16)  # as OpenCV's matcher expects
    left = pair.reference_in_frame(reference.grey_u8, count)
    right = pair.source_in_frame(source.grey_u8, count, first)
    forth = _semi_global(left, right, 0, count)
    back = _semi_global(_mirrored(right), _mirrored(left), 0, count)[:, ::-1]
    columns, rows = _grid(forth.shape)
    seen_back = cv2.remap(np.ascontiguousarray(back), columns - np.round(forth), rows, cv2.INTER_NEAREST)
    agree = (forth >= 0) & (seen_back >= 0) & (np.abs(forth - seen_back) <= LEFT_RIGHT_TOLERANCE_PX)
    disparity = (forth + np.float32(first))[:, count:-count]
    return _inverse_depth(pair, reference, source, disparity, agree[:, count:-count])


def match_around(pair: RectifiedPair, reference: StereoView, source: StereoView, prior: Float32) -> Float32:
    """Return inverse depth in the reference (H, W) float32, 0 for none, within some pixels of `prior` (H, W) > 0."""
    pad = RESIDUAL_RANGE_PX // 2
    expected = pair.reference_in_frame(prior, pad)
    # Outside the reference there is no prior and nothing is kept: any disparity will do there.
    expected *= pair.disparity_per_inverse_depth(pad)
    left = pair.reference_in_frame(reference.grey_u8, pad)
    x, y = pair.source_pixels(expected, pad)
    right = cv2.remap(source.grey_u8, x, y, cv2.INTER_LINEAR)
    residual = _semi_global(left, np.asarray(right, np.uint8), -pad, RESIDUAL_RANGE_PX)
    columns, rows = _grid(residual.shape)
    matched = residual >= -pad
    disparity = residual + cv2.remap(expected, columns - residual, rows, cv2.INTER_LINEAR)
    inner = slice(pad, -pad)
    return _inverse_depth(pair, reference, source, disparity[:, inner], matched[:, inner])


def _semi_global(left: UInt8, right: UInt8, first: int, count: int) -> Float32:
    """Return disparities of `left` (H, W) float32 from `first` on; less than `first` where there is none."""
    block = 3
    matcher = cv2.StereoSGBM.create(
        minDisparity=first,
        numDisparities=count,
        blockSize=block,
        P1=8 * block * block,
        P2=32 * block * block,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=3,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    return matcher.compute(left, right).astype(np.float32) / np.float32(SUBPIXELS)


def _inverse_depth(
    pair: RectifiedPair, reference: StereoView, source: StereoView, disparity: Float32, matched: Bool
) -> Float32:
    """Turn disparities in the frame, where `matched` and seen by the source, into inverse depth in the reference."""
    x, y = pair.source_pixels(disparity)
    scale = pair.disparity_per_inverse_depth()
    held = matched & inside(x, y, source) & (scale > 0) & (disparity > 0)
    inverse = np.zeros_like(disparity)
    with np.errstate(divide="ignore", invalid="ignore"):
        overwrite(inverse, disparity / scale, held)
    return pair.to_reference(inverse, reference.size)


def _grid(shape: tuple[int, ...]) -> tuple[Float32, Float32]:
    """Return column and row numbers of every pixel, as cv2.remap expects them."""
    rows, columns = np.indices(shape, dtype=np.float32)
    return columns, rows


def _mirrored(image: UInt8) -> UInt8:
    return np.ascontiguousarray(image[:, ::-1])
