"""Hold the part of a model that a calibration is computed from, as arrays: poses, points and observations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap

Float64 = NDArray[np.float64]
Ints = NDArray[np.intp]
_AN_IMAGE = 30  # observations that fix its pose


@dataclass(frozen=True)
class Block:
    """Hold N images, P points and M observations, sorted by point.

    `rotations` (N, 3, 3) and `translations` (N, 3) take the world to the camera; `cameras` (N,) is the place of each
    image's camera in a list; `points` (P, 3); of each observation `image` (M,), `point` (M,) and `pixels` (M, 2), with
    the centre of the top left pixel at (0.5, 0.5).
    """

    rotations: Float64
    translations: Float64
    cameras: Ints
    points: Float64
    image: Ints
    point: Ints
    pixels: Float64

    @cached_property
    def starts(self) -> Ints:
        """Return (P + 1,): the first observation of each point, and the number of observations."""
        return np.searchsorted(self.point, np.arange(len(self.points) + 1))

    def in_camera(self) -> Float64:
        """Return (M, 3): each observation's point in the coordinates of its camera."""
        turned = np.einsum("mij,mj->mi", self.rotations[self.image], self.points[self.point])
        return np.asarray(turned + self.translations[self.image])

    def of_points(self, chosen: Ints) -> Block:
        """Return the block with these points only, by their numbers (n,), which rise."""
        number = np.full(len(self.points), -1)
        number[chosen] = np.arange(len(chosen))
        kept = number[self.point] >= 0
        return replace(
            self,
            points=self.points[chosen],
            image=self.image[kept],
            point=number[self.point[kept]],
            pixels=self.pixels[kept],
        )

    def of_observations(self, kept: NDArray[np.bool_]) -> tuple[Block, Ints]:
        """Return the block with these observations only, (M,), and the numbers of its points: those with two left."""
        kept = kept & (np.bincount(self.point[kept], minlength=len(self.points)) > 1)[self.point]
        block = replace(self, image=self.image[kept], point=self.point[kept], pixels=self.pixels[kept])
        points = np.unique(block.point)
        return block.of_points(points), points


@dataclass(frozen=True)
class Part:
    """Hold what of a model is computed with: its images and cameras by id, the block of all that these images see, and
    the ids (P,) of its points."""

    image_ids: Sequence[int]
    camera_ids: Sequence[int]
    block: Block
    point_ids: NDArray[np.uint64]


def part_of(model: pycolmap.Reconstruction, image_ids: Sequence[int], camera_ids: Sequence[int]) -> Part:
    """Return these images of a model, whose cameras are among `camera_ids`, with the points that two or more of them
    see. Of several observations of a point in one image the first counts."""
    images = [model.images[image_id] for image_id in image_ids]
    seen = [image.get_observation_points2D() for image in images]
    numbers = np.repeat(np.arange(len(images)), [len(points) for points in seen])
    ids = np.array([p.point3D_id for points in seen for p in points], np.uint64)
    pixels = np.array([p.xy for points in seen for p in points], np.float64).reshape(-1, 2)
    order = np.lexsort((numbers, ids))
    numbers, ids, pixels = numbers[order], ids[order], pixels[order]
    first = np.ones(len(ids), bool)
    first[1:] = (ids[1:] != ids[:-1]) | (numbers[1:] != numbers[:-1])
    numbers, ids, pixels = numbers[first], ids[first], pixels[first]
    point_ids, begins, counts = np.unique(ids, return_index=True, return_counts=True)
    # By the images that see them, so that some thousand neighbours touch few images.
    by_image = np.lexsort((numbers[begins + counts - 1], numbers[begins]))
    by_image = by_image[counts[by_image] > 1]
    point_ids, lengths = point_ids[by_image], counts[by_image]
    offsets = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    rows = np.repeat(begins[by_image], lengths) + offsets
    camera_number = {camera_id: number for number, camera_id in enumerate(camera_ids)}
    block = Block(
        *poses_of(model, image_ids),
        np.array([camera_number[image.camera_id] for image in images], np.intp),
        np.array([model.points3D[i].xyz for i in point_ids.tolist()], np.float64).reshape(-1, 3),
        numbers[rows],
        np.repeat(np.arange(len(lengths)), lengths),
        pixels[rows],
    )
    return Part(image_ids, camera_ids, block, point_ids)


def poses_of(model: pycolmap.Reconstruction, image_ids: Sequence[int]) -> tuple[Float64, Float64]:
    """Return rotations (N, 3, 3) and translations (N, 3), from the world to the camera."""
    poses = np.array([model.images[i].cam_from_world().matrix() for i in image_ids]).reshape(-1, 3, 4)
    return np.ascontiguousarray(poses[:, :, :3]), np.ascontiguousarray(poses[:, :, 3])


def thinned(block: Block, most: int) -> Ints:
    """Return the numbers of about `most` points (n,): of those that begin in an image, as many of each in proportion,
    those of most observations; and so many more that each image keeps `_AN_IMAGE` of its own, if it has them."""
    if len(block.points) <= most:
        return np.arange(len(block.points))
    lengths = np.diff(block.starts)
    images = len(block.rotations)
    share = most / len(block.points)
    chosen = np.zeros(len(block.points), bool)
    firsts = block.image[block.starts[:-1]]
    for image in range(images):
        mine = np.flatnonzero(firsts == image)
        longest = mine[np.argsort(-lengths[mine], kind="stable")]
        chosen[longest[: round(share * len(mine))]] = True
    for image in range(images):  # whose pose would stay behind, and with it all that the image sees
        mine = block.point[block.image == image]
        others = mine[~chosen[mine]]
        missing = max(0, _AN_IMAGE - (len(mine) - len(others)))
        chosen[others[np.argsort(-lengths[others], kind="stable")[:missing]]] = True
    return np.flatnonzero(chosen)
