"""The records of a small project."""

from __future__ import annotations

from typing import Any


def records() -> dict[str, dict[str, Any]]:
    """Of a small project, as a run leaves them."""
    whole: dict[str, Any] = {
        "fingerprint": "0",
        "seconds": 1.5,
        "options": {},
        "versions": {},
        "warnings": [],
    }
    weights: dict[str, Any] = {"method": "ihe", "weights": [0.2, 0.3, 0.5], "score": 0.1, "tones": 200}
    weights |= {"images": 2, "encoding": "coded"}
    tried = {
        "chosen": "ihe",
        "in_words": "3 % more",
        "pairs": [["a.jpg", "b.jpg"]],
        "candidates": {},
        "reason": "",
    }
    model = {"registered_images": 2, "points3d": 9, "points_over_3_views": 3, "mean_track_length": 2.5}
    camera = {
        "camera_id": 1,
        "model": "SIMPLE_RADIAL",
        "width": 90,
        "height": 66,
        "names": ["f", "cx", "cy", "k"],
        "params": [101.5, 45.5, 33.0, -0.1],
        "standard_deviations": [0.5, 0.25, 0.0, 0.01],
        "correlated": [["f", "k", 0.97]],
        "photographs": 2,
        "by": "calibration",
        "exif": {"make": "Foo", "model": "Bar", "focal_length_mm": 35.0, "focal_length_35mm": 0.0},
    }
    held_out = {"colmap_px": 0.4, "calibrated_px": 0.3, "standard_errors": 2.5}
    return {
        "captures": whole
        | {"images": 2, "raw": 0, "paired": {}, "with_gps": 0, "pixels": 99, "largest": 50}
        | {"development": {}, "recipes": {"a.jpg": {"denoise": 1.0, "dark": "d.npy"}}, "ignored": [], "left_out": {}},
        "fit": whole | {"weights": {"coded": weights}, "colour_white": 1.0, "tried": {"coded": tried}, "left_out": {}},
        "convert": whole | {"grey": {"a.jpg": "a.png", "b/c.jpg": "b/c.png"}, "left_out": {}},
        "features": whole | {"images": 2, "cameras": 1, "with_focal_prior": 2, "features": 99, "missing": []},
        "matches": whole | {"strategy": "exhaustive", "pairs_verified": 1, "inliers": 20, "pairs_matched": 1},
        "sparse": whole
        | {"models": [model | {"mean_reprojection_error_px": 0.5, "image_names": ["a.png"]}], "unregistered": []}
        | {"cameras": [camera], "held_out": held_out},
        "dense": whole | {"points": 99, "backend": "sgm", "pixels": 100, "pixels_with_depth": 60},
        "mesh": whole | {"files": ["mesh.ply"], "faces": 9, "texture": {"width": 9, "height": 9}},
        "drawings": whole | {"files": ["front/sheets.pdf"]},
    }  # fmt: skip
