"""Describe places as surveys photograph them: flat panels with texture, and the stations of a walk with a camera.

Metres; z is up. A facade is a wall of 20 x 12 m with windows, cornices and pilasters, photographed from one or two
lines before it. A courtyard has four such walls, photographed across and in short pans. An object is a monument of 3 m
with the square around it, photographed in one or two rings. A street is walked forward between two rows of houses,
every second photograph turned to one of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Vector = tuple[float, float, float] | Floats


@dataclass(frozen=True)
class Panels:
    """Hold flat rectangles: (n, 3) corners and edges; a normal is across x up. `texture` (n,) is features per area."""

    corner: Floats
    across: Floats
    up: Floats
    texture: Floats

    @property
    def normal(self) -> Floats:
        cross = np.cross(self.across, self.up)
        return np.asarray(cross / np.linalg.norm(cross, axis=1, keepdims=True))

    @property
    def area(self) -> Floats:
        return np.asarray(np.linalg.norm(np.cross(self.across, self.up), axis=1))


@dataclass(frozen=True)
class View:
    """Tell the half angles of a photograph to its side and to its top, in radians."""

    side: float
    top: float


class Builder:
    """Collect panels in the axes of one wall: u to the right, v up, w out of the wall towards who looks at it."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.rows: list[tuple[Floats, Floats, Floats, float]] = []
        self.stand((0, 0, 0), 0)

    def stand(self, origin: Vector, turn: float) -> None:
        """Put what follows at `origin`, turned about z by `turn` radians; unturned walls look to -y."""
        self.origin = np.asarray(origin, float)
        self.u = np.array([np.cos(turn), np.sin(turn), 0])
        self.w = np.array([np.sin(turn), -np.cos(turn), 0])
        self.v = np.array([0.0, 0, 1])

    def panel(self, corner: Vector, across: Vector, up: Vector, texture: float) -> None:
        axes = np.array([self.u, self.v, self.w])
        place, side, rise = (np.asarray(vector, float) @ axes for vector in (corner, across, up))
        # Plaster beside carving: whole panels are rich or poor.
        richness = texture * self.rng.lognormal(0, 0.6)
        self.rows.append((self.origin + place, side, rise, richness))

    def box(self, low: Vector, high: Vector, texture: float) -> None:
        """Add a box that stands out of the wall: its front, sides, top and underside."""
        u, v, w = (np.asarray(high, float) - np.asarray(low, float)).tolist()
        left, bottom, back = np.asarray(low, float).tolist()
        self.panel((left, bottom, back + w), (u, 0, 0), (0, v, 0), texture)
        self.panel((left, bottom, back), (0, 0, w), (0, v, 0), texture)
        self.panel((left + u, bottom, back + w), (0, 0, -w), (0, v, 0), texture)
        self.panel((left, bottom + v, back + w), (u, 0, 0), (0, 0, -w), texture)
        self.panel((left, bottom, back), (u, 0, 0), (0, 0, w), texture)

    def window(self, left: float, bottom: float, width: float, height: float) -> None:
        """Add a cell of the wall with a window set back by a reveal."""
        rng = self.rng
        opening, tall, depth = (
            width * rng.uniform(0.35, 0.5),
            height * rng.uniform(0.5, 0.62),
            rng.uniform(0.1, 0.4),
        )
        side, sill = (width - opening) / 2, height * 0.2
        top = sill + tall
        inner, right = left + side, left + side + opening
        self.panel((left, bottom, 0), (side, 0, 0), (0, height, 0), 1)
        self.panel((right, bottom, 0), (side, 0, 0), (0, height, 0), 1)
        self.panel((inner, bottom, 0), (opening, 0, 0), (0, sill, 0), 1)
        self.panel((inner, bottom + top, 0), (opening, 0, 0), (0, height - top, 0), 1)
        self.panel((inner, bottom + sill, -depth), (opening, 0, 0), (0, tall, 0), 0.4)
        self.panel((inner, bottom + sill, 0), (0, 0, -depth), (0, tall, 0), 0.8)
        self.panel((right, bottom + sill, -depth), (0, 0, depth), (0, tall, 0), 0.8)
        self.panel((inner, bottom + sill, 0), (opening, 0, 0), (0, 0, -depth), 0.8)
        if rng.random() < 0.6:
            rise = rng.uniform(0.1, 0.35)
            self.box((inner - 0.1, bottom + top, 0), (right + 0.1, bottom + top + 0.25, rise), 2)

    def facade(self, width: float, height: float, bay: float = 2.8) -> None:
        """Add a wall of windows with cornices and pilasters, from (0, 0) to (width, height)."""
        rng = self.rng
        bays, storeys = max(round(width / bay), 1), max(round(height / 3.8), 1)
        across, rise = width / bays, height / storeys
        for storey in range(storeys):
            for number in range(bays):
                self.window(number * across, storey * rise, across, rise)
            self.box(
                (0, (storey + 1) * rise - 0.35, 0), (width, (storey + 1) * rise, rng.uniform(0.2, 0.6)), 2
            )
        for number in range(0, bays + 1, 2):
            middle = min(max(number * across, 0.25), width - 0.25)
            self.box((middle - 0.25, 0, 0), (middle + 0.25, height - 0.35, rng.uniform(0.1, 0.3)), 1.5)

    def ground(self, low: tuple[float, float], high: tuple[float, float], texture: float) -> None:
        """Add the ground in slabs of some two metres."""
        self.stand((0, 0, 0), 0)
        columns, rows = (max(round((end - begin) / 2), 1) for begin, end in zip(low, high, strict=True))
        wide, deep = (high[0] - low[0]) / columns, (high[1] - low[1]) / rows
        for column in range(columns):
            for row in range(rows):
                # In a wall's axes: w is -y.
                corner = (low[0] + column * wide, 0, -low[1] - row * deep)
                self.panel(corner, (wide, 0, 0), (0, 0, -deep), texture)

    def panels(self) -> Panels:
        corner, across, up, texture = (np.array(column) for column in zip(*self.rows, strict=True))
        return Panels(corner, across, up, texture)


def pose(centre: Vector, heading: float, pitch: float, roll: float = 0) -> Floats:
    """Return cam_from_world (3, 4): heading 0 looks to +y, positive turns right, positive pitch looks up; radians."""
    forward = np.array([np.sin(heading) * np.cos(pitch), np.cos(heading) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.cos(heading), -np.sin(heading), 0])
    down = np.cross(forward, right)
    axes = np.array(
        [np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right, forward]
    )
    return np.column_stack([axes, -axes @ np.asarray(centre, float)])


def _facade(images: int, view: View, rng: np.random.Generator) -> tuple[Panels, list[Floats]]:
    builder = Builder(rng)
    builder.facade(20, 12)
    builder.ground((-3, -14), (23, 0), 0.15)
    lines = 1 if images < 12 else 2
    upended = rng.choice(images, round(0.1 * images) if images >= 12 else 0, replace=False)
    stations: list[Floats] = []
    for line in range(lines):
        count = images // lines + (line < images % lines)
        distance = rng.uniform(8, 15)
        step = 2 * distance * np.tan(view.side) * rng.uniform(0.18, 0.28)
        travel = min(step * (count - 1), 16)
        begin = rng.uniform(2, 18 - travel)
        for x in np.linspace(begin, begin + travel, count) + rng.normal(0, 0.25, count):
            heading = rng.normal(0, np.radians(4))
            if rng.random() < 0.35:  # turned towards the middle of the wall
                heading = np.radians(rng.uniform(8, 30)) * (1 if x < 10 else -1)
            away = distance + rng.normal(0, 0.4)
            pitch = np.arctan2(rng.uniform(3, 6) - 1.6, away)
            roll = np.pi / 2 if len(stations) in upended else rng.normal(0, np.radians(1))
            stations.append(pose((x, -away, 1.6 + rng.normal(0, 0.2)), heading, pitch, roll))
    return builder.panels(), stations


def _courtyard(images: int, view: View, rng: np.random.Generator) -> tuple[Panels, list[Floats]]:
    builder, wide, deep = Builder(rng), 24.0, 18.0
    for origin, turn, width in (
        ((-wide / 2, deep / 2, 0), 0, wide),
        ((wide / 2, deep / 2, 0), -np.pi / 2, deep),
        ((wide / 2, -deep / 2, 0), np.pi, wide),
        ((-wide / 2, -deep / 2, 0), np.pi / 2, deep),
    ):
        builder.stand(origin, turn)
        builder.facade(width, 10)
    builder.ground((-wide / 2, -deep / 2), (wide / 2, deep / 2), 0.15)
    step = min(2 * view.side * 0.35, 2 * np.pi / images)
    heading, ring, stations = rng.uniform(0, 2 * np.pi), rng.uniform(3.5, 5.5), []
    centre = np.zeros(3)
    for number in range(images):
        looks = heading + number * step
        if (
            number % 3 < 2
        ):  # a walk along the ring, looking across; every third photograph is a pan from the same stop
            centre = np.array([-ring * np.sin(looks), -ring * np.cos(looks), 1.6])
        stop = centre + rng.normal(0, (0.15, 0.15, 0.1))
        stations.append(pose(stop, looks + rng.normal(0, 0.05), rng.uniform(0.05, 0.25), rng.normal(0, 0.02)))
    return builder.panels(), stations


def _object(images: int, view: View, rng: np.random.Generator) -> tuple[Panels, list[Floats]]:
    builder = Builder(rng)

    def prism(sides: int, radius: float, low: float, high: float, texture: float) -> None:
        edge = 2 * radius * np.tan(np.pi / sides)
        for number in range(sides):
            builder.stand((0, 0, 0), 2 * np.pi * number / sides)
            builder.panel((-edge / 2, low, radius), (edge, 0, 0), (0, high - low, 0), texture)
        builder.stand((0, 0, 0), 0)
        builder.panel((-radius, high, radius), (2 * radius, 0, 0), (0, 0, -2 * radius), texture / 2)

    prism(4, 1.3, 0, 0.25, 1)
    prism(4, 0.95, 0.25, 0.5, 1)
    prism(4, 0.6, 0.5, 1.5, 1.5)
    prism(4, 0.7, 1.5, 1.65, 2)
    low = 1.65
    for radius in rng.uniform(0.22, 0.45, 5):
        prism(8, radius, low, low + 0.27, 3)
        low += 0.27
    builder.ground((-8, -8), (8, 8), 0.1)
    for number in range(4):
        builder.stand((0, 0, 0), np.pi / 2 * number)
        far = rng.uniform(18, 28)
        builder.origin = -far * builder.w - far * builder.u
        builder.facade(2 * far, 10, bay=5)
    rings = 1 if images < 20 else 2
    stations = []
    for ring in range(rings):
        count = images // rings + (ring < images % rings)
        step = min(np.radians(15), 2 * np.pi / count)
        radius = max(1.7 / np.tan(view.top) + 0.7, 3) * rng.uniform(0.9, 1.15)
        eye, begin = (1.6, 2.3)[ring], rng.uniform(0, 2 * np.pi)
        for number in range(count):
            around = begin + step * (number + rng.normal(0, 0.12))
            away = radius * rng.normal(1, 0.04)
            centre = (-away * np.sin(around), -away * np.cos(around), eye + rng.normal(0, 0.06))
            pitch = np.arctan2(rng.uniform(1.4, 1.7) - eye, away)
            stations.append(pose(centre, around + rng.normal(0, 0.03), pitch, rng.normal(0, 0.02)))
    return builder.panels(), stations


def _street(images: int, _view: View, rng: np.random.Generator) -> tuple[Panels, list[Floats]]:
    builder, step = Builder(rng), rng.uniform(0.9, 1.6)
    half, length = rng.uniform(4, 6), images * step + 30
    for side in (-1, 1):
        along = 0.0
        while along < length:
            width = rng.uniform(8, 14)
            if side < 0:
                builder.stand((-half - rng.uniform(0, 0.5), along, 0), np.pi / 2)
            else:
                builder.stand((half + rng.uniform(0, 0.5), along + width, 0), -np.pi / 2)
            builder.facade(width, rng.uniform(8, 12), bay=3.5)
            along += width
    builder.stand((-half - 3, length + 5, 0), 0)
    builder.facade(2 * half + 6, 12, bay=3.5)
    builder.ground((-half, 0), (half, length), 0.2)
    stations, x = [], rng.uniform(-1, 1)
    for number in range(images):
        x = 0.7 * x + rng.normal(0, 0.7)
        centre = (x, 2 + number * step + rng.normal(0, 0.1), 1.6 + rng.normal(0, 0.06))
        heading, pitch = rng.normal(0, np.radians(6)), rng.normal(0.08, 0.05)
        if number % 2:  # turned to the houses of one side
            heading = np.radians(rng.uniform(18, 38)) * rng.choice((-1, 1))
        stations.append(pose(centre, heading, pitch, rng.normal(0, 0.02)))
    return builder.panels(), stations


PLACES = {"facade": _facade, "courtyard": _courtyard, "object": _object, "street": _street}
