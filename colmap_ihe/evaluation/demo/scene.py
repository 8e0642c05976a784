"""Build the portico: a facade of three arches behind columns, a vaulted passage, an attic, two wings.

World frame in metres: x to the right, y into the facade (its front is y = 0), z up from the ground.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from colmap_ihe.evaluation.demo import frescoes, materials
from colmap_ihe.evaluation.demo.materials import Material
from colmap_ihe.evaluation.demo.shapes import Arch, Cylinder, Rect, Shape, Sphere

_ARCHES = (-3.6, 0.0, 3.6)
_FLOOR, _SPRING, _HALF = 0.48, 2.55, 1.15
_WALL_M = 0.6  # thickness of the facade
_BACK = 3.6  # y of the back wall of the passage
_ARCHITRAVE, _CORNICE, _ATTIC, _TOP = 4.55, 5.10, 5.38, 7.25  # z where each begins
_PORCH = -1.05  # y of the architrave's front

ISOLUMINANT_PANELS = (
    Rect(1, _PORCH - 0.02, (-3.35, 5.95), (-1.25, 7.0), -1),
    Rect(1, _PORCH - 0.02, (1.25, 5.95), (3.35, 7.0), -1),
    Rect(1, _BACK - 0.03, (-4.75, 1.35), (-2.45, 3.15), -1),
)
"""The painted panels that Rec.709 sees as one grey, in the order of their materials below."""

_FACES = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "under": (2, 0), "top": (2, 1)}
"""Of a block, by name: axis, and whether on its upper side."""


@dataclass(frozen=True)
class Patch:
    """Cover a shape with a material, in texels of `texel` times the scene's finest."""

    shape: Shape
    material: Material
    texel: float = 1.0


def portico() -> tuple[Patch, ...]:
    """Return every surface of the scene, about 200."""
    parts = (_ground, _facade, _passage, _columns, _entablature, _attic, _wings, _forecourt)
    return tuple(patch for part in parts for patch in part())


def _box(
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    material: Material,
    faces: str = "front left right top",
    *,
    texel: float = 1.0,
) -> list[Patch]:
    """Return the named faces of a block between two corners; "left" is towards -x, "under" looks down."""
    patches = []
    for name in faces.split():
        axis, upper = _FACES[name]
        i, j = (k for k in range(3) if k != axis)
        at, side = (low, high)[upper][axis], 1 if upper else -1
        patches.append(Patch(Rect(axis, at, (low[i], low[j]), (high[i], high[j]), side), material, texel))
    return patches


def _drum(x: float, y: float, radius: float, low: float, high: float) -> list[Patch]:
    """Return an upright marble cylinder and the disc on its top."""
    top = Rect(2, high, (x - radius, y - radius), (x + radius, y + radius), 1, disc=True)
    return [Patch(shape, materials.marble) for shape in (Cylinder(2, (x, y), radius, low, high), top)]


def _ground() -> list[Patch]:
    patches = [Patch(Rect(2, 0.0, (-17, -13), (17, 0), 1), materials.paving, 1.5)]
    for step in range(3):
        front, height = -2.1 + 0.35 * step, _FLOOR / 3
        low, high = (-6.1, front, step * height), (6.1, front + 0.4, (step + 1) * height)
        patches += _box(low, high, materials.stone, "front top")
    patches.append(Patch(Rect(2, _FLOOR, (-6.1, -1.4), (6.1, _BACK), 1), materials.paving))
    return patches


def _facade() -> list[Patch]:
    openings = tuple(Arch(x, _SPRING, _HALF) for x in _ARCHES)
    wall = Rect(1, 0.0, (-6.1, _FLOOR), (6.1, _ARCHITRAVE), -1, openings)
    patches = [Patch(wall, materials.plaster)]
    for x in _ARCHES:
        for side in (-1, 1):
            jamb = Rect(0, x + side * _HALF, (0, _FLOOR), (_WALL_M, _SPRING), -side)
            patches.append(Patch(jamb, materials.stone))
        patches.append(Patch(Cylinder(1, (x, _SPRING), _HALF, 0, _WALL_M, vault=True), materials.brick))
    edges = (-6.1, *(x + side * _HALF for x in _ARCHES for side in (-1, 1)), 6.1)
    for left, right in zip(edges[::2], edges[1::2], strict=True):
        patches += _box((left, -0.07, 2.40), (right, 0, 2.58), materials.stone, "front top under left right")
        patches += _box((left, -0.06, _FLOOR), (right, 0, 0.95), materials.stone, "front top left right")
    for x in (-1.8, 1.8):
        patches.append(Patch(Sphere((x, 0.55, 3.5), 0.75), materials.marble))
    return patches


def _passage() -> list[Patch]:
    middle, radius, spring = (_WALL_M + _BACK) / 2, (_BACK - _WALL_M) / 2, 2.95
    back = Rect(1, _BACK, (-6.1, _FLOOR), (6.1, spring), -1)
    patches = [Patch(back, materials.sound_plaster)]
    vault = Cylinder(0, (middle, spring), radius, -6.1, 6.1, vault=True)
    patches.append(Patch(vault, materials.rose_plaster, 1.5))
    for side in (-1, 1):
        end = Rect(0, side * 6.1, (_WALL_M, _FLOOR), (_BACK, spring + radius), -side)
        patches.append(Patch(end, materials.sound_plaster))
    for x in (-1.8, 1.8):
        low, high = (x - 0.22, _BACK - 0.14, _FLOOR), (x + 0.22, _BACK, spring)
        patches += _box(low, high, materials.stone, "front left right")
        rib = Cylinder(0, (middle, spring), radius - 0.14, x - 0.22, x + 0.22, vault=True)
        patches.append(Patch(rib, materials.stone))
        for side in (-1, 1):
            corner = (_WALL_M, spring), (_BACK, spring + radius)
            opening = (Arch(middle, spring, radius - 0.14),)
            patches.append(Patch(Rect(0, x + side * 0.22, *corner, side, opening), materials.stone))
    patches.append(Patch(ISOLUMINANT_PANELS[2], frescoes.lattice_panel))
    right = Rect(1, _BACK - 0.03, (2.45, 1.35), (4.75, 3.15), -1)
    patches.append(Patch(right, frescoes.landscape_panel))
    low, high = (-0.85, _BACK - 0.10, _FLOOR), (0.85, _BACK, 2.75)
    patches += _box(low, high, materials.stone, "front left right top")
    patches.append(Patch(Rect(1, _BACK - 0.11, (-0.62, _FLOOR), (0.62, 2.5), -1), materials.wood))
    return patches


def _columns() -> list[Patch]:
    patches = []
    for x in (-5.4, -1.8, 1.8, 5.4):
        y, plinth, capital = -0.72, _FLOOR + 0.2, _ARCHITRAVE - 0.34
        patches += _box((x - 0.34, y - 0.34, _FLOOR), (x + 0.34, y + 0.34, plinth), materials.stone)
        patches += _drum(x, y, 0.30, plinth, plinth + 0.12)
        patches.append(Patch(Cylinder(2, (x, y), 0.24, plinth + 0.12, capital), materials.marble))
        patches.append(Patch(Cylinder(2, (x, y), 0.29, capital - 0.10, capital), materials.marble))
        for grow, low, high in ((0.31, capital, capital + 0.17), (0.37, capital + 0.17, _ARCHITRAVE)):
            corners = (x - grow, y - grow, low), (x + grow, y + grow, high)
            patches += _box(*corners, materials.stone, "front left right under")
    return patches


def _entablature() -> list[Patch]:
    text = "IMAGO  HISTOGRAMMATE  AEQVATA  -  MMXVI"
    frieze = partial(frescoes.inscription, ground=materials.stone, text=text)
    low, high = (-6.1, _PORCH, _ARCHITRAVE), (6.1, 0.0, _CORNICE)
    patches = _box(low, high, frieze, "front") + _box(low, high, materials.stone, "left right under")
    patches += _box((-6.3, -1.40, _CORNICE), (6.3, 0, _ATTIC), materials.stone, "front left right top under")
    for k in range(24):
        x = -5.98 + 0.52 * k
        low, high = (x - 0.09, -1.32, _CORNICE - 0.13), (x + 0.09, _PORCH, _CORNICE)
        patches += _box(low, high, materials.marble, "front left right under")
    return patches


def _attic() -> list[Patch]:
    wall = Rect(1, _PORCH, (-6.0, _ATTIC), (6.0, _TOP), -1)
    patches = [Patch(wall, materials.rose_plaster)]
    patches += _box((-6.0, _PORCH, _ATTIC), (6.0, 0, _TOP), materials.rose_plaster, "left right")
    low, high = (-6.2, _PORCH - 0.22, _TOP), (6.2, 0.2, _TOP + 0.2)
    patches += _box(low, high, materials.stone, "front left right under")
    for x in (-5.9, -3.6, -1.0, 1.0, 3.6, 5.9):
        low, high = (x - 0.15, _PORCH - 0.12, _ATTIC), (x + 0.15, _PORCH, _TOP)
        patches += _box(low, high, materials.stone, "front left right")
    paintings = (frescoes.rose_panel, frescoes.scroll_panel)
    patches += [Patch(r, p) for r, p in zip(ISOLUMINANT_PANELS, paintings, strict=False)]
    for left, right in ((-5.55, -3.95), (-0.65, 0.65), (3.95, 5.55)):
        panel = Rect(1, _PORCH - 0.02, (left, 5.95), (right, 7.0), -1)
        patches.append(Patch(panel, frescoes.landscape_panel))
    for x in (-5.9, -3.6, -1.0, 1.0, 3.6, 5.9):
        patches.append(Patch(Sphere((x, -0.9, _TOP + 0.42), 0.23), materials.stone))
    return patches


def _wings() -> list[Patch]:
    patches: list[Patch] = []
    for side in (-1, 1):
        inner, outer = 6.1, 9.3
        low_x, high_x = sorted((side * inner, side * outer))
        middle = (low_x + high_x) / 2
        niche = Arch(middle, 3.4, 0.75)
        front = Rect(1, -1.7, (low_x, 0), (high_x, 6.3), -1, (niche,))
        patches.append(Patch(front, materials.brick, 1.25))
        patches += _box((low_x, -1.7, 0), (high_x, 0, 6.3), materials.brick, "left right", texel=1.25)
        low, high = (low_x - 0.15, -1.9, 6.3), (high_x + 0.15, 0, 6.55)
        patches += _box(low, high, materials.stone, "front left right under")
        patches += _box((low_x, -1.78, 0), (high_x, -1.7, 1.1), materials.stone, "front top left right")
        patches += _niche(middle, niche)
        for x in (low_x, high_x - 0.5):
            patches += _box((x, -1.76, 1.1), (x + 0.5, -1.7, 6.3), materials.stone, "front left right")
        far = sorted((side * outer, side * 17.0))
        patches += _box((far[0], -0.5, 0), (far[1], 0, 3.4), materials.plaster, "front", texel=1.5)
        patches += _box((far[0], -0.65, 3.4), (far[1], 0, 3.6), materials.stone, "front under top", texel=1.5)
    return patches


def _niche(middle: float, opening: Arch) -> list[Patch]:
    """Return what is behind the arched window of a wing: a sill, and a statue's recess."""
    depth = (-1.7, -1.1)
    left, right = middle - opening.half, middle + opening.half
    patches = [
        Patch(Cylinder(1, (middle, opening.spring), opening.half, *depth, vault=True), materials.stone),
        Patch(Rect(1, depth[1], (left, 1.9), (right, 4.2), -1), materials.sound_plaster),
        Patch(Cylinder(2, (middle, -1.35), 0.2, 1.9, 2.7), materials.marble),
        Patch(Sphere((middle, -1.35, 2.95), 0.32), materials.marble),
    ]
    for side in (-1, 1):
        jamb = Rect(0, middle + side * opening.half, (depth[0], 1.9), (depth[1], opening.spring), -side)
        patches.append(Patch(jamb, materials.stone))
    return patches + _box((left - 0.12, -1.85, 0.4), (right + 0.12, -1.1, 1.9), materials.stone)


def _forecourt() -> list[Patch]:
    """Return fallen and carved stones before the steps."""
    patches = []
    for x, y, radius, height in ((-2.9, -3.3, 0.36, 0.55), (-3.75, -3.0, 0.36, 0.3), (0.9, -3.0, 0.33, 0.42)):
        patches += _drum(x, y, radius, 0, height)
    for x in (-5.2, 3.6):
        patches += _box((x - 0.4, -3.4, 0), (x + 0.4, -2.6, 0.75), materials.stone)
        patches.append(Patch(Sphere((x, -3.0, 0.75 + 0.38), 0.40), materials.stone))
    patches += _box((1.6, -3.5, 0), (2.7, -3.05, 0.4), materials.stone)
    patches += _box((4.9, -3.3, 0), (5.5, -2.7, 0.5), materials.brick)
    return patches
