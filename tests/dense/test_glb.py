"""The textured mesh is read as it was written, and a file that is not whole is refused by name."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from colmap_ihe.dense.glb import read_textured
from colmap_ihe.errors import ProjectError

VERTICES = np.array([(0, 0, 0), (1, 0, 0), (1, 2, 0), (0, 2, 3)], np.float32)
NORMALS = np.array([(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1)], np.float32)
FACES = [[0, 1, 2], [0, 2, 3]]
UV = np.array([(0, 0), (1, 0), (1, 0.5), (0, 0.25)])


@pytest.fixture
def glb(tmp_path: Path) -> Path:
    picture = Image.new("RGB", (8, 4), (200, 100, 50))
    picture.format = "JPEG"
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
    mesh = trimesh.Trimesh(
        VERTICES,
        FACES,
        vertex_normals=NORMALS,
        visual=trimesh.visual.TextureVisuals(uv=UV, material=material),
        process=False,
    )
    path = tmp_path / "mesh.glb"
    path.write_bytes(trimesh.Scene(mesh).export(file_type="glb", include_normals=True))
    return path


def test_arrays_come_back_and_the_texture_begins_at_the_top(glb: Path) -> None:
    mesh = read_textured(glb)
    assert np.array_equal(mesh.vertices, VERTICES) and np.array_equal(mesh.normals, NORMALS)
    assert mesh.faces.tolist() == FACES
    assert mesh.uv == pytest.approx(np.stack([UV[:, 0], 1 - UV[:, 1]], axis=1))
    assert Image.open(io.BytesIO(mesh.texture)).size == (8, 4)


@pytest.mark.parametrize("damage", ["cut", "other", "empty", "none"])
def test_a_file_that_is_not_whole_is_refused_by_name(glb: Path, damage: str) -> None:
    content = glb.read_bytes()
    if damage == "none":
        glb.unlink()
    else:
        glb.write_bytes({"cut": content[:-20], "other": b"ply\n" + content, "empty": b""}[damage])
    with pytest.raises(ProjectError, match=r"mesh\.glb: cannot be read as a textured mesh"):
        read_textured(glb)
