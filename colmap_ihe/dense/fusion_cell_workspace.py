"""A COLMAP workspace for one cell of space: of each image the window in which it shows the cell, and nothing else."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.depth_maps import depth_file, normal_file, read_planes, write_map
from colmap_ihe.dense.fusion_cells import Cell, PixelCoverage
from colmap_ihe.dense.undistort import mask_of, read_colour, read_mask
from colmap_ihe.photographs.png import encode_png

_SAMPLES = 1500  # of an image, for the plan
_STEP, _PAD = 4, 8  # pixels: how closely windows are looked for, and how much wider they are
_Window = tuple[slice, slice]


class Maps:
    """The depth maps of a dense workspace with their cameras. `ids` of its images, in COLMAP's order."""

    def __init__(self, dense_dir: Path) -> None:
        self.dense_dir = dense_dir
        self.model = pycolmap.Reconstruction(dense_dir / "sparse")
        self.ids = list(self.model.reg_image_ids())

    def camera(self, place: int) -> pycolmap.Camera:
        return self.model.cameras[self.image(place).camera_id]

    def image(self, place: int) -> pycolmap.Image:
        return self.model.images[self.ids[place]]

    @property
    def pixels(self) -> int:
        return sum(self.camera(place).width * self.camera(place).height for place in range(len(self.ids)))

    def seen(self) -> PixelCoverage:
        """What the maps show, on coarse grids."""
        found = []
        for place in range(len(self.ids)):
            if depth_file(self.dense_dir, self.image(place).name).is_file():
                camera = self.camera(place)
                step = max(1, int((camera.width * camera.height / _SAMPLES) ** 0.5))
                points, pixel, depth = self.points(place, step)
                found.append((points, np.full(len(depth), place), pixel, depth, np.full(len(depth), step)))
        if not found:
            nothing = np.empty(0, np.int64)
            return PixelCoverage(np.empty((0, 3)), nothing, np.empty((0, 2), np.int64), np.empty(0), nothing)
        return PixelCoverage(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    def points(
        self, place: int, step: int
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
        """(N, 3) in the world what each `step`-th pixel shows, (N, 2) its column and row, (N,) its depth."""
        image = self.image(place)
        depth = read_planes(depth_file(self.dense_dir, image.name))[0, ::step, ::step]
        row, column = np.nonzero(depth)
        held = depth[row, column].astype(np.float64)
        pixel = np.stack([column, row], axis=1) * step
        rays = (
            np.column_stack([pixel + 0.5, np.ones(len(row))])
            @ np.linalg.inv(self.camera(place).calibration_matrix()).T
        )
        return image.cam_from_world().inverse() * (rays * held[:, None]), pixel, held

    def write_cell(self, cell: Cell, work: Path) -> list[int]:
        """Makes `work` anew, for the images of the cell. Returns their places, in the order of the model there."""
        shutil.rmtree(work, ignore_errors=True)
        (work / "sparse").mkdir(parents=True)
        (work / "images").mkdir()
        windows = {place: self._window(place, cell) for place in cell.images}
        shown = {place: window for place, window in windows.items() if window is not None}
        for place, window in shown.items():
            self._write_window(place, window, work)
        self._submodel(cell, shown).write(work / "sparse")
        (work / "stereo").mkdir(exist_ok=True)
        (work / "stereo" / "fusion.cfg").write_text("".join(f"{_name(place)}\n" for place in shown))
        order = pycolmap.Reconstruction(work / "sparse")
        return [int(Path(order.images[i].name).stem) for i in order.reg_image_ids()]

    def _window(self, place: int, cell: Cell) -> _Window | None:
        points, pixel, _ = self.points(place, _STEP)
        pixel = pixel[cell.holds(points, cell.margin)]
        if not len(pixel):
            return None
        camera = self.camera(place)
        low = np.maximum(pixel.min(axis=0) - _PAD, 0)
        high = np.minimum(pixel.max(axis=0) + _PAD + 1, (camera.width, camera.height))
        return slice(low[1], high[1]), slice(low[0], high[0])

    def _write_window(self, place: int, window: _Window, work: Path) -> None:
        name, new = self.image(place).name, _name(place)
        for old_file, new_file in (
            (depth_file(self.dense_dir, name), depth_file(work, new)),
            (normal_file(self.dense_dir, name), normal_file(work, new)),
        ):
            write_map(read_planes(old_file)[(slice(None), *window)].transpose(1, 2, 0), new_file)
        colour = read_colour(self.dense_dir / "images" / name)[window]
        (work / "images" / new).write_bytes(encode_png(np.ascontiguousarray(colour)))
        mask = read_mask(self.dense_dir, name)
        if mask is not None:
            mask_of(work, new).parent.mkdir(exist_ok=True)
            mask_of(work, new).write_bytes(encode_png(np.ascontiguousarray(mask[window])))

    def _submodel(self, cell: Cell, windows: dict[int, _Window]) -> pycolmap.Reconstruction:
        """The images with cameras of their windows, and the sparse points near the cell, by which COLMAP knows what
        overlaps."""
        model = pycolmap.Reconstruction()
        tracks = self._tracks(cell, windows)
        for place, window in windows.items():
            camera = pycolmap.Camera(self.camera(place).todict())
            camera.camera_id = self.ids[place]
            camera.width, camera.height = (side.stop - side.start for side in reversed(window))
            camera.principal_point_x -= window[1].start
            camera.principal_point_y -= window[0].start
            model.add_camera_with_trivial_rig(camera)
            image = pycolmap.Image(
                name=_name(place),
                keypoints=np.zeros((len(tracks[place]), 2)),
                camera_id=camera.camera_id,
                image_id=self.ids[place],
            )
            model.add_image_with_trivial_frame(image, self.image(place).cam_from_world())
        _add_points(model, self.model, {self.ids[place]: ids for place, ids in tracks.items()})
        return model

    def _tracks(self, cell: Cell, places: Sequence[int] | dict[int, Any]) -> dict[int, list[int]]:
        """Of each image the sparse points near the cell that it sees."""
        found = {}
        for place in places:
            ids = [p.point3D_id for p in self.image(place).get_observation_points2D()]
            points = np.array([self.model.points3D[i].xyz for i in ids]).reshape(-1, 3)
            held = cell.holds(points, cell.margin)
            found[place] = [i for i, near in zip(ids, held, strict=True) if near]
        return found


def _add_points(
    model: pycolmap.Reconstruction, source: pycolmap.Reconstruction, seen: dict[int, list[int]]
) -> None:
    tracks: dict[int, pycolmap.Track] = {}
    for image_id, points in seen.items():
        for index, point in enumerate(points):
            tracks.setdefault(point, pycolmap.Track()).add_element(image_id, index)
    for point, track in tracks.items():
        if track.length() > 1:
            model.add_point3D(source.points3D[point].xyz, track, np.zeros(3, np.uint8))


def _name(place: int) -> str:
    return f"{place}.png"
