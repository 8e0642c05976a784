"""Measure the depth of thin things on exact scenes: poles, a fence, a balustrade, a window with bars.

    python benchmarks/thin.py [--scenes poles-8 poles-4 fence balustrade window arch]
        [--noise 1.5] [--blur 0] [--json]

Every scene is ray cast from planes with a texture, 1200x800 pixels, seen from six places. Of the pixels that see the
thin thing: the shares with its depth, with the depth of what is behind it, with another depth and with none. Of those
that see what is behind it within 4 pixels of it: the shares with the right depth, with a wrong one and with none.
A depth is right within 2 %. "2 to 4 px away": those that do not touch the thing; half a pixel decides which
side the others see. The arch, with a finial and a cable, stands before the sky, where any depth is wrong; "in the sky"
is the share of all depths that lie there.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.commandline.bars import print_table
from colmap_ihe.dense.camera import Float64, UInt8
from colmap_ihe.dense.stereo.depth import depth_and_normals
from colmap_ihe.dense.stereo.views import StereoView

SIZE, FOCAL_PX = (1200, 800), 1000.0
NEAR_M, FAR_M = 5.0, 10.0
CENTRES_M = ((0.0, 0.0), (-1.0, 0.0), (-0.5, 0.2), (0.5, -0.2), (1.0, 0.0), (0.1, 0.6))
NEAREST_M = 0.1  # any that nothing has
SKY = 195, 25  # grey levels at the top, and fewer at the bottom
RIGHT = 0.02
BESIDE_PX = 4
POINTS = 3000
CELL_M = 0.01  # of the texture
_Bools = NDArray[np.bool_]
_Shape = Callable[[Float64, Float64], _Bools]


@dataclass(frozen=True)
class Layer:
    """Describe a plane at `depth_m`, there where `shape` of x and y in metres says so, of a mean grey level."""

    depth_m: float
    shape: _Shape
    grey: float
    seed: int
    thin: bool = False


def _everywhere(x: Float64, y: Float64) -> _Bools:
    return np.ones(np.broadcast_shapes(x.shape, y.shape), bool)


def _bars(width_px: float, every_px: float, depth_m: float = NEAR_M) -> _Shape:
    """Return upright bars, as wide and as far apart as so many pixels show at `depth_m`."""
    width, every = (px * depth_m / FOCAL_PX for px in (width_px, every_px))
    return lambda x, _: np.abs((x + 0.013) % every - every / 2) < width / 2


def _rails(width_px: float, heights_m: Sequence[float], depth_m: float = NEAR_M) -> _Shape:
    half = width_px * depth_m / FOCAL_PX / 2
    return lambda _, y: np.any([np.abs(y - height) < half for height in heights_m], axis=0)


def _either(*shapes: _Shape) -> _Shape:
    return lambda x, y: np.any([shape(x, y) for shape in shapes], axis=0)


def _between_rails(bars: _Shape, height_m: float) -> _Shape:
    return lambda x, y: bars(x, y) & (np.abs(y) < height_m)


def _arch(x: Float64, y: Float64) -> _Bools:
    ring = (np.abs(np.hypot(x, y) - 2.15) < 0.45) & (y < 0)
    legs = (np.abs(np.abs(x) - 2.15) < 0.45) & (y >= 0)
    finial = (np.abs(x) < 0.02) & (np.abs(y + 2.8) < 0.3) | (np.hypot(x, y + 3.1) < 0.06)
    cable = (np.abs(y + 0.6 + 0.1 * x) < 0.02) & (np.abs(x) < 1.9)
    return ring | legs | finial | cable


def _around_opening(x: Float64, y: Float64) -> _Bools:
    return (np.abs(x) > 2.0) | (np.abs(y) > 1.5)


WALL = Layer(FAR_M, _everywhere, 140, 1)
SCENES = {
    "poles-8": (WALL, Layer(NEAR_M, _bars(8, 270), 80, 2, thin=True)),
    "poles-4": (WALL, Layer(NEAR_M, _bars(4, 270), 80, 2, thin=True)),
    "fence": (WALL, Layer(8.0, _either(_bars(10, 34, 8.0), _rails(10, (-1, 1), 8.0)), 175, 3, thin=True)),
    "balustrade": (
        WALL,
        Layer(
            NEAR_M, _either(_between_rails(_bars(24, 64), 1.0), _rails(30, (-1.0, 1.0))), 110, 4, thin=True
        ),
    ),
    "window": (
        Layer(11.0, _everywhere, 70, 5),
        Layer(8.0, _around_opening, 150, 6),
        Layer(8.0, _either(_bars(6, 80, 8.0), _rails(6, (-1, -0.5, 0, 0.5, 1), 8.0)), 120, 7, thin=True),
    ),
    "arch": (Layer(8.0, _arch, 110, 4, thin=True),),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--noise", type=float, default=1.5, help="in grey levels")
    parser.add_argument("--blur", type=float, default=0.0, help="sigma in pixels, as of a lens")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parsed = parser.parse_args()
    figures = {name: measured(SCENES[name], parsed.noise, parsed.blur) for name in parsed.scenes}
    if parsed.json:
        print(json.dumps(figures, indent=2))
        return
    measures = figures[parsed.scenes[0]]
    rows = [(row, *(f"{figures[name][row]:.2f} %" for name in figures)) for row in measures]
    print_table("", rows, ("", *figures))


def measured(layers: Sequence[Layer], noise_levels: float, blur_px: float) -> dict[str, float]:
    """Return the figures of one scene, in percent."""
    scene = [rendered(layers, centre, noise_levels, blur_px) for centre in CENTRES_M]
    reference, true, thin = scene[0]
    points = _sparse_points(true)
    depth = depth_and_normals(reference, [view for view, _, _ in scene[1:]], points).depth
    around = np.ones((2 * BESIDE_PX + 1,) * 2, np.uint8)
    touching = np.asarray(cv2.dilate(thin.astype(np.uint8), np.ones((3, 3), np.uint8)), bool)
    beside = np.asarray(cv2.dilate(thin.astype(np.uint8), around), bool) & ~thin
    behind = cv2.dilate(np.where(thin, NEAREST_M, true), np.ones((61, 61), np.uint8))
    right, at_behind = np.abs(depth / true - 1) <= RIGHT, np.abs(depth / behind - 1) <= RIGHT
    with_depth = depth > 0
    return {
        "thin, right": _percent(right[thin]),
        "thin, at the depth behind": _percent((at_behind & ~right)[thin]),
        "thin, another depth": _percent((with_depth & ~right & ~at_behind)[thin]),
        "thin, none": _percent(~with_depth[thin]),
        "beside, right": _percent(right[beside]),
        "beside, wrong": _percent((with_depth & ~right)[beside]),
        "beside, wrong, 2 to 4 px away": _percent((with_depth & ~right)[beside & ~touching]),
        "beside, none": _percent(~with_depth[beside]),
        "in the sky": _percent(np.isinf(true)[with_depth]),
    }


def rendered(
    layers: Sequence[Layer], centre_m: tuple[float, float], noise_levels: float, blur_px: float
) -> tuple[StereoView, Float64, _Bools]:
    """Return what a camera at `centre_m` sees that looks at the middle of the wall, its true depth (H, W), and which
    pixels see a thin thing."""
    toward = np.array([-centre_m[0], -centre_m[1], FAR_M])
    z = toward / np.linalg.norm(toward)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(z, x), z])
    centre = np.array([*centre_m, 0.0])
    K = np.array([[FOCAL_PX, 0, SIZE[0] / 2], [0, FOCAL_PX, SIZE[1] / 2], [0, 0, 1]])
    parts = [_cast(layers, K, rotation, centre, (i, j)) for i in (0.25, 0.75) for j in (0.25, 0.75)]
    grey = np.mean([part[0] for part in parts], axis=0)
    if blur_px:
        grey = cv2.GaussianBlur(grey, (0, 0), blur_px)
    noise = np.random.default_rng(zlib.crc32(centre.tobytes())).normal(scale=noise_levels, size=grey.shape)
    grey_u8: UInt8 = np.clip(np.round(grey + noise), 0, 255).astype(np.uint8)
    _, depth, thin = _cast(layers, K, rotation, centre, (0.5, 0.5))
    pose = np.column_stack([rotation, -rotation @ centre])
    return StereoView(K, pose, SIZE, grey_u8), depth, thin


def _cast(
    layers: Sequence[Layer], K: Float64, rotation: Float64, centre: Float64, inside_pixel: tuple[float, float]
) -> tuple[Float64, Float64, _Bools]:
    """Return grey levels, depth and which are thin, at one place of every pixel."""
    u, v = np.meshgrid(np.arange(SIZE[0]) + inside_pixel[0], np.arange(SIZE[1]) + inside_pixel[1])
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T @ rotation
    sky = SKY[0] - SKY[1] * v / SIZE[1]
    grey, depth, thin = sky, np.full(u.shape, np.inf), np.zeros(u.shape, bool)
    for layer in layers:
        distance = layer.depth_m / rays[..., 2]  # a ray's distance is its depth
        x, y = (centre[axis] + distance * rays[..., axis] for axis in (0, 1))
        hit = layer.shape(x, y) & (distance < depth)
        texture = _texture(layer.seed)
        column, row = (((side / CELL_M) % (len(texture) - 2)).astype(np.float32) for side in (x, y))
        level = layer.grey + cv2.remap(texture, column, row, cv2.INTER_LINEAR)
        grey[hit], depth[hit], thin[hit] = level[hit], distance[hit], layer.thin
    return grey, depth, thin


@cache
def _texture(seed: int) -> NDArray[np.float32]:
    """Return grey levels around 0, as of plaster and stone: fine grain and coarse stains."""
    noise = np.random.default_rng(seed).normal(size=(1024, 1024)).astype(np.float32)
    grains = [cv2.GaussianBlur(noise, (0, 0), sigma) for sigma in (1.0, 4.0, 16.0)]
    return np.asarray(sum(10 * grain / grain.std() for grain in grains), np.float32)


def _sparse_points(true: Float64) -> Float64:
    """Return (N, 3): what random pixels of the reference see, whose camera is the world's frame."""
    v, u = (np.random.default_rng(0).integers(0, size, POINTS) for size in (SIZE[1], SIZE[0]))
    rays = [(u + 0.5 - SIZE[0] / 2) / FOCAL_PX, (v + 0.5 - SIZE[1] / 2) / FOCAL_PX, np.ones(POINTS)]
    depth = true[v, u][:, None]
    return np.asarray((np.stack(rays, axis=1) * depth)[np.isfinite(depth[:, 0])])


def _percent(values: _Bools) -> float:
    return round(100 * float(np.mean(values)), 2)


if __name__ == "__main__":
    main()
