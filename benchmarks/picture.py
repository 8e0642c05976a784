"""Draw the picture of docs/dense.md from a finished demo: photograph, grey, depth, cloud.

python benchmarks/picture.py DEMO_FOLDER [-o docs/images/demo.jpg] [--view 6]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.ply import COLOURS, columns, read_ply

WIDTH = 720
Picture = NDArray[np.uint8]


def read_cloud(path: Path) -> tuple[NDArray[np.float64], Picture]:
    """Return points (N, 3) in the model's frame and their colours (N, 3) uint8, of COLMAP's fused.ply."""
    points = read_ply(path)["vertex"]
    return columns(points, "xyz").astype(np.float64), columns(points, COLOURS)


def cloud_from(dense: Path, number: int, turn_deg: float) -> Picture:
    """Draw the fused cloud seen from image `number`, the camera turned about the scene's middle by `turn_deg`."""
    model = pycolmap.Reconstruction(dense / "sparse")
    image = model.images[sorted(model.reg_image_ids())[number]]
    camera = model.cameras[image.camera_id]
    xyz, rgb = read_cloud(dense / "fused.ply")
    pose = image.cam_from_world().matrix()
    seen = xyz @ pose[:, :3].T + pose[:, 3]
    middle = np.array([0, 0, np.median(seen[:, 2])])
    turn, _ = cv2.Rodrigues(np.array([0, np.radians(turn_deg), 0]))
    seen = (seen - middle) @ np.asarray(turn).T + middle * 1.06
    order = np.argsort(-seen[:, 2])
    seen, rgb = seen[order], rgb[order]
    height = round(WIDTH * camera.height / camera.width)
    focal = camera.focal_length_x * WIDTH / camera.width
    place = (seen[:, :2] / seen[:, 2:] * focal + (WIDTH / 2, height / 2)).astype(int)
    inside = (seen[:, 2] > 0) & (place >= 0).all(axis=1) & (place < (WIDTH, height)).all(axis=1)
    picture = np.full((height, WIDTH, 3), 255, np.uint8)
    picture[place[inside, 1], place[inside, 0]] = rgb[inside]
    return picture


def depth_of(dense: Path, name: str) -> Picture:
    """Draw a depth map in colour, near warm; black where there is none."""
    found = pycolmap.DepthMap()
    found.read(dense / "stereo" / "depth_maps" / f"{name}.geometric.bin")
    depth = found.to_array()
    inverse = np.where(depth > 0, 1 / np.maximum(depth, 1e-6), 0)
    low, high = np.percentile(inverse[depth > 0], (2, 98))
    level = np.clip(255 * (inverse - low) / (high - low), 0, 255).astype(np.uint8)
    coloured = cv2.applyColorMap(level, cv2.COLORMAP_TURBO)[..., ::-1] * (depth > 0)[..., None]
    return np.ascontiguousarray(coloured, np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("demo", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/images/demo.jpg"))
    parser.add_argument("--view", type=int, default=4)
    parsed = parser.parse_args()
    dense = parsed.demo / "workspace" / "dense" / "0"
    model = pycolmap.Reconstruction(dense / "sparse")
    name = model.images[sorted(model.reg_image_ids())[parsed.view]].name
    colour = np.asarray(Image.open(dense / "images" / name).convert("RGB"))
    grey = np.asarray(Image.open(dense / "grey" / "images" / name).convert("RGB"))
    pictures = [colour, grey, depth_of(dense, name), cloud_from(dense, parsed.view, -22)]
    height = pictures[-1].shape[0]
    small = [np.asarray(cv2.resize(p, (WIDTH, height), interpolation=cv2.INTER_AREA)) for p in pictures]
    sheet = np.vstack([np.hstack(small[:2]), np.hstack(small[2:])])
    parsed.output.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(sheet).save(parsed.output, quality=85, optimize=True)


if __name__ == "__main__":
    main()
