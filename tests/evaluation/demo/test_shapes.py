"""Each shape's four answers must agree with each other, and with rays worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from colmap_ihe.evaluation.demo.shapes import Arch, Cylinder, Rect, Shape, Sphere, Vector

SHAPES: dict[str, Shape] = {
    "wall": Rect(1, 2.0, (-3, 0.5), (4, 5), -1),
    "floor": Rect(2, 0.5, (-3, -2), (4, 5), 1),
    "side": Rect(0, -1.0, (-3, 0), (4, 5), 1),
    "column": Cylinder(2, (1.0, -0.5), 0.4, 0.2, 4.0),
    "barrel": Cylinder(0, (2.0, 3.0), 1.5, -4, 4, vault=True),
    "arch": Cylinder(1, (-1.0, 2.5), 1.1, 0, 0.6, vault=True),
    "ball": Sphere((1.0, 2.0, 3.0), 0.8),
}


def vector(x: float, y: float, z: float) -> Vector:
    return np.float32(x).reshape(1), np.float32(y).reshape(1), np.float32(z).reshape(1)


@pytest.mark.parametrize("name", SHAPES)
def test_a_ray_at_a_point_of_the_surface_hits_it_there(name: str) -> None:
    shape = SHAPES[name]
    rng = np.random.default_rng(2)
    width, height = shape.size_m
    across = rng.uniform(0.05 * width, 0.95 * width, 300).astype(np.float32)
    down = rng.uniform(0.05 * height, 0.95 * height, 300).astype(np.float32)
    point, normal = shape.surface(across, down)

    np.testing.assert_allclose(sum(n * n for n in normal), 1, atol=1e-5)
    low, high = shape.box
    for k in range(3):
        assert np.all((point[k] >= low[k] - 1e-5) & (point[k] <= high[k] + 1e-5))

    # From just before the surface, so that nothing else of the shape lies between.
    origin = tuple(p + np.float32(0.1) * n for p, n in zip(point, normal, strict=True))
    direction = tuple(-n for n in normal)
    t = shape.hit((origin[0], origin[1], origin[2]), (direction[0], direction[1], direction[2]))
    np.testing.assert_allclose(t, 0.1, atol=2e-5)

    found_across, found_down = shape.locate(point)
    np.testing.assert_allclose(found_across, across, atol=2e-3)
    np.testing.assert_allclose(found_down, down, atol=2e-3)


def test_rays_pass_through_the_opening_of_an_arch() -> None:
    wall = Rect(1, 0.0, (-3, 0), (3, 5), -1, (Arch(0.0, 2.0, 1.0),))
    origin = vector(0, -5, 0)
    for x, z, free in ((0, 1, True), (0.99, 1.9, True), (0, 2.99, True), (0.8, 2.8, False), (1.01, 1, False)):
        t = wall.hit(origin, vector(x / 5, 1, z / 5))[0]
        assert np.isinf(t) if free else t == pytest.approx(5)


def test_a_column_is_hit_at_its_front_and_missed_beside() -> None:
    column = Cylinder(2, (0.0, 0.0), 0.5, 0, 3)
    assert column.hit(vector(0, -4, 1), vector(0, 1, 0))[0] == pytest.approx(3.5)
    assert np.isinf(column.hit(vector(0.51, -4, 1), vector(0, 1, 0))[0])
    assert np.isinf(column.hit(vector(0, -4, 3.1), vector(0, 1, 0))[0])


def test_rectangles_are_seen_from_one_side_only() -> None:
    wall = SHAPES["wall"]
    assert wall.faces(np.array((0.0, 1.0, 1.0)))
    assert not wall.faces(np.array((0.0, 3.0, 1.0)))
