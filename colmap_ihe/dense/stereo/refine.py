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
from colmap_ihe.dense.stereo.strips import strips
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
    """Hold the reference's grey values with the local statistics that every comparison needs, from the row `top` on."""

    view: StereoView
    grey: Float32
    mean: Float32
    variance: Float32
    top: int = 0

    def of(self, rows: slice) -> Reference:
        """Return some rows of it."""
        top = self.top + rows.start
        return Reference(self.view, self.grey[rows], self.mean[rows], self.variance[rows], top)


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
class Projection:
    """Hold the OpenCV positions `x` and `y` in a source of a reference's pixels at some depth, and where it sees them;
    and for the derivative by inverse depth the `epipole` (3,) and the inverse `scale` of homogeneous positions."""

    x: Float32
    y: Float32
    seen: Bool
    scale: Float32
    epipole: Float64

    def derivative(self) -> tuple[Float32, Float32]:
        """Return how far a pixel moves by inverse depth."""
        across, down, along = self.epipole.astype(np.float32)
        half = np.float32(0.5)
        return (across - (self.x + half) * along) * self.scale, (down - (self.y + half) * along) * self.scale


@dataclass(frozen=True)
class _Match:
    """Hold where a source sees the reference's pixels at the present depth, its grey values there, and the statistics
    of their windows."""

    at: Projection
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
    correlation, likeness, brighter, off, most = (np.empty_like(inverse_depth) for _ in range(5))
    seen = np.empty(inverse_depth.shape, bool)
    for strip in strips(inverse_depth.shape, WINDOW_PX // 2):
        own, inner = strip.own, strip.inner
        part = reference.of(strip.seen)
        match = _match(part, source, inverse_depth[strip.seen])
        expected = _expected(part, match.variance)[inner]
        seen[own], correlation[own] = match.at.seen[inner], match.correlation[inner]
        likeness[own] = np.where(seen[own], correlation[own] + NOISE_VARIANCE / expected, -1)
        brighter[own] = (match.grey - part.grey)[inner]
        off[own] = brighter[own] - (match.mean - part.mean)[inner]
        contrast = np.sqrt(np.minimum(part.variance, match.variance)[inner])
        most[own] = np.maximum(np.float32(_MOST_LEVELS), np.float32(_MOST_CONTRAST) * contrast)
    # The mean of a small window is no measure of how much brighter a source is where part of the window sees something
    # else.
    brighter -= _light(brighter, seen & (correlation >= _CLEAR_CORRELATION))
    same = (_around(off) <= _SURE_LEVELS) | (_around(brighter) <= most)
    return Comparison(correlation, likeness, same)


def _light(brighter: Float32, clear: Bool) -> Float32:
    """Return how many levels the source is brighter around each pixel, from those that are `clear`."""
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
    height, width = inverse_depth.shape
    u, v = np.arange(width) + 0.5, np.arange(reference.top, reference.top + height) + 0.5
    at = project(reference.view, source, u[None, :], v[:, None], inverse_depth)
    grey = sampled(source, at.x, at.y)
    mean = _window_mean(grey)
    variance = np.maximum(_window_mean(grey * grey) - mean * mean, 0)
    covariance = _window_mean(grey * reference.grey) - mean * reference.mean
    correlation = np.where(at.seen, covariance / _expected(reference, variance), -1)
    return _Match(at, grey, mean, variance, correlation)


def _expected(reference: Reference, variance: Float32) -> Float32:
    """Return the covariance of windows that look alike."""
    return np.sqrt((variance + NOISE_VARIANCE) * (reference.variance + NOISE_VARIANCE))


def _pull(reference: Reference, source: StereoView, match: _Match) -> tuple[Float32, Float32]:
    """Return numerator and denominator (H, W) of the change of inverse depth that a source alone asks for."""
    # One pixel along the epipolar line, for the derivative by central difference.
    dx, dy = match.at.derivative()
    length: Float32 = np.maximum(np.sqrt(dx * dx + dy * dy), np.float32(1e-12))
    half = np.float32(0.5) / length
    half_x, half_y = dx * half, dy * half
    x, y = match.at.x, match.at.y
    slope = sampled(source, x + half_x, y + half_y) - sampled(source, x - half_x, y - half_y)
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
        moved = np.empty_like(inverse_depth)
        for strip in strips(inverse_depth.shape, WINDOW_PX // 2):
            step = _step(reference.of(strip.seen), sources, inverse_depth[strip.seen], one_pixel)
            moved[strip.own] = inverse_depth[strip.own] + step[strip.inner]
        inverse_depth = moved
    return inverse_depth


def _step(
    reference: Reference, sources: Sequence[StereoView], inverse_depth: Float32, one_pixel: float
) -> Float32:
    numerator, denominator = np.zeros((2, *inverse_depth.shape), np.float32)
    for source in sources:
        match = _match(reference, source, inverse_depth)
        own_numerator, own_denominator = _pull(reference, source, match)
        weight = np.square(np.clip((match.correlation - 0.3) / 0.7, 0, 1))
        numerator += weight * own_numerator
        denominator += weight * own_denominator
    step = numerator / (denominator + np.float32(1e-3 / one_pixel**2))
    return np.asarray(np.clip(step, -one_pixel, one_pixel), np.float32)


def project(
    reference: StereoView,
    source: StereoView,
    u: NDArray[np.floating],
    v: NDArray[np.floating],
    inverse_depth: Float32,
) -> Projection:
    """Return where the source sees the reference's pixels at `inverse_depth`. `u` and `v` are the pixels' columns and
    rows, the first one at 0.5, which broadcast to the shape of `inverse_depth`."""
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
    scale = np.reciprocal(np.maximum(c, np.float32(1e-6))) * in_front
    x, y = a * scale - np.float32(0.5), b * scale - np.float32(0.5)
    return Projection(x, y, in_front & inside(x, y, source), scale, epipole)


def sampled(view: StereoView, x: Float32, y: Float32) -> Float32:
    """Return the grey values (H, W) float32 of a photograph at OpenCV positions (H, W) float32."""
    values = cv2.remap(view.grey_u8, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values, np.float32)


def _window_mean(image: Float32) -> Float32:
    return np.asarray(cv2.blur(image, (WINDOW_PX, WINDOW_PX), borderType=cv2.BORDER_REFLECT_101), np.float32)
