"""Turn what a user asks for into views: façades that are found, planes, cylinders and sections by their coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from colmap_ihe.dense.camera import Float64
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.drawings.cylinders import fitted_cylinder
from colmap_ihe.drawings.frames import DrawingFrame, cylinder_frame, plane_frame, plane_of_points
from colmap_ihe.drawings.planes import Facade, extent_of, find_facades
from colmap_ihe.drawings.surface import drawn_faces
from colmap_ihe.drawings.view import View
from colmap_ihe.errors import OptionError
from colmap_ihe.machine.words import listed
from colmap_ihe.project.option_sections import DrawingsOptions, DrawingView
from colmap_ihe.survey.frames import Frame

_HIP = 0.2  # of the height of the front: where the level section is cut
_PLAN, _SECTION, _LEVEL = "plan", "section", "level"


@dataclass(frozen=True)
class DrawnModel:
    """Hold a mesh with what is up in it (3,), the middle of its cameras (3,), and the `frame` of its survey, None for a
    model that is not metric."""

    mesh: Mesh
    up: Float64
    cameras: Float64
    frame: Frame | None

    @cached_property
    def facades(self) -> Sequence[Facade]:
        """Return the façades that are found, the largest first."""
        return find_facades(self.mesh, self.up)

    def point(self, numbers: Sequence[float]) -> Float64:
        """Return (3,), a place of the user's coordinates in the model."""
        values = np.array(numbers, np.float64)
        return values if self.frame is None else np.asarray(self.frame.to_model(values[None])[0])

    def at_height(self, height: float) -> Float64:
        """Return (3,), a place of the model at a height of the user's coordinates."""
        if self.frame is None:
            return np.asarray(height * self.up)
        x, y, _ = self.frame.to_user(np.zeros((1, 3)))[0]
        return self.point((x, y, height))


def chosen_views(options: DrawingsOptions, model: DrawnModel, only: str = "") -> list[View]:
    """Return the views of project.yaml, or without any every façade that is found, the plan and two sections; `only`
    the one of that name, of either. Raises `OptionError` for a name that is none."""
    given = {name: (name, view) for name, view in options.views.items()}
    usual = {name: (name, view) for name, view in _usual(model).items()}
    chosen = given or usual
    if only:
        both = {**usual, **given}
        if only not in both:
            raise OptionError(
                f"no drawing is called {only!r:.80}",
                hint=f"there are {listed(sorted(both))}; see docs/drawings.md",
            )
        chosen = {only: both[only]}
    return [view_of(name, view, options, model) for name, view in chosen.values()]


def _usual(model: DrawnModel) -> dict[str, DrawingView]:
    usual = {facade.name: DrawingView() for facade in model.facades}
    usual[_PLAN] = DrawingView(of="plan")
    if model.facades:
        usual |= {_SECTION: DrawingView(), _LEVEL: DrawingView()}
    return usual


def view_of(name: str, asked: DrawingView, options: DrawingsOptions, model: DrawnModel) -> View:
    """Return the view that is asked for. Raises `OptionError` where there is no such façade, where numbers tell no
    plane, and for millimetres of a model that is not metric."""
    pixel_mm = asked.mm_per_pixel or options.mm_per_pixel
    if model.frame is None and pixel_mm is not None:
        raise OptionError(
            f"drawing {name}: pixels of {pixel_mm:g} mm, and the model is not metric",
            hint="leave mm_per_pixel out, or tell the model's scale: docs/survey.md",
        )
    kind, frame = _frame_of(name, asked, model)
    return View(
        name,
        kind,  # type: ignore[arg-type]
        frame,
        None if pixel_mm is None else pixel_mm / 1000,
        asked.scale or options.scale,
        asked.behind,
        asked.before,
    )


def _frame_of(name: str, asked: DrawingView, model: DrawnModel) -> tuple[str, DrawingFrame]:
    up = model.up
    try:
        if asked.plane is not None:
            return "facade", _given_plane(asked.plane, model)
        if asked.cylinder is not None:
            return "cylinder", _given_cylinder(asked.cylinder, asked.inside, model)
        if asked.section is not None:
            x, y, to_x, to_y = asked.section
            _, _, z = (0, 0, 0) if model.frame is None else model.frame.to_user(np.zeros((1, 3)))[0]
            first, second = model.point((x, y, z)), model.point((to_x, to_y, z))
            return "section", plane_frame(first, np.cross(second - first, up), up)
    except ValueError as error:
        raise OptionError(
            f"drawing {name}: {error}", hint="see docs/drawings.md for what the numbers are"
        ) from error
    if asked.height is not None:
        return "section", plane_frame(model.at_height(asked.height), up, up)
    return _found(name, asked.of or name, model)


def _given_plane(numbers: Sequence[float], model: DrawnModel) -> DrawingFrame:
    first = model.point(numbers[:3])
    if len(numbers) == 9:
        points = [first, model.point(numbers[3:6]), model.point(numbers[6:])]
        return plane_of_points(points, model.up, model.cameras)
    return plane_frame(first, np.array(numbers[3:], np.float64), model.up)


def _given_cylinder(numbers: Sequence[float], inside: bool, model: DrawnModel) -> DrawingFrame:
    point = model.point(numbers[:3])
    if len(numbers) == 7:
        axis = np.array(numbers[3:6], np.float64)
        return cylinder_frame(point, axis, numbers[6], model.up, model.cameras, inside=inside)
    point, radius = fitted_cylinder(model.mesh, model.up, point, numbers[3])
    return cylinder_frame(point, model.up, radius, model.up, model.cameras, inside=inside)


def _found(name: str, which: str, model: DrawnModel) -> tuple[str, DrawingFrame]:
    if which == _PLAN:
        return "plan", plane_frame(np.zeros(3), model.up, model.up)
    facades = {facade.name: facade for facade in model.facades}
    if which in facades:
        return "facade", facades[which].frame
    if which in (_SECTION, _LEVEL) and facades:
        return "section", _usual_section(which, model)
    names = listed([*facades, _PLAN]) if facades else "plan alone, as no upright plane was found"
    raise OptionError(
        f"drawing {name}: no façade is called {which}",
        hint=f"there is {names}; or give it a plane, cylinder, section or height: docs/drawings.md",
    )


def _usual_section(which: str, model: DrawnModel) -> DrawingFrame:
    """Return an upright cut through the middle of the front, or a level one low on it."""
    front = model.facades[0].frame
    reach = 0.25 * float(np.ptp(front.to_drawing(model.mesh.vertices.astype(np.float64))[:, 0]))
    left, bottom, right, top = extent_of(drawn_faces(model.mesh, front, reach, reach))
    if which == _LEVEL:
        return plane_frame(
            front.to_model(np.array((0.0, bottom + _HIP * (top - bottom), 0.0))), model.up, model.up
        )
    return plane_frame(front.to_model(np.array(((left + right) / 2, bottom, 0.0))), front.right, model.up)
