"""The mesh, the last stage, on the small demo."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from small_demo import MakeOptions

from colmap_ihe.dense.ply import read_mesh, read_ply, write_rows
from colmap_ihe.errors import OptionError
from colmap_ihe.pipeline import outputs
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.stages import dense
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.folder import Project


def test_it_leaves_a_mesh_with_colours_and_one_with_a_texture(
    finished: Path, finished_summary: dict[str, Any]
) -> None:
    dense = finished / "workspace/dense/0"
    mesh = read_mesh(dense / "mesh.ply")
    assert 1000 < len(mesh.faces) == finished_summary["mesh_faces"] <= 2000
    assert mesh.colours.std() > 10
    record = read_record(Project.at(finished), "mesh")
    assert record is not None
    assert 5 < record["vertices_moved_percent"] < 100
    loaded = trimesh.load_scene(dense / "mesh.glb", process=False).geometry["mesh"]
    assert len(loaded.faces) == len(mesh.faces)
    picture = loaded.visual.material.baseColorTexture
    assert list(picture.size) == finished_summary["mesh_texture"]
    corners = np.asarray(loaded.vertices)[np.asarray(loaded.faces)]
    assert np.abs(corners - mesh.corners()).max() < 1e-4
    pixels = np.asarray(picture.convert("RGB"))
    place = np.asarray(loaded.visual.uv) * [1, -1] + [0, 1]
    assert (place >= 0).all()
    assert (place <= 1).all()
    column, row = np.minimum(place * picture.size, np.array(picture.size) - 1).astype(int).T
    by_vertex = {tuple(v): c for v, c in zip(mesh.vertices.tolist(), mesh.colours.tolist(), strict=True)}
    expected = np.array([by_vertex[tuple(v)] for v in np.asarray(loaded.vertices, np.float32).tolist()])
    difference = np.abs(pixels[row, column].astype(float) - expected).mean(axis=1)
    assert 1 < np.median(difference) < 40, f"{np.median(difference):.1f}: colours are not at their places"
    lines = (dense / "mesh.obj").read_text().splitlines()
    kinds = [sum(line.startswith(f"{word} ") for line in lines) for word in ("v", "vt", "f", "mtllib")]
    assert kinds == [len(loaded.vertices), len(loaded.vertices), len(mesh.faces), 1]
    assert "map_Kd mesh.jpeg" in (dense / "mesh.mtl").read_text()
    with Image.open(dense / "mesh.jpeg") as beside:
        assert beside.size == picture.size
    assert not list(dense.glob("*.part*"))
    upright = trimesh.load_scene(dense / "mesh.glb").graph["mesh"][0]
    assert np.allclose(upright[:3, :3] @ upright[:3, :3].T, np.eye(3), atol=1e-5)


def test_the_glb_is_not_lit_again_and_its_normals_have_length_one(finished: Path) -> None:
    content = (finished / "workspace/dense/0/mesh.glb").read_bytes()
    length, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON"
    tree = json.loads(content[20 : 20 + length])
    assert tree["extensionsUsed"] == ["KHR_materials_unlit"]
    assert [m["extensions"] for m in tree["materials"]] == [{"KHR_materials_unlit": {}}]
    (primitive,) = tree["meshes"][0]["primitives"]
    accessor = tree["accessors"][primitive["attributes"]["NORMAL"]]
    start = 28 + length + tree["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    normals = np.frombuffer(content, "<f4", 3 * accessor["count"], start).reshape(-1, 3)
    assert np.abs(np.linalg.norm(normals, axis=1) - 1).max() < 1e-5


def test_it_may_be_left_out_and_its_options_are_checked_first(
    finished: Path, quick_options: MakeOptions
) -> None:
    done = reconstruct(finished, quick_options("mesh.enabled=false"))
    assert (done.stages_run, done.summary["mesh_faces"]) == ((), None)
    assert [s.why for s in status(finished, quick_options("mesh.enabled=false"))][-1] == (
        "mesh.enabled is false"
    )
    with pytest.raises(OptionError, match="--from mesh, and mesh is switched off"):
        reconstruct(finished, quick_options("mesh.enabled=false"), start="mesh")
    done = reconstruct(finished, quick_options("mesh.texture=false", "mesh.faces=500"))
    assert done.stages_run == ("mesh", "drawings")
    assert sorted(p.name for p in done.mesh.parent.glob("mesh.*")) == ["mesh.ply"]
    assert done.summary["mesh_faces"] <= 500


def test_a_cloud_of_a_few_points_is_a_warning(finished: Path, quick_options: MakeOptions) -> None:
    project = Project.at(finished)
    cloud = project.dense / "fused.ply"
    points = read_ply(cloud)["vertex"][:20].copy()
    cloud.unlink()
    write_rows(cloud, points)
    record = read_record(project, "dense")
    assert record is not None
    project.write_record("dense", record | {"made": outputs.states_of(dense.STAGE, project, record)})
    done = reconstruct(finished, quick_options(), start="mesh")
    assert done.summary["mesh_faces"] is None
    assert any("no mesh was made: a surface needs 100 points" in text for text in done.summary["warnings"])
    assert reconstruct(finished, quick_options()).stages_run == ()
