"""Cast rays: what each view sees of the scene, and how far it is."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from colmap_ihe.evaluation.demo.grid import F32, Grid
from colmap_ihe.evaluation.demo.light import irradiance, skylight, sunlight
from colmap_ihe.evaluation.demo.scene import Patch
from colmap_ihe.evaluation.demo.shapes import Shape, Vector, corners_of
from colmap_ihe.evaluation.demo.views import DemoView

_LEVELS = 5  # of each texture, each half as fine as the one before
_BAND_ROWS = 96  # rays are cast in bands of so many rows, which fit the processor's cache
_SUPERSAMPLING = 2
_NEAR_M = 0.3
_ZENITH, _HORIZON = np.array((0.30, 0.50, 0.80), np.float32), np.array((0.72, 0.80, 0.86), np.float32)


@dataclass(frozen=True)
class Surface:
    """Hold a patch with light on it: `pyramid` holds (H, W, 3) float32 linear radiance, finest first."""

    shape: Shape
    texel_m: float
    pyramid: tuple[F32, ...]


@dataclass(frozen=True)
class Rendering:
    """Hold `radiance` (H, W, 3) float32, linear RGB, Rec.709 primaries, white in the sun near 1;
    `depth` (H, W) float32, metres along the optical axis at pixel centres, 0 where nothing is."""

    radiance: F32
    depth: F32


def bake(scene: Sequence[Patch], texel_m: float, seed: int, executor: Executor) -> list[Surface]:
    """Return the scene's textures with light on them; `texel_m` is the finest texel."""
    grids = [Grid(*p.shape.size_m, texel_m * p.texel, seed * 1009 + k) for k, p in enumerate(scene)]
    suns = sunlight(scene, grids, executor)
    skies = skylight(scene, grids, executor)

    def surface(patch: Patch, grid: Grid, sun: F32, sky: F32) -> Surface:
        pyramid = [patch.material(grid) * irradiance(sun, sky, grid.shape)]
        while len(pyramid) < _LEVELS and min(pyramid[-1].shape[:2]) > 3:
            pyramid.append(np.asarray(cv2.pyrDown(pyramid[-1]), np.float32))
        return Surface(patch.shape, grid.texel_m, tuple(pyramid))

    return list(executor.map(surface, scene, grids, suns, skies))


def render(surfaces: Sequence[Surface], view: DemoView) -> Rendering:
    """Render one view; colour from 2 x 2 rays a pixel, depth from one ray through its centre."""
    radiance = np.empty((view.height, view.width, 3), np.float32)
    depth = np.empty((view.height, view.width), np.float32)
    visible = [(s, _pixel_bounds(s.shape, view)) for s in surfaces if s.shape.faces(view.centre)]
    for top in range(0, view.height, _BAND_ROWS):
        bottom = min(top + _BAND_ROWS, view.height)
        centres = _Rays(view, top, bottom, 1)
        nearest, _ = _cast(visible, centres)
        depth[top:bottom] = np.where(np.isfinite(nearest), nearest, 0)
        rays = _Rays(view, top, bottom, _SUPERSAMPLING)
        fine = _shade(visible, rays, *_cast(visible, rays))
        radiance[top:bottom] = cv2.resize(fine, (view.width, bottom - top), interpolation=cv2.INTER_AREA)
    return Rendering(radiance, depth)


class _Rays:
    """Hold the rays through rows `top` to `bottom` of a view, `samples` a pixel along each side. `direction` is three
    (h, w) arrays in the world with camera z = 1, so that t is the depth."""

    def __init__(self, view: DemoView, top: int, bottom: int, samples: int) -> None:
        columns = (np.arange(view.width * samples) + 0.5) / samples
        rows = (np.arange(top * samples, bottom * samples) + 0.5) / samples
        x = (columns - view.width / 2)[None, :] / view.focal_px
        y = (rows - view.height / 2)[:, None] / view.focal_px
        axes = view.cam_from_world[:, :3].T
        self.direction: Vector = [(r * x + d * y + f).astype(np.float32) for r, d, f in axes]
        self.origin: Vector = [np.asarray(k, np.float32) for k in view.centre]
        self.shape = self.direction[0].shape
        self.top, self.samples = top, samples
        self.spacing = 1 / (view.focal_px * samples)  # metres between neighbouring rays at 1 m

    def window(self, bounds: tuple[int, int, int, int]) -> tuple[slice, slice] | None:
        """Return the rays within (left, top, right, bottom) pixels, None if there are none."""
        left, top, right, bottom = (n * self.samples for n in bounds)
        offset = self.top * self.samples
        rows = slice(max(top - offset, 0), min(bottom - offset, self.shape[0]))
        columns = slice(left, right)
        return (rows, columns) if rows.start < rows.stop and left < right else None


Visible = Sequence[tuple[Surface, tuple[int, int, int, int]]]


def _cast(visible: Visible, rays: _Rays) -> tuple[F32, npt.NDArray[np.int16]]:
    """Return depth (inf where nothing is hit) and index of the nearest surface (-1) of each ray."""
    nearest = np.full(rays.shape, np.inf, np.float32)
    index = np.full(rays.shape, -1, np.int16)
    for k, (surface, bounds) in enumerate(visible):
        window = rays.window(bounds)
        if window is None:
            continue
        t = surface.shape.hit(rays.origin, [d[window] for d in rays.direction])
        closer = t < nearest[window]
        np.copyto(nearest[window], t, where=closer)
        np.copyto(index[window], np.int16(k), where=closer)
    return nearest, index


def _shade(visible: Visible, rays: _Rays, depth: F32, index: npt.NDArray[np.int16]) -> F32:
    """Return (h, w, 3): radiance along each ray."""
    height = np.clip(rays.direction[2] * np.float32(1.6), 0, 1)[..., None]
    radiance = np.asarray(_HORIZON + (_ZENITH - _HORIZON) * height, np.float32)
    for k in np.unique(index):
        if k < 0:
            continue
        surface, bounds = visible[int(k)]
        window = rays.window(bounds)
        hit = index[window] == k
        t = depth[window][hit]
        direction = [d[window][hit] for d in rays.direction]
        point = [o + t * d for o, d in zip(rays.origin, direction, strict=True)]
        across, down = surface.shape.locate(point)
        _, normal = surface.shape.surface(across, down)
        length = np.sqrt(sum(d * d for d in direction))
        cosine = np.abs(sum(n * d for n, d in zip(normal, direction, strict=True))) / length
        # Seen at a slant a ray's footprint grows one way only: the geometric mean is neither
        # the blur of the long side nor the aliasing of the short one.
        footprint = t * np.float32(rays.spacing) / np.sqrt(np.maximum(cosine, np.float32(0.05)))
        radiance[window][hit] = _sample(surface, across, down, footprint)
    return radiance


def _sample(surface: Surface, across: F32, down: F32, footprint_m: F32) -> F32:
    """Return (N, 3): radiance at N points, averaged over about `footprint_m`, between two texture levels."""
    last = len(surface.pyramid) - 1
    level = np.clip(np.log2(footprint_m / np.float32(surface.texel_m)) + np.float32(0.3), 0, last)
    total = np.zeros((across.size, 3), np.float32)
    for k in range(int(level.min()), min(int(level.max()) + 1, last) + 1):
        share = 1 - np.abs(level - np.float32(k))
        use = share > 0
        if not use.any():
            continue
        picture = surface.pyramid[k]
        rows, columns = picture.shape[:2]
        width_m, height_m = surface.shape.size_m
        x = across[use] * np.float32(columns / width_m) - np.float32(0.5)
        y = down[use] * np.float32(rows / height_m) - np.float32(0.5)
        total[use] += share[use][:, None] * _bilinear(picture, x, y)
    return total


def _bilinear(picture: F32, x: F32, y: F32) -> F32:
    """Return (N, 3): `picture` at N texel coordinates. In rows of 1024, as OpenCV takes no wider picture."""
    size = -(-x.size // 1024) * 1024
    folded = [np.resize(v, size).reshape(-1, 1024) for v in (x, y)]
    values = cv2.remap(picture, folded[0], folded[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values.reshape(-1, 3)[: x.size], np.float32)


def _pixel_bounds(shape: Shape, view: DemoView) -> tuple[int, int, int, int]:
    """Return (left, top, right, bottom): pixels outside certainly do not see the shape."""
    camera = corners_of(shape) @ view.cam_from_world[:, :3].T + view.cam_from_world[:, 3]
    if camera[:, 2].max() <= _NEAR_M:
        return 0, 0, 0, 0
    if camera[:, 2].min() <= _NEAR_M:
        return 0, 0, view.width, view.height
    pixels = camera[:, :2] / camera[:, 2:] * view.focal_px + (view.width / 2, view.height / 2)
    left, top = np.clip(np.floor(pixels.min(axis=0)) - 1, 0, (view.width, view.height)).astype(int)
    right, bottom = np.clip(np.ceil(pixels.max(axis=0)) + 1, 0, (view.width, view.height)).astype(int)
    return int(left), int(top), int(right), int(bottom)
