"""Describe what is to be drawn, and lay its pixels out or refuse to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from colmap_ihe.dense.camera import Float64
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.drawings.colours import PaintedSurface
from colmap_ihe.drawings.frames import CylinderFrame, DrawingFrame
from colmap_ihe.drawings.grid import MOST_PIXELS, PixelGrid, grid_over, nice_size
from colmap_ihe.drawings.planes import extent_of
from colmap_ihe.drawings.surface import DrawnFaces, drawn_faces
from colmap_ihe.errors import OptionError

Kind = Literal["facade", "plan", "cylinder", "section"]

DEFAULT_PIXELS = 100_000_000
"""The most pixels of a drawing whose pixel size nobody gave."""

_DEPTH = 0.25  # of the larger side of a façade: how far behind and before it things are drawn
_AROUND = 0.3  # of the radius of a cylinder, the same
_STRAIGHT = 0.99999  # cosine: a quarter of a degree
_SAMPLE = 20_000  # faces that tell the resolution of the photographs


@dataclass(frozen=True)
class View:
    """Describe a drawing: its `name`, what it is, and its `frame`. `pixel` in units of the model, None for that of the
    photographs; `scale` of its sheets; `behind` and `before`: how far from the plane things are drawn, None for
    automatic."""

    name: str
    kind: Kind
    frame: DrawingFrame
    pixel: float | None = None
    scale: int = 50
    behind: float | None = None
    before: float | None = None


@dataclass(frozen=True)
class Setting:
    """Hold what all drawings of a model have in common: whether it is `metric`; `offset` (3,), which is added to its
    coordinates to have those of `crs`, a system of a map or empty; `plan_crs`: of what the plan is in, where the
    model's system is of degrees; the lines of the `title`; by what a drawing is made, `made_by`; and by what the
    model is metric and how well, `accuracy`, in words."""

    metric: bool
    up: Float64
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    plan_crs: str = ""
    title: Mapping[str, str] = field(default_factory=dict)
    made_by: str = "draw"
    accuracy: str = ""

    @property
    def unit(self) -> str:
        return "mm" if self.metric else "thousandths of the model's unit"

    def is_level(self, view: View) -> bool:
        """Tell whether a view looks straight down, as a plan or a level section."""
        return bool(getattr(view.frame, "normal", np.zeros(3)) @ self.up > _STRAIGHT)

    def upwards(self, view: View) -> str:
        """Return what is upwards on a drawing, in a word: north of a map, y, plumb, the axis of a cylinder, or up."""
        if self.is_level(view):
            return "N" if self.plan_crs else "y"
        cylinder = isinstance(view.frame, CylinderFrame)
        upward = view.frame.axis if isinstance(view.frame, CylinderFrame) else view.frame.up
        if cylinder and abs(upward @ self.up) < _STRAIGHT:
            return "axis"
        return "plumb" if self.metric and upward @ self.up > _STRAIGHT else "up"

    def shift(self, view: View) -> tuple[float, float]:
        """Return what is added to across and up: heights become those of the survey, and x and y of a plan."""
        if self.is_level(view):
            return self.offset[0], self.offset[1]
        upward = view.frame.axis if isinstance(view.frame, CylinderFrame) else view.frame.up
        return 0.0, self.offset[2] * float(upward @ self.up)


@dataclass(frozen=True)
class Layout:
    """Hold the faces of a drawing, its pixels, and between which distances from the plane things are drawn."""

    faces: DrawnFaces
    grid: PixelGrid
    behind: float
    before: float


def layout_of(view: View, mesh: Mesh, setting: Setting, surface: PaintedSurface | None = None) -> Layout:
    """Return how a view is laid out on pixels; of a view without a size of pixels by the photographs of a `surface`, or
    without one on few. Raises `OptionError` where it misses the model, or for a size of pixels that makes too many."""
    behind, before = _depth(view, mesh)
    faces = drawn_faces(mesh, view.frame, behind, before)
    try:
        left, bottom, right, top = extent_of(faces)
    except ValueError as error:
        raise OptionError(
            f"drawing {view.name}: misses the model: no part of the mesh that is within {behind:.4g} behind and"
            f" {before:.4g} before looks to it",
            hint=f"the model reaches {_reach(mesh, setting)}; see that the plane lies there and looks outwards",
        ) from error
    if np.isfinite(view.frame.turn):
        half = float(view.frame.turn) / 2
        left, right = max(left, -half), min(right, half)
    area = (right - left) * (top - bottom)
    pixel = view.pixel or _pixel(mesh, faces, surface, area)
    _refuse_too_many(view, (right - left) / pixel, (top - bottom) / pixel, setting)
    return Layout(faces, grid_over(left, bottom, right, top, pixel), behind, before)


def _pixel(mesh: Mesh, faces: DrawnFaces, surface: PaintedSurface | None, area: float) -> float:
    if surface is None:
        return float(area**0.5 / 100)
    size = max(resolution(surface, mesh, faces), (area / DEFAULT_PIXELS) ** 0.5)
    return nice_size(1000 * size) / 1000


def _refuse_too_many(view: View, width: float, height: float, setting: Setting) -> None:
    if width * height <= MOST_PIXELS:
        return
    pixel = view.pixel or 0.0
    least = pixel * (width * height / MOST_PIXELS) ** 0.5
    raise OptionError(
        f"drawing {view.name}: pixels of {1000 * pixel:g} {setting.unit} make {width:.0f} x {height:.0f} of them,"
        f" {width * height:.1e}; at most {MOST_PIXELS:.0e} can be drawn",
        hint=f"give pixels of {1000 * least:.2g} {setting.unit} or more",
    )


def _depth(view: View, mesh: Mesh) -> tuple[float, float]:
    if view.kind == "plan":
        usual = 1e9
    elif np.isfinite(view.frame.turn):
        usual = _AROUND * float(view.frame.turn) / (2 * np.pi)
    else:
        places = view.frame.to_drawing(mesh.vertices.astype(np.float64))
        usual = _DEPTH * float(np.ptp(places[:, :2], axis=0).max())
    return (
        usual if view.behind is None else view.behind,
        usual if view.before is None else view.before,
    )


def _reach(mesh: Mesh, setting: Setting) -> str:
    low, high = mesh.vertices.min(axis=0) + setting.offset, mesh.vertices.max(axis=0) + setting.offset
    return ", ".join(f"{name} {a:.2f} to {b:.2f}" for name, a, b in zip("xyz", low, high, strict=True))


def resolution(surface: PaintedSurface, mesh: Mesh, faces: DrawnFaces) -> float:
    """Return what a pixel of the photographs is on the faces of a drawing that they colour, in units of the model: the
    median by area. Where they colour none, the size of a face."""
    corners = faces.corners
    one, other = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    area = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    rows = np.arange(0, len(corners), max(1, len(corners) // _SAMPLE))
    label = surface.label(faces.face[rows])
    middle = mesh.vertices[mesh.faces[faces.face[rows]]].mean(axis=1, dtype=np.float64)
    size = np.full(len(rows), np.nan)
    for number in np.unique(label[label >= 0]):
        photograph = surface.photographs[number]
        members = label == number
        size[members] = photograph.project(middle[members])[1] / photograph.focal_px
    known = np.flatnonzero(np.isfinite(size))
    if not len(known):
        return float(np.sqrt(2 * np.median(area)))
    order = known[np.argsort(size[known])]
    total = np.cumsum(area[rows][order])
    return float(size[order][np.searchsorted(total, total[-1] / 2)])
