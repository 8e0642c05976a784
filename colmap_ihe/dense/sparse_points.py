"""Hold which images of a sparse model see which of its points, as arrays: asked of COLMAP once, not point by point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import Float64, Int64
from colmap_ihe.machine.progress import SILENT, Progress


@dataclass(frozen=True)
class SparsePoints:
    """Hold the points that registered images see, and each pair of a point and an image once.

    `xyz` (N, 3) in the world; `first` (N + 1,): where the images of each point begin in `images` (M,), in order of
    their ids. `of_image`: the rows of `xyz` that an image sees, in order.
    """

    xyz: Float64
    first: Int64
    images: Int64
    of_image: dict[int, Int64]

    def seen_from(self, reference: int) -> tuple[Float64, Int64, Int64]:
        """Return the points (K, 3) that an image sees; and (L,) each the row of a point in them, and an image that sees
        it, the reference among them."""
        rows = self.of_image[reference]
        counts = self.first[rows + 1] - self.first[rows]
        row = np.repeat(np.arange(len(rows)), counts)
        within = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
        return self.xyz[rows], row, self.images[self.first[rows][row] + within]


def sparse_points(model: pycolmap.Reconstruction, progress: Progress = SILENT) -> SparsePoints:
    """Return the points of a model. An image that has two observations of a point sees it once."""
    numbers = sorted(model.reg_image_ids())
    progress.start(len(numbers), "photographs listed")
    of_image = {}
    for number in numbers:
        observations = model.images[number].get_observation_points2D()
        of_image[number] = np.unique(np.array([p.point3D_id for p in observations], np.int64))
        progress.advance()
    ids = np.unique(np.concatenate([np.zeros(0, np.int64), *of_image.values()]))
    of_image = {number: np.searchsorted(ids, points) for number, points in of_image.items()}
    rows = np.concatenate([np.zeros(0, np.int64), *of_image.values()])
    images = np.repeat(np.array(numbers, np.int64), [len(points) for points in of_image.values()])
    first = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=len(ids)))])
    xyz = np.array([model.points3D[int(point)].xyz for point in ids], np.float64).reshape(-1, 3)
    return SparsePoints(xyz, first, images[np.argsort(rows, kind="stable")], of_image)
