"""Judge the depth of the demo's painted panels, which one grey for the whole scene does not see."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.evaluation.demo.frescoes import BORDER_M
from colmap_ihe.evaluation.demo.scene import ISOLUMINANT_PANELS
from colmap_ihe.evaluation.demo.shapes import Rect
from colmap_ihe.evaluation.depth_errors import true_pixels
from colmap_ihe.evaluation.truth import F32, F64, TrueImage

PANELS: Mapping[str, Rect] = dict(zip(("rosette", "scroll", "lattice"), ISOLUMINANT_PANELS, strict=True))
_NEAR_M = 0.01  # from a panel's plane
_RIGHT = 0.005  # relative error of a depth


def panel_pixels(truth: TrueImage) -> dict[str, NDArray[np.bool_]]:
    """Return where each panel is seen in an image, (H, W), without its border."""
    depth = truth.depth_m()
    rows, columns = np.indices(depth.shape) + 0.5
    rays = np.stack((columns, rows, np.ones_like(rows)), axis=-1) @ np.linalg.inv(truth.calibration).T
    rotation, translation = truth.cam_from_world[:, :3], truth.cam_from_world[:, 3]
    points = (rays * depth[..., None] - translation) @ rotation
    return {name: (depth > 0) & _on(panel, points) for name, panel in PANELS.items()}


def _on(panel: Rect, points: F64) -> NDArray[np.bool_]:
    inside = np.abs(points[..., panel.axis] - panel.at) < _NEAR_M
    axes = [axis for axis in range(3) if axis != panel.axis]
    for axis, low, high in zip(axes, panel.low, panel.high, strict=True):
        inside &= (points[..., axis] > low + BORDER_M) & (points[..., axis] < high - BORDER_M)
    return np.asarray(inside)


def painted_depth_percent(
    maps: Iterable[tuple[F32, F64, TrueImage]], metres_per_unit: float
) -> dict[str, float]:
    """Return the share of each panel's pixels, over all images, with a depth within 0.5 % of the truth.

    `maps`: depth (H, W) float32, calibration and truth of each image, as `depth_errors` takes them.
    """
    seen, right = dict.fromkeys(PANELS, 0), dict.fromkeys(PANELS, 0)
    for estimated, calibration, truth in maps:
        rows, columns, inside = true_pixels(estimated.shape, calibration, truth)
        true = truth.depth_m()[rows, columns]
        fits = np.abs(estimated * np.float32(metres_per_unit) - true) <= _RIGHT * true
        for name, pixels in panel_pixels(truth).items():
            panel = inside & pixels[rows, columns]
            seen[name] += int(panel.sum())
            right[name] += int((panel & fits).sum())
    return {name: 100 * right[name] / seen[name] for name in PANELS if seen[name]}
