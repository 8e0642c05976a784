"""Find the one of 66 triplets whose grey guides a bilateral filter most like the colour itself (Song).

After Song, Bao, Xu and Yang, "Decolorization: is rgb2gray() out?", SIGGRAPH Asia 2013 Technical Briefs. The
cost of a triplet is how far the joint bilateral filter of the photograph, guided by its grey, is from the
bilateral filter of the photograph. For each of nine pairs of sigmas the local minima of the cost on the
triangle of weights get a vote; the triplet with most votes wins.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.grey.methods.realtime import TOWARDS_REC709, Triplet, weighed
from colmap_ihe.grey.srgb import Float32, checked
from colmap_ihe.grey.weights import shares, triplets

SIGMAS_SPACE = (1, 2, 3)
"""Pixels of the thumbnail."""

SIGMAS_RANGE = (0.05, 0.1, 0.2)
"""Each is half the next, so that its Gaussian is the fourth power of the next one's."""

SIDE = 64
_GRID = triplets(0.1)
_STEPS = ((10, -10), (-10, 10), (10, 0), (-10, 0), (0, 10), (0, -10))  # the six at one step of 0.1
_RADIUS = 3 * max(SIGMAS_SPACE)


def song(rgb: Float32) -> Float32:
    """Return the grey of one photograph with weights of its own, which breaks colour consistency.

    rgb: (H, W, 3) float32 in [0, 1], coded. Returns (H, W) float32 in [0, 1]. R = G = B = v gives v.
    Weights are chosen on a thumbnail of 64 x 64 pixels' area: at 6 megapixels it would take 20 minutes.
    Raises ValueError for another shape or dtype.
    """
    return weighed(rgb, song_weights(rgb))


def song_weights(rgb: Float32) -> Triplet:
    """Return the weights of red, green and blue. Ties go to the least cost, then to the nearest to Rec.709."""
    cost = costs(thumbnail(checked(rgb)))
    votes = sum(local_minima(line) for line in cost.reshape(-1, len(_GRID)))
    total = cost.sum(axis=(0, 1))
    return shares(_GRID[np.lexsort((TOWARDS_REC709, total, -np.asarray(votes)))[0]])


def thumbnail(rgb: Float32) -> Float32:
    """Return rgb shrunk by averaging to an area of 64 x 64 pixels; smaller photographs as they are."""
    height, width = rgb.shape[:2]
    scale = SIDE / float(np.sqrt(height * width))
    if scale >= 1:
        return rgb
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.float32)


def costs(small: Float32) -> NDArray[np.float64]:
    """Return (3, 3, 66): sum of |bilateral - joint bilateral| by sigma in space, sigma in range, and triplet.

    small: (h, w, 3) float32. Windows end at the border and at three sigmas.
    """
    height, width = small.shape[:2]
    side = 2 * _RADIUS + 1
    spatial = _spatial()
    edge = ((_RADIUS, _RADIUS), (_RADIUS, _RADIUS))
    inside = np.pad(np.ones((height, width), np.float32), edge)
    padded = np.dstack([np.pad(small[..., c], edge) for c in range(3)] + [inside])
    grid = np.array(_GRID, np.float32).T / np.float32(100)
    cost = np.zeros((len(SIGMAS_SPACE), len(SIGMAS_RANGE), len(_GRID)))
    for row in range(height):
        windows = np.lib.stride_tricks.sliding_window_view(padded[row : row + side], (side, side), (0, 1))[0]
        # (w, side^2, 4): R, G, B and 1, all 0 outside the photograph
        near = windows.reshape(width, 4, -1).transpose(0, 2, 1)
        away = near[..., :3] - small[row][:, None]
        squared = np.concatenate([(away @ grid) ** 2, (away**2).sum(axis=2, keepdims=True)], axis=2)
        weight = np.exp(squared / np.float32(-2 * SIGMAS_RANGE[-1] ** 2))
        masses = (near[:, :, None] * spatial[..., None]).reshape(width, side * side, -1)
        for number in reversed(range(len(SIGMAS_RANGE))):
            sums = (weight.transpose(0, 2, 1) @ masses).reshape(width, -1, len(SIGMAS_SPACE), 4)
            filtered = sums[..., :3] / sums[..., 3:]
            apart = np.abs(filtered[:, :-1] - filtered[:, -1:])
            cost[:, number] += apart.sum(axis=(0, 3), dtype=np.float64).T
            weight *= weight
            weight *= weight
    return cost


def local_minima(cost: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return (66,): 1 where the cost (66,) of a triplet is below that of all its neighbours on the triangle."""
    known = dict(zip(_GRID, cost, strict=True))
    lowest = []
    for red, green, blue in _GRID:
        around = [known.get((red + r, green + g, blue - r - g), np.inf) for r, g in _STEPS]
        lowest.append(known[red, green, blue] < min(around))
    return np.array(lowest, np.int64)


def _spatial() -> Float32:
    """Return (side^2, 3): Gaussian in space for each sigma, cut at three sigmas."""
    rows, columns = np.mgrid[-_RADIUS : _RADIUS + 1, -_RADIUS : _RADIUS + 1]
    squared = (rows**2 + columns**2).reshape(-1, 1)
    sigmas = np.array(SIGMAS_SPACE)
    weight = np.exp(-squared / (2 * sigmas**2)) * (squared <= (3 * sigmas) ** 2)
    return np.asarray(weight, np.float32)
