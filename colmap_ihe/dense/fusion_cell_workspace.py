"""Write a COLMAP workspace for one cell of space: of each image the window in which it shows the cell."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import Float64, Int64
from colmap_ihe.dense.depth_maps import depth_file, normal_file, read_planes, write_map
from colmap_ihe.dense.fusion_cells import Cell, PixelCoverage
from colmap_ihe.dense.undistort import mask_of, read_colour, read_mask
from colmap_ihe.photographs.png import encode_png

_SAMPLES = 1500  # of an image, for the plan
_STEP, _PAD = 4, 8  # pixels: how closely windows are looked for, and how much wider they are
_Window = tuple[slice, slice]


class Maps:
    """Hold the depth maps of a dense workspace with their cameras.

    An image is named by its index in `ids`, which are COLMAP's, in its order.
    """

    def __init__(self, dense_dir: Path) -> None:
        self.dense_dir = dense_dir
        self.model = pycolmap.Reconstruction(dense_dir / "sparse")
        self.ids = list(self.model.reg_image_ids())

    def _camera(self, index: int) -> pycolmap.Camera:
        return self.model.cameras[self._image(index).camera_id]

    def _image(self, index: int) -> pycolmap.Image:
        return self.model.images[self.ids[index]]

    @property
    def pixels(self) -> int:
        """Return the pixels of all images."""
        cameras = map(self._camera, range(len(self.ids)))
        return sum(camera.width * camera.height for camera in cameras)

    def coverage(self) -> PixelCoverage:
        """Return what the maps show, on coarse grids."""
        nothing = np.empty(0, np.int64)
        parts = [(np.empty((0, 3)), nothing, np.empty((0, 2), np.int64), np.empty(0), nothing)]
        for index in range(len(self.ids)):
            if depth_file(self.dense_dir, self._image(index).name).is_file():
                camera = self._camera(index)
                step = max(1, int((camera.width * camera.height / _SAMPLES) ** 0.5))
                points, pixel, depth = self._points(index, step)
                parts.append((points, np.full(len(depth), index), pixel, depth, np.full(len(depth), step)))
        return PixelCoverage(*(np.concatenate(column) for column in zip(*parts, strict=True)))

    def _points(self, index: int, step: int) -> tuple[Float64, Int64, Float64]:
        """Return (N, 3) in the world what each `step`-th pixel shows, (N, 2) its column and row, (N,) its depth."""
        image = self._image(index)
        grid = read_planes(depth_file(self.dense_dir, image.name))[0, ::step, ::step]
        row, column = np.nonzero(grid)
        depth = grid[row, column].astype(np.float64)
        pixel = np.stack([column, row], axis=1) * step
        from_pixels = np.linalg.inv(self._camera(index).calibration_matrix())
        rays = np.column_stack([pixel + 0.5, np.ones(len(row))]) @ from_pixels.T
        return image.cam_from_world().inverse() * (rays * depth[:, None]), pixel, depth

    def write_cell(self, cell: Cell, work: Path) -> list[int]:
        """Make `work` anew, for the images of the cell. Return their indices, in the order of the model there."""
        shutil.rmtree(work, ignore_errors=True)
        for folder in ("sparse", "images", "stereo"):
            (work / folder).mkdir(parents=True)
        windows = {index: window for index in cell.images if (window := self._window(index, cell))}
        for index, window in windows.items():
            self._write_window(index, window, work)
        self._submodel(cell, windows).write(work / "sparse")
        (work / "stereo" / "fusion.cfg").write_text(
            "".join(f"{_name(index)}\n" for index in windows), encoding="utf-8", newline="\n"
        )
        order = pycolmap.Reconstruction(work / "sparse")
        return [int(Path(order.images[i].name).stem) for i in order.reg_image_ids()]

    def _window(self, index: int, cell: Cell) -> _Window | None:
        points, pixel, _ = self._points(index, _STEP)
        pixel = pixel[cell.holds(points, cell.margin)]
        if not len(pixel):
            return None
        camera = self._camera(index)
        low = np.maximum(pixel.min(axis=0) - _PAD, 0)
        high = np.minimum(pixel.max(axis=0) + _PAD + 1, (camera.width, camera.height))
        return slice(low[1], high[1]), slice(low[0], high[0])

    def _write_window(self, index: int, window: _Window, work: Path) -> None:
        name, new = self._image(index).name, _name(index)
        for file in (depth_file, normal_file):
            planes = read_planes(file(self.dense_dir, name))
            write_map(planes[(slice(None), *window)].transpose(1, 2, 0), file(work, new))
        colour = read_colour(self.dense_dir / "images" / name)[window]
        (work / "images" / new).write_bytes(encode_png(np.ascontiguousarray(colour)))
        mask = read_mask(self.dense_dir, name)
        if mask is not None:
            mask_of(work, new).parent.mkdir(exist_ok=True)
            mask_of(work, new).write_bytes(encode_png(np.ascontiguousarray(mask[window])))

    def _submodel(self, cell: Cell, windows: Mapping[int, _Window]) -> pycolmap.Reconstruction:
        """Return the images with cameras of their windows, and the sparse points near the cell, by which COLMAP
        knows which images overlap."""
        model = pycolmap.Reconstruction()
        tracks: dict[int, pycolmap.Track] = {}
        for index, window in windows.items():
            image_id = self.ids[index]
            camera = pycolmap.Camera(self._camera(index).todict())
            camera.camera_id = image_id
            camera.width, camera.height = (side.stop - side.start for side in reversed(window))
            camera.principal_point_x -= window[1].start
            camera.principal_point_y -= window[0].start
            model.add_camera_with_trivial_rig(camera)
            near = self._sparse_points(cell, index)
            image = pycolmap.Image(
                name=_name(index), keypoints=np.zeros((len(near), 2)), camera_id=image_id, image_id=image_id
            )
            model.add_image_with_trivial_frame(image, self._image(index).cam_from_world())
            for row, point in enumerate(near):
                tracks.setdefault(point, pycolmap.Track()).add_element(image_id, row)
        for point, track in tracks.items():
            if track.length() > 1:
                model.add_point3D(self.model.points3D[point].xyz, track, np.zeros(3, np.uint8))
        return model

    def _sparse_points(self, cell: Cell, index: int) -> list[int]:
        """Return the ids of the sparse points near the cell that an image sees."""
        observations = self._image(index).get_observation_points2D()
        ids = list(dict.fromkeys(p.point3D_id for p in observations))  # an image may have two of one point
        points = np.array([self.model.points3D[i].xyz for i in ids]).reshape(-1, 3)
        near = cell.holds(points, cell.margin)
        return [i for i, is_near in zip(ids, near, strict=True) if is_near]


def _name(index: int) -> str:
    return f"{index}.png"
