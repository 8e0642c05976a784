"""Refine the depth of one reference to less than a pixel, against all its sources at once.

The semi-global matcher prefers whole pixels (its cost is sampled at them). Here every pixel's inverse
depth moves along its ray until a small window looks most alike in the reference and in all sources that
see it: Gauss-Newton (Lucas and Kanade 1981) on grey values whose local mean and contrast have been
equalised. Each source weighs by the precision its baseline and texture give. The normalised correlation
(ZNCC) left at the end is the check that a depth is supported by a source.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.dense.camera import Bool, Float32, Float64
from colmap_ihe.dense.stereo.rectify import inside
from colmap_ihe.dense.stereo.views import StereoView

WINDOW_PX = 7
NOISE_VARIANCE = 4.0
# A window that is mostly of what is behind a thin thing correlates at the depth behind. The thing itself does not: its
# grey values, made as bright as the source around, differ by more than so many levels, and than so many times the
# contrast that both windows have. Small differences from the windows' own means are enough to be alike.
_MOST_LEVELS, _MOST_CONTRAST = 6.0, 0.75
_SURE_LEVELS = 4.0
_LIGHT_PX = 31  # window over which a source may be brighter
_MOST_BRIGHTER = 40.0  # than usual in a pair, in levels
_CLEAR_CORRELATION = 0.6  # of the pixels that tell how much brighter a source is


@dataclass(frozen=True)
class Reference:
    """Hold the reference's grey values with the local statistics that every comparison needs."""

    view: StereoView
    grey: Float32
    mean: Float32
    variance: Float32


@dataclass(frozen=True)
class Comparison:
    """Compare the reference and one source at the present depth: all (H, W).

    `correlation` -1..1 is 0 where there is nothing to compare; `likeness` -1..1 is 1 there, and the
    same elsewhere; both are -1 where the source does not see the pixel. `same` tells where the pixel itself and those
    that touch it look alike, not only their windows.
    """

    correlation: Float32
    likeness: Float32
    same: Bool


@dataclass(frozen=True)
class _Match:
    """Hold where a source sees the reference's pixels at the present depth, as `project` returns it, its grey values
    there, and the statistics of their windows."""

    x: Float32
    y: Float32
    dx: Float32
    dy: Float32
    seen: Bool
    grey: Float32
    mean: Float32
    variance: Float32
    correlation: Float32


def prepared(view: StereoView) -> Reference:
    """Return `view` with its local means and variances."""
    grey = view.grey_u8.astype(np.float32)
    mean = _window_mean(grey)
    return Reference(view, grey, mean, np.maximum(_window_mean(grey * grey) - mean * mean, 0))


def compare(reference: Reference, source: StereoView, inverse_depth: Float32) -> Comparison:
    """Tell how a source supports `inverse_depth` (H, W) float32, > 0, of the reference."""
    match = _match(reference, source, inverse_depth)
    noise = NOISE_VARIANCE / _expected(reference, match.variance)
    likeness = np.where(match.seen, match.correlation + noise, -1)
    return Comparison(match.correlation, likeness, _same(reference, match))


def _same(reference: Reference, match: _Match) -> Bool:
    """Tell which pixels look alike themselves. The mean of a small window is no measure of how much brighter a source
    is where part of the window sees something else."""
    brighter = match.grey - reference.grey
    from_means = _around(brighter - (match.mean - reference.mean))
    from_light = _around(brighter - _light(brighter, match))
    contrast = np.sqrt(np.minimum(reference.variance, match.variance))
    most = np.maximum(np.float32(_MOST_LEVELS), np.float32(_MOST_CONTRAST) * contrast)
    return np.asarray((from_means <= _SURE_LEVELS) | (from_light <= most))


def _light(brighter: Float32, match: _Match) -> Float32:
    """Return how many levels the source is brighter around each pixel, from those whose windows match."""
    clear = match.seen & (match.correlation >= _CLEAR_CORRELATION)
    usual = np.float32(np.median(brighter[clear])) if clear.any() else np.float32(0)
    clear &= np.abs(brighter - usual) < _MOST_BRIGHTER
    side = (_LIGHT_PX, _LIGHT_PX)
    weight = cv2.blur(clear.astype(np.float32), side)
    local = cv2.blur(((brighter - usual) * clear).astype(np.float32), side) / np.maximum(
        weight, np.float32(1e-6)
    )
    return np.asarray(usual + local, np.float32)


def _around(levels: Float32) -> Float32:
    """Return the mean size of the values of each pixel and those that touch it."""
    return np.asarray(cv2.blur(np.abs(levels), (3, 3)), np.float32)


def _match(reference: Reference, source: StereoView, inverse_depth: Float32) -> _Match:
    u, v = (np.arange(side) + 0.5 for side in reference.view.size)
    x, y, dx, dy, seen = project(reference.view, source, u[None, :], v[:, None], inverse_depth)
    grey = sampled(source, x, y)
    mean = _window_mean(grey)
    variance = np.maximum(_window_mean(grey * grey) - mean * mean, 0)
    covariance = _window_mean(grey * reference.grey) - mean * reference.mean
    correlation = np.where(seen, covariance / _expected(reference, variance), -1)
    return _Match(x, y, dx, dy, seen, grey, mean, variance, correlation)


def _expected(reference: Reference, variance: Float32) -> Float32:
    """Return the covariance of windows that look alike."""
    return np.sqrt((variance + NOISE_VARIANCE) * (reference.variance + NOISE_VARIANCE))


def _pull(reference: Reference, source: StereoView, match: _Match) -> tuple[Float32, Float32]:
    """Return numerator and denominator (H, W) of the change of inverse depth that a source alone asks for."""
    # One pixel along the epipolar line, for the derivative by central difference.
    length: Float32 = np.maximum(np.sqrt(match.dx * match.dx + match.dy * match.dy), np.float32(1e-12))
    half = np.float32(0.5) / length
    half_x, half_y = match.dx * half, match.dy * half
    after, before = (sampled(source, match.x + s * half_x, match.y + s * half_y) for s in (1, -1))
    slope = after - before
    slope_mean = _window_mean(slope)
    gain = np.sqrt((reference.variance + NOISE_VARIANCE) / (match.variance + NOISE_VARIANCE))
    slope_reference = _window_mean(slope * reference.grey) - slope_mean * reference.mean
    slope_source = _window_mean(slope * match.grey) - slope_mean * match.mean
    slope_square = np.maximum(_window_mean(slope * slope) - slope_mean * slope_mean, 0)
    lengthened = length * gain
    return lengthened * (slope_reference - gain * slope_source), lengthened * lengthened * slope_square


def refined(
    reference: Reference,
    sources: Sequence[StereoView],
    inverse_depth: Float32,
    one_pixel: float,
    iterations: int,
) -> Float32:
    """Return `inverse_depth` (H, W) float32, > 0, moved to where the sources agree best, by `one_pixel` at most
    in each iteration."""
    for _ in range(iterations):
        numerator = np.zeros_like(inverse_depth)
        denominator = np.zeros_like(inverse_depth)
        for source in sources:
            match = _match(reference, source, inverse_depth)
            own_numerator, own_denominator = _pull(reference, source, match)
            weight = np.square(np.clip((match.correlation - 0.3) / 0.7, 0, 1))
            numerator += weight * own_numerator
            denominator += weight * own_denominator
        floor = np.float32(1e-3 / one_pixel**2)
        step = numerator / (denominator + floor)
        inverse_depth = inverse_depth + np.clip(step, -one_pixel, one_pixel)
    return inverse_depth


def project(
    reference: StereoView,
    source: StereoView,
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    inverse_depth: Float32,
) -> tuple[Float32, Float32, Float32, Float32, Bool]:
    """Return OpenCV positions in the source of the reference's pixels at `inverse_depth`, their derivative by inverse
    depth, and whether the source sees them. `u` and `v` are the pixels' columns and rows, the first one at 0.5, which
    broadcast to the shape of `inverse_depth`."""
    rotation = source.rotation @ reference.rotation.T
    translation = source.cam_from_world[:, 3] - rotation @ reference.cam_from_world[:, 3]
    infinite: Float64 = source.K @ rotation @ np.linalg.inv(reference.K)
    epipole: Float64 = source.K @ translation
    a, b, c = (
        (row[0] * u).astype(np.float32)
        + (row[1] * v + row[2]).astype(np.float32)
        + np.float32(shift) * inverse_depth
        for row, shift in zip(infinite, epipole, strict=True)
    )
    in_front = c > 1e-6
    scale = np.where(in_front, 1 / np.where(in_front, c, 1), 0).astype(np.float32)
    x, y = a * scale, b * scale
    dx = (np.float32(epipole[0]) - x * np.float32(epipole[2])) * scale
    dy = (np.float32(epipole[1]) - y * np.float32(epipole[2])) * scale
    x, y = x - np.float32(0.5), y - np.float32(0.5)
    return x, y, dx, dy, in_front & inside(x, y, source)


def sampled(view: StereoView, x: Float32, y: Float32) -> Float32:
    """Return the grey values (H, W) float32 of a photograph at OpenCV positions (H, W) float32."""
    values = cv2.remap(view.grey_u8, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float32)


def _window_mean(image: Float32) -> Float32:
    return np.asarray(cv2.blur(image, (WINDOW_PX, WINDOW_PX), borderType=cv2.BORDER_REFLECT_101), np.float32)
