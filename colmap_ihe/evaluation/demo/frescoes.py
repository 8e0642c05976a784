"""Paint the panels: landscapes, and ornament in two colours that Rec.709 cannot tell apart.

The isoluminant panels mix their two colours in sRGB-coded values, where COLMAP takes its grey:
every mixture then has the same Rec.709 grey, and under any neutral light nearly so.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from colmap_ihe.evaluation.demo.grid import F32, Grid, smoothstep
from colmap_ihe.evaluation.demo.materials import Material, colour, mix, possible
from colmap_ihe.grey.srgb import linear
from colmap_ihe.grey.weights import FIXED

Pattern = Callable[[F32, F32], F32]

BORDER_M = 0.09
_PAIRS = (
    ((0.75, 0.56, 0.45), (0.46, 0.63, 0.67)),  # terracotta and verdigris
    ((0.70, 0.57, 0.66), (0.53, 0.63, 0.44)),  # mauve and moss
    ((0.74, 0.61, 0.46), (0.55, 0.64, 0.76)),  # ochre and smalt
)


def isoluminant(grid: Grid, pattern: Pattern, pair: int = 0) -> F32:
    """Paint a panel of one Rec.709 grey: `pattern` of centred (x, y) in half panel heights, and brushwork."""
    first, second = np.array(_PAIRS[pair], np.float32)
    # the same grey to the last bit: the weights sum to 1
    second = second + np.float32((first - second) @ np.array(FIXED["rec709"], np.float32))
    x, y = _centred(grid)
    drawing = np.tanh(np.float32(4) * pattern(x, y)) + 0.45 * grid.fractal(1, 0.2, gain=1.1)
    drawing += 0.25 * grid.fractal(2, 1.5, 0.1)
    share = np.asarray(cv2.GaussianBlur(np.clip(0.5 + 0.36 * drawing, 0, 1), (0, 0), 0.6), np.float32)
    return linear(mix(first, second, share))


def rosette(x: F32, y: F32) -> F32:
    """Draw a rose window: petals within rings."""
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    petals = np.cos(8 * angle) * np.cos(9 * radius - 1.2) + 0.6 * np.cos(14 * radius)
    ground = np.cos(6 * x + 3 * y) * np.cos(6 * y - 3 * x)
    return np.asarray(np.where(radius < 1.05, petals, ground), np.float32)


def scroll(x: F32, y: F32) -> F32:
    """Draw spiral tendrils side by side, turning to and fro."""
    cell = np.floor(x / 1.1 + 0.5)
    aside = x - 1.1 * cell
    turn = np.where(cell % 2 == 0, 1.0, -1.0)
    angle = np.arctan2(y * turn, aside)
    return np.asarray(np.cos(3 * angle - 11 * np.hypot(aside, y) + cell), np.float32)


def lattice(x: F32, y: F32) -> F32:
    """Draw stars in a net of diamonds."""
    first, second = 5 * (x + y), 5 * (x - y)
    stars = np.cos(first) * np.cos(second) + 0.5 * np.cos(2 * first + 2 * second) * np.cos(6 * x)
    return np.asarray(stars + 0.35 * np.cos(14 * x) * np.cos(14 * y), np.float32)


def landscape(grid: Grid) -> F32:
    """Paint hills under a pale sky, a sun, cypresses: in earth colours, cracked and worn."""
    x, y = _centred(grid)
    blend = smoothstep(-1.0, 0.5, y + 0 * x)
    picture = mix(colour(0.45, 0.58, 0.72), colour(0.88, 0.80, 0.64), blend)
    sun = 1 - smoothstep(0.20, 0.23, np.hypot(x - 0.55, y + 0.42))
    picture = mix(picture, colour(0.86, 0.52, 0.28), 0.9 * sun)
    picture = mix(picture, colour(0.93, 0.90, 0.84), 0.6 * smoothstep(0.5, 1.6, grid.noise(21, 0.9, 0.22)))
    greens = ((0.56, 0.62, 0.58), (0.52, 0.56, 0.38), (0.62, 0.50, 0.32), (0.40, 0.42, 0.27))
    for level, green in enumerate(greens):
        ridge = 0.18 * grid.noise(22 + level, 0.8)[:1] + 0.04 * grid.noise(27 + level, 0.2)[:1]
        below = np.asarray(y + 0.05 - 0.27 * level - ridge, np.float32)
        picture = mix(picture, colour(*green), smoothstep(0, 0.03, below))
    picture = mix(picture, colour(0.22, 0.29, 0.22), _cypresses(grid, x, y))
    wear = 1 + 0.18 * grid.fractal(33, 0.35, gain=1.0) + 0.10 * grid.fractal(34, 2.0, 0.1)
    bare = smoothstep(1.6, 1.7, grid.fractal(35, 0.7, 0.015))
    lime = colour(0.80, 0.74, 0.64) * (1 + 0.1 * grid.noise(36, 0.02))[..., None]
    return possible(mix(picture * wear[..., None], lime, bare))


def framed(grid: Grid, picture: Material) -> F32:
    """Paint `picture` within a border of red and white."""
    x = np.minimum(grid.across, grid.width_m - grid.across)
    y = np.minimum(grid.down, grid.height_m - grid.down)
    inward = np.minimum(x, y) + 0.002 * grid.fractal(41, 0.1)
    red = colour(0.56, 0.25, 0.20) * (1 + 0.16 * grid.fractal(42, 0.3, gain=0.85))[..., None]
    line = colour(0.88, 0.82, 0.70) * (1 + 0.10 * grid.fractal(43, 0.1))[..., None]
    stroke = 1 - smoothstep(0.010, 0.014, np.abs(inward - np.float32(0.55 * BORDER_M)))
    border = mix(red, line, stroke)
    return possible(mix(border, picture(grid), smoothstep(BORDER_M - 0.004, BORDER_M, inward)))


def inscription(grid: Grid, ground: Material, text: str) -> F32:
    """Cut `text` into `ground`, filling about half the height and centred."""
    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_COMPLEX, 4.0, 7)
    letters = np.zeros((height + 40, width + 40), np.uint8)
    cv2.putText(letters, text, (20, height + 20), cv2.FONT_HERSHEY_COMPLEX, 4.0, 255, 7, cv2.LINE_AA)
    scale = 0.5 * grid.shape[0] / height
    rows, columns = grid.shape
    left, top = (letters.shape[1] - columns / scale) / 2, (letters.shape[0] - rows / scale) / 2
    to_letters = np.array(((1 / scale, 0, left), (0, 1 / scale, top)))
    cut = cv2.warpAffine(letters, to_letters, (columns, rows), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    surface = ground(grid)
    return mix(surface, surface * np.float32(0.28), np.asarray(cut / np.float32(255), np.float32))


def _cypresses(grid: Grid, x: F32, y: F32) -> F32:
    """Return (H, W): 1 on the trees, 0 elsewhere."""
    rng = np.random.default_rng((grid.seed, 44))
    half = grid.width_m / grid.height_m
    trees = np.zeros(grid.shape, np.float32)
    for _ in range(5):
        stem, foot, tall = rng.uniform(-0.85, 0.85) * half, rng.uniform(0.25, 0.75), rng.uniform(0.35, 0.7)
        up = (foot - y) / tall
        wide = 0.16 * tall * np.sqrt(np.clip(up * (1 - up), 0, 1)) * (1 + 0.15 * grid.noise(45, 0.05))
        trees = np.maximum(trees, smoothstep(0, 0.02, wide - np.abs(x - np.float32(stem))))
    return trees


def _centred(grid: Grid) -> tuple[F32, F32]:
    """Return (1, W) and (H, 1): x to the right, y down from the middle, in half panel heights."""
    unit = np.float32(grid.height_m / 2)
    return (grid.across - np.float32(grid.width_m / 2)) / unit, grid.down / unit - 1


rose_panel: Material = partial(framed, picture=partial(isoluminant, pattern=rosette, pair=0))
scroll_panel: Material = partial(framed, picture=partial(isoluminant, pattern=scroll, pair=1))
lattice_panel: Material = partial(framed, picture=partial(isoluminant, pattern=lattice, pair=2))
landscape_panel: Material = partial(framed, picture=landscape)
