"""Write pictures and clouds as text inside a page."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from colmap_ihe.grey.weights import FIXED
from colmap_ihe.report.contents import CameraPose, Cloud, ModelFrame, Picture, Surface
from colmap_ihe.report.packed import packed

_Rows = NDArray[np.int64]

_FAR_OUT = 30
"""Times the median distance from the middle: beyond are stray points, which would coarsen all others."""
_STEPS = 65535
_UV_STEPS = 16383  # of a side of the texture, which has at most as many pixels


def data_uri(picture: Picture) -> str:
    """Return the picture as a `data:` address."""
    return f"data:image/jpeg;base64,{as_base64(picture.jpeg)}"


def cloud_data(cloud: Cloud) -> Markup:
    """Return the points that the viewer reads, as JSON that may stand in a script element.

    `positions`: little-endian uint16 (N, 3), 0 at `low` and 65535 at `low` + `extent`, so within 1/131070 of the
    extent; `tints`: uint8 (N, 4), the colours and the grey; both in base64. Points that are not finite or lie far
    out are left out. Raises ValueError if the arrays of the cloud are not of one length.
    """
    if not len(cloud.positions) == len(cloud.colours) == len(cloud.grey):
        raise ValueError(
            f"a cloud of {len(cloud.positions)} positions, {len(cloud.colours)} colours and {len(cloud.grey)} greys"
        )
    kept = _near(cloud.positions)
    steps, low, extent = _in_steps(np.asarray(cloud.positions, np.float64)[kept])
    tints = np.concatenate([cloud.colours[kept], cloud.grey[kept][:, None]], axis=1)
    return script_json(
        {
            "positions": as_base64(steps.astype("<u2").tobytes()),
            "tints": as_base64(tints.astype(np.uint8).tobytes()),
            "low": low.tolist(),
            "extent": extent.tolist(),
        }
    )


def surface_data(surface: Surface) -> Markup:
    """Return the mesh that the viewer reads, as JSON that may stand in a script element.

    Each array is `packed`: positions in 65,536 steps of the extent, normals in 127 of their length, places on the
    texture in 16,384 of its sides. Vertices stand in the order in which the triangles need them: it compresses best.
    """
    order, rank = _in_order_of_use(surface.faces)
    steps, low, extent = _in_steps(surface.positions[order].astype(np.float64))
    data: dict[str, Any] = {
        "positions": packed(steps),
        "normals": packed(np.rint(127 * surface.normals[order].astype(np.float64)).astype(np.int64)),
        "faces": packed(rank[surface.faces].ravel()),
        "coarser": [packed(rank[faces].ravel()) for faces in surface.coarser],
        "low": low.tolist(),
        "extent": extent.tolist(),
    }
    if surface.texture is not None and surface.uv is not None:
        data["uv"] = packed(np.rint(_UV_STEPS * surface.uv[order].astype(np.float64)).astype(np.int64))
        data["texture"] = data_uri(surface.texture)
    elif surface.colours is not None:
        data["colours"] = packed(surface.colours[order])
    return script_json(data)


def scene_data(frame: ModelFrame | None, cameras: Sequence[CameraPose]) -> Markup:
    """Return what the viewer must know beside cloud and mesh, as JSON that may stand in a script element."""
    grids: dict[str, int] = {}
    shown = [c for c in cameras if np.isfinite(c.centre).all() and np.isfinite(c.corners).all()]
    return script_json(
        {
            "rotation": frame.rotation.tolist() if frame else np.eye(3).tolist(),
            "middle": frame.middle.tolist() if frame else [0.0, 0.0, 0.0],
            "metric": bool(frame and frame.metric),
            "weights": list(frame.grey_weights) if frame else FIXED["rec709"],
            "cameras": [_camera(c, grids) for c in shown],
            "grids": [json.loads(text) for text in grids],
        }
    )


def _camera(camera: CameraPose, grids: dict[str, int]) -> dict[str, Any]:
    """Return a camera as JSON holds it; adds its lattice to those of other lenses, by number."""
    grid = camera.grid if camera.grid is not None else np.indices((2, 2))[::-1].transpose(1, 2, 0)
    text = json.dumps([_numbers(row.ravel()) for row in grid])
    return {
        "name": camera.name,
        "centre": _numbers(camera.centre, 9),
        "corners": [_numbers(k, 9) for k in camera.corners],
        "size": list(camera.size),
        "box": [float(v) for v in camera.box],
        "grid": grids.setdefault(text, len(grids)),
        "picture": data_uri(camera.picture) if camera.picture else None,
    }


def _in_steps(
    positions: NDArray[np.float64],
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return (N, 3) whole numbers from 0 to 65535 in the box of the positions, and its lowest corner and extent."""
    low = positions.min(axis=0) if len(positions) else np.zeros(3)
    extent = np.ptp(positions, axis=0) if len(positions) else np.zeros(3)
    steps = np.rint((positions - low) / np.where(extent > 0, extent, 1) * _STEPS)
    return steps.astype(np.int64), low, extent


def _in_order_of_use(faces: _Rows) -> tuple[_Rows, _Rows]:
    """Return the vertices (V,) that faces (F, 3) use, in the order of their first use, and the place in that order of
    each vertex that is used."""
    used, first = np.unique(faces.ravel(), return_index=True)
    order = used[np.argsort(first)]
    rank = np.zeros(int(used.max(initial=0)) + 1, np.int64)
    rank[order] = np.arange(len(order))
    return order, rank


def script_json(value: object) -> Markup:
    """Return JSON in which nothing can end the script element that holds it."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


def _near(positions: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return (N,) bool: the points that are finite and not far out."""
    finite = np.asarray(np.isfinite(positions).all(axis=1))
    if not finite.any():
        return finite
    away = np.full(len(positions), np.inf)
    away[finite] = np.linalg.norm(positions[finite] - np.median(positions[finite], axis=0), axis=1)
    near: NDArray[np.bool_] = away <= max(_FAR_OUT * float(np.median(away[finite])), 1e-12)
    return near


def as_base64(data: bytes) -> str:
    """Return bytes as text."""
    return base64.b64encode(data).decode("ascii")


def _numbers(values: NDArray[np.floating[Any]], digits: int = 8) -> list[float]:
    return [float(f"{v:.{digits}g}") for v in values]
