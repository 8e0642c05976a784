"""Compare what two runs left, to the byte."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from colmap_ihe.colmap.native import pycolmap


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def pixels_of(file: Path) -> Any:
    """(H, W) or (H, W, 3) of a picture that is not to be turned into other colours."""
    with Image.open(file) as image:
        return np.asarray(image)


def known_of(database: Path) -> dict[str, Any]:
    """Everything in a database, as values that can be compared."""
    with pycolmap.Database.open(database) as opened:
        images = {image.image_id: (image.name, image.camera_id) for image in opened.read_all_images()}
        pairs, geometries = opened.read_two_view_geometries()
        return {
            "cameras": [str(camera) for camera in opened.read_all_cameras()],
            "images": images,
            "keypoints": {i: opened.read_keypoints(i).tobytes() for i in images},
            "descriptors": {i: opened.read_descriptors(i).data.tobytes() for i in images},
            "matches": {i: m.tobytes() for i, m in zip(*opened.read_all_matches(), strict=True)},
            "verified": {
                i: (int(g.config), g.inlier_matches.tobytes()) for i, g in zip(pairs, geometries, strict=True)
            },
        }
