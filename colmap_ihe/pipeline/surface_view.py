"""Read the mesh of a project for its page."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from colmap_ihe.dense.glb import read_textured
from colmap_ihe.dense.ply import read_mesh
from colmap_ihe.dense.texture.fewer_faces import fewer_faces
from colmap_ihe.dense.texture.mesh import vertex_normals
from colmap_ihe.pipeline.model_view import ModelView
from colmap_ihe.project.folder import Project
from colmap_ihe.report import pictures
from colmap_ihe.report.contents import Surface

_Faces = NDArray[np.int64]

_TEXTURE = 4096  # pixels, the longest side that telephones draw
_FACES = 300_000  # of a page
_COARSER = (60_000, 15_000)  # drawn while the model turns, where all would take too long


def surface_of(project: Project, mesh_record: Mapping[str, Any], model: ModelView) -> Surface | None:
    """Return the mesh of a project, textured where it is, else None. Raises `ProjectError` where it cannot be read."""
    files = mesh_record.get("files", ())
    if "mesh.glb" in files:
        return _textured(project, model)
    return _coloured(project, model) if project.mesh.name in files else None


def _textured(project: Project, model: ModelView) -> Surface:
    mesh = read_textured(project.dense / "mesh.glb")
    pixels: NDArray[np.uint8] = simplejpeg.decode_jpeg(mesh.texture)
    faces = fewer_faces(mesh.vertices, mesh.faces, _FACES)
    return Surface(
        model.moved(mesh.vertices),
        model.turned(mesh.normals),
        faces,
        _coarser(mesh.vertices, faces),
        len(mesh.faces),
        texture=pictures.picture(pixels, "the texture of the mesh", _TEXTURE),
        uv=mesh.uv,
    )


def _coloured(project: Project, model: ModelView) -> Surface:
    mesh = read_mesh(project.mesh)
    faces = fewer_faces(mesh.vertices, mesh.faces.astype(np.int64), _FACES)
    normals = model.turned(vertex_normals(mesh))
    return Surface(
        model.moved(mesh.vertices),
        normals,
        faces,
        _coarser(mesh.vertices, faces),
        len(mesh.faces),
        colours=mesh.colours,
    )


def _coarser(vertices: NDArray[np.float32], faces: _Faces) -> list[_Faces]:
    """Return fewer and fewer triangles in place of those of the page."""
    levels = []
    for most in _COARSER:
        if len(faces) > most:
            faces = fewer_faces(vertices, faces, most)
            levels.append(faces)
    return levels


def lighter(surface: Surface, share: float) -> Surface:
    """Return a surface with that share of its triangles, of its texture's pixels, and of what it takes on a page."""
    most = round(share * len(surface.faces))
    faces = fewer_faces(surface.positions, surface.faces, most)
    coarser = _coarser(surface.positions, faces)
    texture = surface.texture
    if texture is not None:
        pixels: NDArray[np.uint8] = simplejpeg.decode_jpeg(texture.jpeg)
        side = round(share**0.5 * max(texture.width, texture.height))
        texture = pictures.picture(pixels, texture.alt, side)
    return dataclasses.replace(surface, faces=faces, coarser=coarser, texture=texture)
