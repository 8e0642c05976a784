"""Write a textured mesh as text: Wavefront's OBJ, and the MTL file that names its texture."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

_AT_ONCE = 100_000  # lines, formatted by one call
_MATERIAL = """newmtl {name}
Ka 1.00000000 1.00000000 1.00000000
Kd 1.00000000 1.00000000 1.00000000
Ks 0.00000000 0.00000000 0.00000000
Ns 1.00000000
map_Kd {texture}"""


def obj_text(
    vertices: npt.NDArray[np.floating[Any]],
    uv: npt.NDArray[np.floating[Any]],
    faces: npt.NDArray[np.integer[Any]],
    material: str,
    library: str,
) -> str:
    """Return the OBJ file of `vertices` (N, 3), each with its place `uv` (N, 2) on the texture, from the bottom left,
    and `faces` (F, 3) of their rows, by a `material` of the MTL file `library`."""
    names = [f"{number}/{number}" for number in range(1, len(vertices) + 1)]
    corners = [names[row] for row in faces.ravel().tolist()]
    lines = [*_lines("v", "%.8f", vertices.shape[1], vertices.ravel().tolist())]
    lines += [*_lines("vt", "%.8f", uv.shape[1], uv.ravel().tolist()), *_lines("f", "%s", 3, corners)]
    return "\n".join((f"mtllib {library}", f"usemtl {material}", *lines, ""))


def mtl_text(material: str, texture: str) -> str:
    """Return the MTL file of a `material` of white, lit by nothing but its own `texture`, a file beside it."""
    return _MATERIAL.format(name=material, texture=texture)


def _lines(word: str, each: str, count: int, values: list[Any]) -> Iterator[str]:
    """Yield lines of `count` values, many at a time: by one format for all, which is faster than one for each."""
    line = " ".join((word, *[each] * count))
    for start in range(0, len(values), count * _AT_ONCE):
        part = values[start : start + count * _AT_ONCE]
        yield "\n".join([line] * (len(part) // count)) % tuple(part)
