"""Paint the surfaces: each material gives the linear albedo of a whole grid.

A material is a function `(Grid) -> (H, W, 3) float32`, linear RGB with Rec.709 primaries in
[0, 1]. All are irregular at every scale from metres to texels: repeated or empty walls would
give features that match wrongly, and no depth.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from colmap_ihe.evaluation.demo.grid import F32, Grid, smoothstep
from colmap_ihe.grey.srgb import linear

Material = Callable[[Grid], F32]

_OCHRE, _ROSE = (0.87, 0.77, 0.60), (0.84, 0.68, 0.58)
_PALE = (0.82, 0.78, 0.70)


def mix(first: F32, second: F32, share: F32) -> F32:
    """Return (H, W, 3): `first` where `share` (H, W) is 0, `second` where it is 1."""
    return np.asarray(first + (second - first) * share[..., None], np.float32)


def colour(red: float, green: float, blue: float) -> F32:
    """Return (3,): a linear colour from an sRGB-coded one in [0, 1]."""
    return linear(np.array((red, green, blue), np.float32))


def plaster(grid: Grid, tint: tuple[float, float, float] = _OCHRE, age: float = 1.0) -> F32:
    """Paint lime plaster: cloudy, streaked by rain, cracked; where `age` is high it has fallen off the brick."""
    fine = grid.fractal(1, 0.2, gain=0.95)
    cloud = grid.fractal(2, 5.0, 0.1, gain=0.7)
    surface = colour(*tint) * (1 + 0.17 * fine + 0.12 * cloud)[..., None]
    streaks = smoothstep(0.4, 2.2, grid.noise(31, 0.22, 2.6) + 0.5 * grid.noise(32, 0.07, 1.1) + 0.3 * fine)
    surface = mix(surface, surface * colour(0.62, 0.58, 0.52), 0.75 * age * streaks)
    green = smoothstep(0.9, 2.4, grid.fractal(4, 2.4, 0.02)) * np.float32(0.5 * age)
    surface = mix(surface, surface * colour(0.72, 0.80, 0.66), green)
    cracks = 1 - smoothstep(0.004, 0.03, np.abs(grid.fractal(5, 2.0, 0.06, gain=0.55)))
    surface = mix(surface, surface * np.float32(0.3), 0.7 * age * cracks * (cloud > 0.2))
    lost = smoothstep(1.55, 1.62, grid.fractal(6, 1.6, 0.02, gain=0.6) * np.float32(age))
    if lost.max() > 0:
        rim = np.asarray(cv2.GaussianBlur(lost, (0, 0), max(0.3, 0.012 / grid.texel_m)), np.float32)
        under = brick(grid) * (0.55 + 0.45 * rim)[..., None]
        surface = mix(surface * (1 - 0.35 * rim * (1 - lost))[..., None], under, lost)
    return possible(surface)


def brick(grid: Grid) -> F32:
    """Paint hand-made bricks of many reds in wide lime joints."""
    reds = ((0.66, 0.36, 0.27), (0.74, 0.46, 0.33), (0.56, 0.3, 0.25), (0.78, 0.56, 0.42), (0.48, 0.33, 0.3))
    return masonry(grid, reds, (0.68, 0.63, 0.55), course_m=0.085, length_m=0.27, joint_m=0.014)


def stone(grid: Grid) -> F32:
    """Paint limestone ashlar, each block in its own tone, with fossils and rain marks."""
    palette = (_PALE, (0.76, 0.70, 0.60), (0.86, 0.82, 0.75), (0.70, 0.66, 0.60), (0.80, 0.72, 0.60))
    surface = masonry(grid, palette, (0.45, 0.42, 0.38), course_m=0.45, length_m=0.9, joint_m=0.008)
    marks = smoothstep(0.5, 2.2, grid.noise(41, 0.16, 1.4) + 0.6 * grid.fractal(42, 0.5))
    return mix(surface, surface * colour(0.66, 0.63, 0.58), 0.8 * marks)


def paving(grid: Grid) -> F32:
    """Paint worn slabs, grey and warm."""
    greys = ((0.62, 0.58, 0.53), (0.54, 0.52, 0.5), (0.68, 0.61, 0.52), (0.5, 0.46, 0.43), (0.64, 0.54, 0.47))
    surface = masonry(grid, greys, (0.30, 0.31, 0.26), course_m=0.62, length_m=0.95, joint_m=0.014)
    worn = smoothstep(-0.5, 2.0, grid.fractal(43, 3.0, 0.05))
    return mix(surface, surface * np.float32(1.25), 0.6 * worn)


def marble(grid: Grid) -> F32:
    """Paint grey-white marble with dark veins, for the columns."""
    bend = grid.fractal(1, 0.8, 0.05, gain=0.6)
    vein = np.abs(np.sin(9 * (grid.down * 0.55 + grid.across) + 2.6 * bend))
    surface = colour(0.80, 0.77, 0.73) * (1 + 0.16 * grid.fractal(2, 0.2, gain=1.0))[..., None]
    surface = mix(surface * colour(0.62, 0.60, 0.60), surface, smoothstep(0.02, 0.35, vein + 0.12 * bend))
    stain = smoothstep(0.3, 2.0, grid.fractal(3, 1.0, 0.02))
    return possible(mix(surface, surface * colour(0.74, 0.62, 0.48), 0.8 * stain))


def wood(grid: Grid) -> F32:
    """Paint the oak planks of a door, with iron nails."""
    plank = np.floor(grid.across / 0.19).astype(np.intp)
    tones = np.random.default_rng(grid.seed).uniform(0.6, 1.25, plank.max() + 1).astype(np.float32)[plank]
    grain = grid.noise(1, 0.012, 0.7) + 0.7 * grid.noise(2, 0.03, 0.35) + 0.5 * grid.fractal(3, 0.2)
    gap = np.abs(grid.across / 0.19 - plank - 0.5) > 0.47
    tone = tones * (1 + 0.22 * grain) * np.where(gap, 0.25, 1.0)
    nails = ((grid.across / 0.19) % 1 - 0.5) ** 2 + ((grid.down / 0.38) % 1 - 0.5) ** 2 * 4 < 0.012
    return possible(colour(0.55, 0.42, 0.31) * np.where(nails, 0.35, tone)[..., None])


def masonry(
    grid: Grid,
    palette: tuple[tuple[float, float, float], ...],
    mortar: tuple[float, float, float],
    *,
    course_m: float,
    length_m: float,
    joint_m: float,
) -> F32:
    """Paint blocks in running bond: course height, mean block length and joint width in metres."""
    wobble = grid.fractal(11, 0.5, 0.03) * np.float32(0.25 * joint_m)
    height = np.asarray((grid.down + wobble) / course_m, np.float32)
    row = np.floor(height)
    course = row.astype(np.intp)
    rng = np.random.default_rng((grid.seed, 12))
    courses = course.max() + 2
    shift, stretch = rng.random(courses, np.float32), rng.uniform(0.8, 1.25, courses).astype(np.float32)
    length = np.float32(length_m) * stretch[course]
    along = np.asarray((grid.across + wobble) / length + shift[course] + 0.5 * (row % 2), np.float32)
    column = np.floor(along)
    pick = rng.random((courses, int(column.max()) + 2), np.float32)[course, column.astype(np.intp)]
    edge = np.minimum(_to_edge(height - row) * np.float32(course_m), _to_edge(along - column) * length)
    tones = linear(np.array(palette, np.float32))[(pick * len(palette)).astype(np.intp)]
    fine = grid.fractal(13, 0.14, gain=0.95)
    tone = 0.82 + 0.36 * (pick * 37 % 1) + 0.19 * fine + 0.07 * grid.fractal(14, 3.0, 0.1)
    worn_edge = edge + np.float32(0.15 * joint_m) * fine
    joint = 1 - smoothstep(0.3 * joint_m, 0.7 * joint_m + grid.texel_m, worn_edge)
    lime = colour(*mortar) * (0.85 + 0.15 * fine)[..., None]
    return possible(mix(tones * tone[..., None], lime, 0.85 * joint))


def _to_edge(share: F32) -> F32:
    """Return the distance to the nearer end of a unit interval."""
    return np.asarray(np.minimum(share, 1 - share), np.float32)


def possible(albedo: F32) -> F32:
    """Clip what no surface does: reflect nothing, or everything."""
    return np.asarray(np.clip(albedo, 0.01, 0.9), np.float32)


rose_plaster: Material = partial(plaster, tint=_ROSE)
sound_plaster: Material = partial(plaster, tint=(0.88, 0.83, 0.72), age=0.55)
