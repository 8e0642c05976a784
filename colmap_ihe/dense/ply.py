"""Read and write PLY files as COLMAP does: binary, little-endian, triangles only."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.errors import ProjectError

Rows = npt.NDArray[np.void]

COLOURS = ("red", "green", "blue")
_TYPES = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4", "uint": "<u4"}
_END = re.compile(
    rb"end_header\r?\n"
)  # COLMAP writes the header as text, whose lines end in CR LF on Windows
_NAMES = {np.dtype(kind): name for name, kind in _TYPES.items()}


def read_ply(path: Path) -> dict[str, Rows]:
    """Return the elements of a file by name, each a structured array with the file's own names.

    The vertices of faces are (F, 3) below the name of their list, and their number below that name and " count".
    Raises `ProjectError` where the file is not whole.
    """
    try:
        content = np.memmap(path, mode="r")
        header = bytes(content[:4096])
        ended = _END.search(header)
        if ended is None:
            raise ValueError("its header has no end")
        start = ended.end()
        elements = {}
        for name, count, fields in _elements(header[:start].decode("ascii")):
            dtype = np.dtype(fields)
            end = start + count * dtype.itemsize
            elements[name] = np.frombuffer(content[start:end], dtype, count)
            start = end
    except (OSError, ValueError, KeyError, IndexError, TypeError, OverflowError) as error:
        raise _unreadable(path, "a binary PLY file of triangles", error) from error
    return elements


def _unreadable(path: Path, kind: str, error: Exception) -> ProjectError:
    return ProjectError(
        f"{path}: cannot be read as {kind} ({error})", hint="run the stage that makes it again, with --from"
    )


def _elements(header: str) -> list[tuple[str, int, list[Any]]]:
    """Return name, count and numpy fields of each element of a header."""
    elements: list[tuple[str, int, list[Any]]] = []
    for line in header.splitlines():
        words = line.split()
        if words[0] == "format" and words[1] != "binary_little_endian":
            raise ValueError(f"it is {words[1]}, not binary_little_endian")
        if words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            fields = ((f"{words[4]} count", _TYPES[words[2]]), (words[4], _TYPES[words[3]], 3))
            elements[-1][2].extend(fields)
        elif words[0] == "property":
            elements[-1][2].append((words[2], _TYPES[words[1]]))
    return elements


def read_mesh(path: Path) -> Mesh:
    """Read a mesh, grey where the file has no colours. Raises `ProjectError`."""
    elements = read_ply(path)
    try:
        vertices, faces = elements["vertex"], elements["face"]
        index = next((n for n in faces.dtype.names or () if faces.dtype[n].shape == (3,)), None)
        if index is None or (len(faces) and (faces[f"{index} count"] != 3).any()):
            raise ValueError("not all of its faces are triangles")
        positions = columns(vertices, "xyz").astype(np.float32)
        colours = np.full(positions.shape, 128, np.uint8)
        if "red" in (vertices.dtype.names or ()):
            colours = columns(vertices, COLOURS).astype(np.uint8)
        return Mesh(positions, faces[index].astype(np.int32), colours)
    except (ValueError, KeyError, TypeError) as error:
        raise _unreadable(path, "a mesh", error) from error


def columns(rows: Rows, names: tuple[str, ...] | str) -> npt.NDArray[Any]:
    """Return (N, len(names)) of the fields of a structured array."""
    return np.stack([rows[name] for name in names], axis=1)


def write_mesh(path: Path, mesh: Mesh) -> None:
    """Write a mesh with vertex colours."""
    kinds = [*((axis, "<f4") for axis in "xyz"), *((name, "u1") for name in COLOURS)]
    vertices = np.rec.fromarrays([*mesh.vertices.T, *mesh.colours.T], dtype=kinds)
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("vertex_indices", "<i4", 3)])
    faces["count"], faces["vertex_indices"] = 3, mesh.faces
    lists = f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
    _write(path, row_header(len(vertices), vertices.dtype, lists), vertices, faces)


def write_rows(path: Path, rows: Rows) -> None:
    """Write a cloud; `rows` is a structured array."""
    _write(path, row_header(len(rows), rows.dtype), rows)


def _write(path: Path, header: bytes, *elements: Rows) -> None:
    with path.open("wb") as handle:
        handle.write(header)
        for rows in elements:
            handle.write(rows.tobytes())


def row_header(count: int, dtype: np.dtype[Any], more: str = "") -> bytes:
    """Return the header of a file of `count` vertices of a structured `dtype`, with the lines of `more` elements."""
    properties = "".join(f"property {_NAMES[dtype[name]]} {name}\n" for name in dtype.names or ())
    start = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    return f"{start}{properties}{more}end_header\n".encode("ascii")
