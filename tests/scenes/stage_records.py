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
    return {
        "captures": whole
        | {"images": 2, "raw": 0, "paired": {}, "with_gps": 0, "pixels": 99, "largest": 50}
        | {"development": {}, "recipes": {"a.jpg": {"denoise": 1.0, "dark": "d.npy"}}, "ignored": [], "left_out": {}},
        "fit": whole | {"weights": {"coded": weights}, "colour_white": 1.0, "tried": {"coded": tried}, "left_out": {}},
        "convert": whole | {"grey": {"a.jpg": "a.png", "b/c.jpg": "b/c.png"}, "left_out": {}},
        "features": whole | {"images": 2, "cameras": 1, "with_focal_prior": 2, "features": 99, "missing": []},
        "matches": whole | {"strategy": "exhaustive", "pairs_verified": 1, "inliers": 20, "pairs_matched": 1},
        "sparse": whole
        | {"models": [model | {"mean_reprojection_error_px": 0.5, "image_names": ["a.png"]}], "unregistered": []},
        "dense": whole | {"points": 99, "backend": "sgm", "pixels": 100, "pixels_with_depth": 60},
        "mesh": whole | {"files": ["mesh.ply"], "faces": 9, "texture": {"width": 9, "height": 9}},
    }  # fmt: skip
