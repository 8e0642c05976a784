"""Lay a grid of texels on the surface of one patch, with random patterns.

Patterns are defined in metres: a coarser grid of the same patch shows the same pattern with
its finest octaves missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """Divide `width_m` x `height_m` of surface into texels of `texel_m`; `seed` makes its noise its own."""

    width_m: float
    height_m: float
    texel_m: float
    seed: int

    @property
    def shape(self) -> tuple[int, int]:
        """Return (rows, columns), at least 2 x 2."""
        return max(2, round(self.height_m / self.texel_m)), max(2, round(self.width_m / self.texel_m))

    @property
    def across(self) -> F32:
        """Return (1, W): distance from the left edge in metres, at texel centres."""
        columns = self.shape[1]
        return ((np.arange(columns, dtype=np.float32) + 0.5) * (self.width_m / columns))[None, :]

    @property
    def down(self) -> F32:
        """Return (H, 1): distance from the upper edge in metres, at texel centres."""
        rows = self.shape[0]
        return ((np.arange(rows, dtype=np.float32) + 0.5) * (self.height_m / rows))[:, None]

    def noise(self, key: int, wave_m: float, wave_down_m: float | None = None) -> F32:
        """Return (H, W): smooth Gaussian noise of one wavelength, mean near 0, deviation about 1."""
        rows, columns = self.shape
        step_across = wave_m / self.texel_m
        step_down = (wave_down_m or wave_m) / self.texel_m
        nodes = (math.ceil(rows / step_down) + 2, math.ceil(columns / step_across) + 2)
        rng = np.random.default_rng((self.seed, key))
        lattice = rng.standard_normal(nodes, dtype=np.float32)
        # Cubic interpolation keeps about 0.7 of the deviation of the nodes.
        lattice *= np.float32(1 / 0.7)
        if max(step_across, step_down) < 16:
            size = (round(nodes[1] * step_across), round(nodes[0] * step_down))
            smooth = cv2.resize(lattice, size, interpolation=cv2.INTER_CUBIC)[:rows, :columns]
        else:  # large cells: resizing the whole lattice would make a picture far larger than the patch
            smooth = _cubic(nodes[0], rows, step_down) @ lattice @ _cubic(nodes[1], columns, step_across).T
        return np.asarray(smooth, np.float32)

    def fractal(self, key: int, coarsest_m: float, finest_m: float = 0.0, gain: float = 0.75) -> F32:
        """Return (H, W): octaves from `coarsest_m` down, each `gain` times the one before, deviation about 1."""
        total = np.zeros(self.shape, np.float32)
        power, amplitude, wave_m, octave = 0.0, 1.0, coarsest_m, 0
        while wave_m >= max(finest_m, 1.5 * self.texel_m):
            total += np.float32(amplitude) * self.noise(100 * key + octave, wave_m)
            power += amplitude**2
            amplitude, wave_m, octave = amplitude * gain, wave_m / 2, octave + 1
        return total / np.float32(math.sqrt(power) or 1.0)


def _cubic(nodes: int, count: int, step: float) -> F32:
    """Return (count, nodes): Catmull-Rom interpolation from nodes `step` texels apart."""
    at = (np.arange(count) + 0.5) / step
    first = np.floor(at).astype(np.intp)
    f = at - first
    weights = (
        ((2 - f) * f - 1) * f / 2,
        ((3 * f - 5) * f * f + 2) / 2,
        ((4 - 3 * f) * f + 1) * f / 2,
        (f - 1) * f * f / 2,
    )
    matrix = np.zeros((count, nodes), np.float32)
    for k, weight in enumerate(weights):
        np.add.at(matrix, (np.arange(count), np.clip(first + k - 1, 0, nodes - 1)), weight)
    return matrix


def smoothstep(low: float, high: float, value: F32) -> F32:
    """Return 0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((value - np.float32(low)) / np.float32(high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)
