"""The mesh of a project as its page shows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from colmap_ihe.dense.ply import read_mesh
from colmap_ihe.pipeline.model_view import ModelView
from colmap_ihe.pipeline.surface_view import lighter, surface_of
from colmap_ihe.project.folder import Project


def test_it_is_textured_and_stands_in_the_frame_of_the_cloud(finished: Path) -> None:
    project = Project.at(finished)
    model = ModelView(project.sparse / "0")
    surface = surface_of(project, {"files": ["mesh.ply", "mesh.glb"]}, model)
    assert surface is not None and surface.texture is not None and surface.uv is not None
    assert (surface.uv >= 0).all() and (surface.uv <= 1).all()
    assert np.linalg.norm(surface.normals, axis=1) == pytest.approx(1, abs=1e-3)
    cloud = model.dense_points(project.dense / "fused.ply", 5000).positions
    low, high = np.percentile(cloud, (5, 95), axis=0)
    inside = ((surface.positions > low - 1) & (surface.positions < high + 1)).all(axis=1)
    assert inside.mean() > 0.8
    assert (surface.normals[:, 2] > 0).mean() > 0.6  # towards who photographed
    half = lighter(surface, 0.5)
    assert len(half.faces) < 0.9 * len(surface.faces) == 0.9 * surface.faces_in_all
    assert half.texture is not None and half.texture.width < surface.texture.width


def test_without_a_texture_it_has_the_colours_of_its_vertices(finished: Path) -> None:
    project = Project.at(finished)
    model = ModelView(project.sparse / "0")
    surface = surface_of(project, {"files": ["mesh.ply"]}, model)
    assert surface is not None and surface.texture is None
    assert surface.colours is not None
    assert np.array_equal(surface.colours, read_mesh(project.mesh).colours)
    assert surface_of(project, {"files": []}, model) is None
    assert surface_of(project, {}, model) is None
