"""PLY files as COLMAP writes and reads them: binary, little-endian, triangles only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.errors import ProjectError

Rows = npt.NDArray[np.void]

_TYPES = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4"}
_NAMES = {np.dtype(kind): name for name, kind in _TYPES.items()}


def read_ply(path: Path) -> dict[str, Rows]:
    """The elements of a file by name, each a structured array with the file's own names; the indices of faces
    are (F, 3) below the name of their list. Raises `ProjectError` where the file is not whole."""
    try:
        content = np.memmap(path, mode="r")
        header = bytes(content[:4096])
        end = header.index(b"end_header\n") + len(b"end_header\n")
        elements, place = {}, end
        for name, count, fields in _elements(header[:end].decode("ascii")):
            dtype = np.dtype(fields)
            elements[name] = np.frombuffer(content[place : place + count * dtype.itemsize], dtype, count)
            place += count * dtype.itemsize
    except (OSError, ValueError, KeyError, IndexError, TypeError, OverflowError) as error:
        raise ProjectError(
            f"{path}: cannot be read as a binary PLY file of triangles ({error})",
            hint="run the stage that makes it again, with --from",
        ) from error
    return elements


def _elements(header: str) -> list[tuple[str, int, list[Any]]]:
    """Name, count and numpy fields of each element of a header."""
    found: list[tuple[str, int, list[Any]]] = []
    for line in header.splitlines():
        words = line.split()
        if words[0] == "format" and words[1] != "binary_little_endian":
            raise ValueError(f"it is {words[1]}, not binary_little_endian")
        if words[0] == "element":
            found.append((words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            found[-1][2].extend(((f"{words[4]} count", _TYPES[words[2]]), (words[4], _TYPES[words[3]], 3)))
        elif words[0] == "property":
            found[-1][2].append((words[2], _TYPES[words[1]]))
    return found


def write_rows(path: Path, rows: Rows) -> None:
    """A cloud: `rows` is a structured array."""
    with path.open("wb") as handle:
        handle.write(row_header(len(rows), rows.dtype))
        handle.write(rows.tobytes())


def row_header(count: int, dtype: np.dtype[Any]) -> bytes:
    """What stands before the rows of a cloud in its file."""
    return _header([("vertex", count, _properties(dtype))])


def read_mesh(path: Path) -> Mesh:
    """Grey where the file has no colours. Raises `ProjectError`."""
    elements = read_ply(path)
    try:
        vertices, faces = elements["vertex"], elements["face"]
        index = next((n for n in faces.dtype.names or () if faces.dtype[n].shape == (3,)), None)
        if index is None or (len(faces) and (faces[f"{index} count"] != 3).any()):
            raise ValueError("not all of its faces are triangles")
        positions = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float32)
        colours = np.full(positions.shape, 128, np.uint8)
        if "red" in (vertices.dtype.names or ()):
            colours = np.stack([vertices[name] for name in ("red", "green", "blue")], axis=1).astype(np.uint8)
        corners = faces[index].astype(np.int64)
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(positions):
            raise ValueError("a face has a corner that is not there")
    except (ValueError, KeyError, TypeError) as error:
        raise ProjectError(
            f"{path}: cannot be read as a mesh ({error})",
            hint="run the stage that makes it again, with --from",
        ) from error
    return Mesh(positions, corners.astype(np.int32), colours)


def write_mesh(path: Path, mesh: Mesh) -> None:
    vertices = np.empty(
        len(mesh.vertices),
        [*((axis, "<f4") for axis in "xyz"), *((n, "u1") for n in ("red", "green", "blue"))],
    )
    for k, axis in enumerate("xyz"):
        vertices[axis] = mesh.vertices[:, k]
    for k, name in enumerate(("red", "green", "blue")):
        vertices[name] = mesh.colours[:, k]
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("vertex_indices", "<i4", 3)])
    faces["count"], faces["vertex_indices"] = 3, mesh.faces
    header = _header(
        [
            ("vertex", len(vertices), _properties(vertices.dtype)),
            ("face", len(faces), ["property list uchar int vertex_indices"]),
        ]
    )
    with path.open("wb") as handle:
        handle.write(header)
        handle.write(vertices.tobytes())
        handle.write(faces.tobytes())


def _properties(dtype: np.dtype[Any]) -> list[str]:
    return [f"property {_NAMES[dtype[name]]} {name}" for name in dtype.names or ()]


def _header(elements: list[tuple[str, int, list[str]]]) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0"]
    for name, count, properties in elements:
        lines += [f"element {name} {count}", *properties]
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii")
