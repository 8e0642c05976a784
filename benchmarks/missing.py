"""Tell why pixels have no depth: what cross-checking cannot cover, and what it could.

    python benchmarks/missing.py PROJECT/workspace/dense/0 [--truth PROJECT/truth] [--json]

Shares of every fourth pixel both ways; each counts in the first row that holds. "Plain": in a window of 7 pixels no
channel of the colour twin has a standard deviation of over 3 levels, which noise has too. "Seen by one": as far as
the depth around it tells, no other photograph shows the place; with the truth of the demo, none shows it unhidden.
"Seen by two": one other does, so that a single pair must do, which counts only where it looks very much alike. "Beside
depth": within 6 pixels of a depth, as at edges, of which windows see two sides. The sky is known with the truth only;
without it, it is plain.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.dense.camera import Float32, PinholeCamera
from colmap_ihe.dense.depth_maps import camera_of, depth_file, read_planes
from colmap_ihe.dense.stereo.merge import filled
from colmap_ihe.dense.undistort import read_colour, read_mask
from colmap_ihe.evaluation.depth_errors import true_pixels
from colmap_ihe.evaluation.truth import Truth, key_of, pose_errors, read_truth

WINDOW_PX, PLAIN_LEVELS = 7, 3.0
BESIDE_PX = 6
STEP = 4
HIDDEN = 0.02  # relative depth behind what another photograph truly shows
Bools = NDArray[np.bool_]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dense", type=Path)
    parser.add_argument("--truth", type=Path, help="a folder of truth, as the demo writes it")
    parser.add_argument("--json", action="store_true", help="print the table as JSON")
    parsed = parser.parse_args()
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    model = pycolmap.Reconstruction(parsed.dense / "sparse")
    truth = read_truth(parsed.truth) if parsed.truth else None
    true = _true_depths(model, truth) if truth else {}
    shares = [_shares(parsed.dense, model, number, true) for number in sorted(model.reg_image_ids())]
    rows = {name: f"{100 * np.mean([share[name] for share in shares]):.1f} %" for name in shares[0]}
    if parsed.json:
        print(json.dumps(rows, indent=2))
        return
    print_table("", list(rows.items()), ("pixels", "share"))


def _true_depths(model: pycolmap.Reconstruction, truth: Truth) -> dict[int, Float32]:
    """Return the true depth (H, W) of each undistorted image in the model's units, 0 in the sky."""
    images = {number: model.images[number] for number in model.reg_image_ids()}
    poses = {image.name: image.cam_from_world().matrix() for image in images.values()}
    scale = pose_errors(poses, truth).world_from_model.scale
    depths = {}
    for number, image in images.items():
        camera = model.cameras[image.camera_id]
        of_image = truth.images[key_of(image.name)]
        shape = (camera.height, camera.width)
        rows, columns, _ = true_pixels(shape, camera.calibration_matrix(), of_image)
        depths[number] = np.asarray(of_image.depth_m()[rows, columns] / scale, np.float32)
    return depths


def _shares(
    dense: Path, model: pycolmap.Reconstruction, number: int, true: dict[int, Float32]
) -> dict[str, float]:
    """Return the share of the pixels of one image in each row of the table."""
    name = str(model.images[number].name)
    depth = np.array(read_planes(depth_file(dense, name))[0])
    mask = read_mask(dense, name)
    views = {other: camera_of(model, other) for other in sorted(model.reg_image_ids())}
    place = true.get(number, _continued(depth))
    others = _others(views, number, place, true)
    around = np.ones((2 * BESIDE_PX + 1,) * 2, np.uint8)
    reasons = {
        "with depth": depth > 0,
        "masked": np.zeros(depth.shape, bool) if mask is None else mask == 0,
        "sky": (place <= 0) & (number in true),
        "plain in every colour": _plain(read_colour(dense / "images" / name)),
        "seen by one": others == 0,
        "seen by two": others == 1,
        "beside depth": cv2.dilate((depth > 0).astype(np.uint8), around) > 0,
        "else": np.ones(depth.shape, bool),
    }
    free = np.ones(depth.shape, bool)
    shares = {}
    for reason, holds in reasons.items():
        shares[reason] = float(np.mean((holds & free)[::STEP, ::STEP]))
        free &= ~holds
    return shares


def _continued(depth: Float32) -> Float32:
    """Return a depth map whose holes have the depth around them, 0 everywhere if it is empty."""
    held = depth > 0
    if not held.any():
        return depth
    return np.asarray(1 / filled(np.where(held, 1 / np.where(held, depth, 1), 0).astype(np.float32)))


def _plain(colour: NDArray[np.uint8]) -> Bools:
    """Return where no channel of a picture (H, W, 3) varies."""
    values = colour.astype(np.float32)
    side = (WINDOW_PX, WINDOW_PX)
    variance = cv2.blur(values * values, side) - np.square(cv2.blur(values, side))
    return np.asarray(variance.max(axis=2) <= PLAIN_LEVELS**2)


def _others(
    views: dict[int, PinholeCamera], number: int, place: Float32, true: dict[int, Float32]
) -> NDArray[np.int64]:
    """Return (H, W), how many other photographs show what is at the depth `place` of each pixel, by every `STEP`th."""
    points, size = _points(views[number], place), place[::STEP, ::STEP].shape
    count = np.zeros(len(points), np.int64)
    for other in views.keys() - {number}:
        pixels, distance = views[other].project(points)
        inside = (distance > 0) & ((pixels >= 0) & (pixels < views[other].size)).all(axis=1)
        if other in true:
            column, row = np.where(inside[:, None], pixels, 0).astype(int).T
            shown = true[other][row, column]
            inside &= (shown <= 0) | (distance < (1 + HIDDEN) * shown)
        count += inside
    height, width = place.shape
    return np.repeat(np.repeat(count.reshape(size), STEP, axis=0), STEP, axis=1)[:height, :width]


def _points(view: PinholeCamera, depth: Float32) -> Float32:
    """Return (N, 3) in the world: what every `STEP`th pixel shows at its depth."""
    depth, size = depth[::STEP, ::STEP], depth.shape
    column, row = (m.ravel() for m in np.meshgrid(*(np.arange(0, side, STEP) for side in size[::-1])))
    pixels = np.stack([column + 0.5, row + 0.5, np.ones(depth.size)])
    rays = np.linalg.inv(view.K) @ pixels
    rotation, shift = view.cam_from_world[:, :3], view.cam_from_world[:, 3]
    return np.asarray((rays * depth.ravel() - shift[:, None]).T @ rotation, np.float32)


if __name__ == "__main__":
    main()
