from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from colmap_ihe.dense.obj import mtl_text, obj_text


def test_others_read_what_is_written(tmp_path: Path) -> None:
    """More lines than are formatted at a time, and corners of any number of digits."""
    chance = np.random.default_rng(0)
    vertices, uv = chance.normal(size=(120_000, 3)), chance.random((120_000, 2))
    corners = (np.arange(len(vertices)), chance.integers(0, len(vertices), 210_000))
    faces = np.concatenate(corners).reshape(-1, 3)  # all vertices are of a face
    Image.new("RGB", (4, 4), (10, 200, 30)).save(tmp_path / "t.jpeg")
    (tmp_path / "m.mtl").write_text(mtl_text("photographs", "t.jpeg"))
    (tmp_path / "m.obj").write_text(obj_text(vertices, uv, faces, "photographs", "m.mtl"))
    read: Any = trimesh.load(tmp_path / "m.obj", process=False, maintain_order=True)
    assert np.allclose(read.vertices[read.faces], vertices[faces], atol=1e-8, rtol=0)
    assert np.allclose(read.visual.uv[read.faces], uv[faces], atol=1e-8, rtol=0)
    assert read.visual.material.image.size == (4, 4)


def test_lines_are_as_elsewhere() -> None:
    text = obj_text(np.eye(3, dtype=np.float32), np.zeros((3, 2)), np.array([[0, 1, 2]]), "a", "b.mtl")
    lines = text.splitlines()
    assert lines[:3] == ["mtllib b.mtl", "usemtl a", "v 1.00000000 0.00000000 0.00000000"]
    assert lines[-2:] == ["vt 0.00000000 0.00000000", "f 1/1 2/2 3/3"]


def test_a_mesh_without_faces_is_a_file() -> None:
    assert obj_text(np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 3), int), "a", "b").count("\n") == 2
