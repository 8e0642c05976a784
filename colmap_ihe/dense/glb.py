"""Read the textured mesh that `textured_mesh` wrote: a GLB of one mesh with one JPEG."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from colmap_ihe.errors import ProjectError

_HEADER, _CHUNK = 12, 8  # bytes
_TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}


@dataclass(frozen=True)
class TexturedMesh:
    """Hold a mesh whose vertices are repeated where patches of the texture meet.

    `vertices` (V, 3) and `normals` (V, 3) float32 in the frame of the model, `uv` (V, 2) float32 with (0, 0) at the top
    left of the texture, `faces` (F, 3) int64, `texture`: a whole JPEG file.
    """

    vertices: npt.NDArray[np.float32]
    normals: npt.NDArray[np.float32]
    uv: npt.NDArray[np.float32]
    faces: npt.NDArray[np.int64]
    texture: bytes


def read_textured(path: Path) -> TexturedMesh:
    """Read a GLB of this program. Raises `ProjectError` where the file is not one or is not whole."""
    try:
        content = path.read_bytes()
        tree, blob = _chunks(content)
        part = tree["meshes"][0]["primitives"][0]
        fields = part["attributes"]
        mesh = TexturedMesh(
            _array(tree, blob, fields["POSITION"]).astype(np.float32),
            _array(tree, blob, fields["NORMAL"]).astype(np.float32),
            _array(tree, blob, fields["TEXCOORD_0"]).astype(np.float32),
            _array(tree, blob, part["indices"]).reshape(-1, 3).astype(np.int64),
            _part(tree, blob, tree["images"][0]["bufferView"]),
        )
        if len(mesh.faces) and int(mesh.faces.max()) >= len(mesh.vertices):
            raise ValueError(f"a triangle of vertex {int(mesh.faces.max())}, of {len(mesh.vertices)}")
    except (OSError, ValueError, KeyError, IndexError, TypeError, struct.error) as error:
        raise ProjectError(
            f"{path}: cannot be read as a textured mesh ({error})",
            hint="run the stage mesh again, with --from mesh",
        ) from error
    return mesh


def _chunks(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the tree of a GLB file and its binary part. Raises ValueError."""
    magic, _, length = struct.unpack_from("<4sII", content)
    if magic != b"glTF" or length != len(content):
        raise ValueError(f"it begins with {magic!r} and has {len(content)} of {length} bytes")
    (size,) = struct.unpack_from("<I", content, _HEADER)
    start = _HEADER + _CHUNK
    return json.loads(content[start : start + size]), content[start + size + _CHUNK :]


def _part(tree: dict[str, Any], blob: bytes, number: int) -> bytes:
    view = tree["bufferViews"][number]
    start = view.get("byteOffset", 0)
    return blob[start : start + view["byteLength"]]


def _array(tree: dict[str, Any], blob: bytes, number: int) -> npt.NDArray[Any]:
    """Return (N, width) of an accessor whose values lie close together."""
    accessor = tree["accessors"][number]
    width = _WIDTHS[accessor["type"]]
    part = _part(tree, blob, accessor["bufferView"])
    values = np.frombuffer(
        part, _TYPES[accessor["componentType"]], accessor["count"] * width, accessor.get("byteOffset", 0)
    )
    return values.reshape(-1, width)
