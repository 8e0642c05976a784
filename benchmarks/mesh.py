"""Measure the mesh against the demo's truth, and its texture against the photographs.

    python benchmarks/mesh.py PROJECT [--truth PROJECT/truth] [--pictures DIR]

PROJECT is a finished project. "Accuracy" is the share of points on the mesh that are so near to a true surface,
"completeness" the share of what the photographs truly see that is so near to the mesh; the distance is in percent
of the scene's extent. "Before the sky" is the share of the mesh where three photographs and more truly see the sky.
"Reprojection" renders the textured mesh from each camera and takes the mean absolute difference from the
undistorted photograph, in grey levels of 255, over the pixels that the mesh covers; "detail" is the mean gradient
of these renderings in percent of that of the photographs, at pixels three and more from seams and silhouettes.
"Step at seams" is the mean absolute difference, over red, green and blue, between the two sides of the edges at
which two patches meet, at three points of each edge. "Texels" are those that faces cover. The table is printed as
JSON too, in one line.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import trimesh
from PIL import Image
from surface_errors import before_sky, moved, points_on, surface_errors, true_points

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.camera import PinholeCamera
from colmap_ihe.dense.depth_maps import camera_of
from colmap_ihe.dense.ply import read_mesh
from colmap_ihe.dense.texture.bake import sample
from colmap_ihe.dense.texture.mesh import components
from colmap_ihe.dense.texture.raster import areas, covered, depth_picture
from colmap_ihe.evaluation.truth import pose_errors, read_truth

SAMPLES = 1_000_000
WITHIN_PERCENT = (0.1, 0.5)

Array = npt.NDArray[Any]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("project", type=Path)
    parser.add_argument("--truth", type=Path, help="a folder of truth, as the demo writes it")
    parser.add_argument("--pictures", type=Path, help="where renderings go, from a camera and between two")
    arguments = parser.parse_args()
    dense = arguments.project / "workspace" / "dense" / "0"
    record = json.loads((arguments.project / "records" / "mesh.json").read_text())
    rows = [
        ("faces", f"{record['faces']:,} of {record['faces_before']:,}"),
        ("octree depth", str(record["depth"])),
        ("seconds", f"{record['seconds']:.0f}"),
    ]
    if "texture" in record:
        rows.append(("texture", ", ".join(f"{k} {v}" for k, v in record["texture"].items())))
    if arguments.truth:
        rows += _against_truth(dense, arguments.truth)
    if "texture" in record:
        rows += _reprojection(dense, arguments.pictures)
    print(json.dumps(dict(rows)))
    print("| measure | value |\n|---|---|")
    for name, value in rows:
        print(f"| {name} | {value} |")


def _against_truth(dense: Path, folder: Path) -> list[tuple[str, str]]:
    truth = read_truth(folder)
    model = pycolmap.Reconstruction(dense / "sparse")
    poses = {model.images[i].name: model.images[i].cam_from_world().matrix() for i in model.reg_image_ids()}
    similarity = pose_errors(poses, truth).world_from_model
    on_mesh = moved(points_on(read_mesh(dense / "mesh.ply").corners(), SAMPLES), similarity)
    true = np.concatenate([true_points(image, step=4) for image in truth.images.values()])
    errors = surface_errors(on_mesh, true)
    rows = []
    for percent in WITHIN_PERCENT:
        accuracy, completeness = errors.shares_percent(percent / 100 * truth.extent_m)
        rows.append(
            (
                f"within {percent} % ({percent / 100 * truth.extent_m * 100:.1f} cm)",
                f"accuracy {accuracy:.1f} %, completeness {completeness:.1f} %",
            )
        )
    views = np.sum([before_sky(on_mesh, image) for image in truth.images.values()], axis=0)
    return [*rows, ("before the sky", f"{100 * np.mean(views >= 3):.3f} % of the surface")]


def _reprojection(dense: Path, pictures: Path | None) -> list[tuple[str, str]]:
    scene: Any = trimesh.load(dense / "mesh.glb", process=False)
    mesh = scene.geometry["mesh"]
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    texture = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"))
    uv = np.asarray(mesh.visual.uv) * [1, -1] + [0, 1]
    texel = uv * texture.shape[1::-1]
    patch = components(len(vertices), faces[:, [0, 1, 1, 2]].reshape(-1, 2))[faces[:, 0]]
    model = pycolmap.Reconstruction(dense / "sparse")
    differences, share, detail = [], [], []
    views = []
    for image_id in sorted(model.reg_image_ids()):
        image = model.images[image_id]
        view = camera_of(model, image_id)
        views.append(view)
        drawn, face = rendered(vertices, faces, texel, texture, view)
        here = face >= 0
        photograph = np.asarray(Image.open(dense / "images" / image.name).convert("RGB"))
        differences.append(float(np.abs(drawn[here] - photograph[here].astype(float)).mean()))
        share.append(float(here.mean()))
        within = _within(np.where(here, patch[face], -1))
        detail.append(float(gradient(drawn)[within].mean() / gradient(photograph)[within].mean()))
        if pictures and len(views) in (1, 6):
            pictures.mkdir(parents=True, exist_ok=True)
            beside = np.concatenate((photograph, np.where(here[..., None], drawn, 255)), axis=1)
            Image.fromarray(beside.astype(np.uint8)).save(pictures / f"camera-{len(views)}.png")
    if pictures and len(views) > 6:
        drawn, face = rendered(vertices, faces, texel, texture, _elsewhere(views))
        Image.fromarray(np.where(face[..., None] >= 0, drawn, 255).astype(np.uint8)).save(
            pictures / "new-view.png"
        )
    steps = seam_steps(vertices, faces, texel, texture)
    return [
        (
            "step at seams, levels of 255",
            f"median {np.median(steps):.2f}, 1 % above {np.percentile(steps, 99):.1f}, {len(steps) // 3:,} edges",
        ),
        ("texels", f"{areas(texel[faces]).sum() / 1e6:.3f} million"),
        (
            "reprojection",
            f"{np.mean(differences):.2f} of 255 (worst photograph {max(differences):.2f}),"
            f" over {100 * np.mean(share):.0f} % of the pixels",
        ),
        ("detail", f"{100 * np.mean(detail):.1f} % of the photographs' gradient"),
    ]


def seam_steps(vertices: Array, faces: Array, texel: Array, texture: Array) -> Array:
    """Return (N,), the differences of colour at three points of each edge that has two places on the texture."""
    _, vertex = np.unique(vertices, axis=0, return_inverse=True)
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    turned = vertex[ends[:, 0]] > vertex[ends[:, 1]]
    ends[turned] = ends[turned][:, ::-1]
    key = vertex[ends[:, 0]].astype(np.int64) * len(vertices) + vertex[ends[:, 1]]
    order = np.argsort(key, kind="stable")
    same = key[order][1:] == key[order][:-1]
    one, other = ends[order[:-1][same]], ends[order[1:][same]]
    seam = (one != other).any(axis=1)
    steps = []
    for share in (0.25, 0.5, 0.75):
        sides = [
            sample(texture, (1 - share) * texel[side[seam, 0]] + share * texel[side[seam, 1]])
            for side in (one, other)
        ]
        steps.append(np.abs(sides[0] - sides[1]).mean(axis=1))
    return np.concatenate(steps)


def gradient(picture: Array) -> Array:
    """Return (H, W), the length of the gradient of the mean of red, green and blue."""
    down, across = np.gradient(picture.astype(float).mean(axis=2))
    return np.asarray(np.hypot(down, across))


def _within(patch: Array) -> Array:
    """Return (H, W), true where all within three pixels is of one patch of those numbered from 0 up."""
    square = np.ones((7, 7), np.uint8)
    number = patch.astype(np.float32)
    return np.asarray((cv2.erode(number, square) == cv2.dilate(number, square)) & (patch >= 0))


def _elsewhere(views: list[PinholeCamera]) -> PinholeCamera:
    """Return the middle camera, raised by a quarter of what the cameras span and turned down to what it looked at."""
    middle = views[len(views) // 2]
    right, down, forward = middle.cam_from_world[:, :3]
    span = float(np.linalg.norm(np.ptp([view.centre for view in views], axis=0)))
    centre = middle.centre - 0.25 * span * down + 0.1 * span * right
    turned = forward + 0.3 * down
    turned /= np.linalg.norm(turned)
    right = np.cross(down, turned)
    right /= np.linalg.norm(right)
    rotation = np.stack((right, np.cross(turned, right), turned))
    return PinholeCamera(middle.K, np.column_stack((rotation, -rotation @ centre)), middle.size)


def rendered(
    vertices: Array, faces: Array, texel: Array, texture: Array, view: PinholeCamera
) -> tuple[Array, Array]:
    """Draw the mesh in perspective: (H, W, 3) float, and (H, W) the face, -1 where there is none; only faces that show
    their outside."""
    pixels, depths = view.project(vertices.astype(np.float32))
    corners, depth = pixels[faces], depths[faces]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # Anticlockwise from outside is clockwise where y is down.
    front = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] < 0
    number = np.flatnonzero(front)
    corners, depth, faces = corners[front], depth[front], faces[front]
    nearest = depth_picture(corners, depth, view.size).ravel()
    place = np.zeros((len(nearest), 2))
    face = np.full(len(nearest), -1)
    for part in covered(corners, view.size):
        weights = part.weights / depth[part.face]
        z = 1 / weights.sum(axis=1)
        first = z <= nearest[part.pixel] * (1 + 1e-5)
        found = (texel[faces[part.face]] * weights[:, :, None]).sum(axis=1) * z[:, None]
        place[part.pixel[first]] = found[first]
        face[part.pixel[first]] = number[part.face[first]]
    here = np.isfinite(nearest)
    drawn = np.zeros((len(nearest), 3))
    drawn[here] = sample(texture, place[here])
    return drawn.reshape(*view.size[::-1], 3), face.reshape(view.size[::-1])


if __name__ == "__main__":
    main()
