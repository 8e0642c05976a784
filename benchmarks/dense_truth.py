"""Run dense stereo on several greys of one set with the same cameras, against true surfaces where there are any.

    python benchmarks/dense_truth.py PROJECT [--truth PROJECT/truth] [--methods project ihe paper rec709 green] [--json]

PROJECT is reconstructed as far as the sparse model, whose cameras serve every method; "project" is its own dense cloud
as it lies there, with its second grey if it has one, "paper" is IHE without the guard. Of the demo, whose truth is
exact: accuracy is the share of the fused points that are so near to a true surface, completeness the share of what the
photographs truly see that is so near to a fused point, F their harmonic mean (Schoeps et al. 2017, ETH3D); the distance
is in percent of the scene's extent. "Walls" fits a plane to the points on each of the demo's flat walls: the median
distance from it, in percent of the extent, over the walls and of the worst; "flat surfaces" are floors, treads and
undersides too, with what stands on them within 0.5 % of the extent.
"Far side of edges": pixels that see the farther surface within 4 pixels of an edge of true depth; the share that has a
depth, the share of these that is wrong by over 2 %, and their median signed error (fattened foreground is negative).
"Points before the sky": the share of the fused points where a photograph, or three, truly see the sky, at the pixel and
all that touch it.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from edge_errors import EdgeErrors, edge_errors, pooled_edges
from numpy.typing import NDArray
from surface_errors import before_sky, moved, surface_errors, true_points

from colmap_ihe import convert_folder
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.dense.depth_maps import depth_file, depth_maps, normal_file, read_planes, sgm_depth_maps
from colmap_ihe.dense.fusion import fuse
from colmap_ihe.dense.ply import read_ply
from colmap_ihe.dense.undistort import undistort
from colmap_ihe.evaluation.demo.scene import portico
from colmap_ihe.evaluation.demo.shapes import Rect
from colmap_ihe.evaluation.depth_errors import depth_errors, pooled, true_pixels
from colmap_ihe.evaluation.truth import Truth, key_of, pose_errors, read_truth
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import FitOptions

WITHIN_PERCENT = (0.1, 0.5)
SAMPLES = 1_000_000
UPWARD = 2  # the axis of floors, treads and undersides
WALL_M2, WALL_POINTS = 1.0, 2000  # smaller walls and those that hardly show are not judged
METHODS = {
    "project": None,
    "ihe": FitOptions(),
    "paper": FitOptions(guard="none"),
    "rec709": FitOptions(method="rec709"),
    "green": FitOptions(method="green"),
}
Points = NDArray[np.float32]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("project", type=Path)
    parser.add_argument("--truth", type=Path, help="a folder of truth, as the demo writes it")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--json", action="store_true", help="print the table as JSON")
    parsed = parser.parse_args()
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    project = Project.at(parsed.project)
    truth = read_truth(parsed.truth) if parsed.truth else None
    columns: dict[str, dict[str, str]] = {}
    for method in parsed.methods:
        with tempfile.TemporaryDirectory() as temporary:
            weights, dense = _dense(project, METHODS[method], Path(temporary))
            columns[method] = {"weights": weights, **_of_maps(dense)}
            if truth is not None:
                columns[method] |= _against_truth(dense, truth)
    if parsed.json:
        print(json.dumps(columns, indent=2))
        return
    rows = [(row, *(found[row] for found in columns.values())) for row in columns[parsed.methods[0]]]
    print_table("", rows, ("", *columns))


def _dense(project: Project, fit: FitOptions | None, work: Path) -> tuple[str, Path]:
    """Return the weights of a grey and its dense workspace, made in `work`; without `fit` the project's own."""
    if fit is None:
        record = json.loads((project.records / "fit.json").read_text(encoding="utf-8"))
        (fitted,) = record["weights"].values()
        return _shown(fitted["weights"]), project.dense
    grey, dense = work / "grey", work / "dense"
    weights, *_ = convert_folder(project.images, grey, fit=fit)
    undistort(project.sparse / "0", grey, project.colour, dense, max_image_size=1600)
    sgm_depth_maps(dense)
    fuse(dense)
    return _shown((weights.red, weights.green, weights.blue)), dense  # type: ignore[union-attr]


def _shown(weights: Sequence[float]) -> str:
    return " ".join(f"{weight:.2f}" for weight in weights)


def _of_maps(dense: Path) -> dict[str, str]:
    share = np.mean([np.mean(depths.read() > 0) for depths in depth_maps(dense)])
    points = len(read_ply(dense / "fused.ply")["vertex"])
    return {"pixels with depth": f"{100 * share:.1f} %", "fused points": f"{points:,}"}


def _against_truth(dense: Path, truth: Truth) -> dict[str, str]:
    model = pycolmap.Reconstruction(dense / "sparse")
    images = [model.images[i] for i in model.reg_image_ids()]
    similarity = pose_errors({i.name: i.cam_from_world().matrix() for i in images}, truth).world_from_model
    depth = pooled(
        depth_errors(
            read_planes(depth_file(dense, image.name))[0],
            model.cameras[image.camera_id].calibration_matrix(),
            truth.images[key_of(image.name)],
            similarity.scale,
        )
        for image in images
    )
    edges = pooled_edges(
        edge_errors(
            read_planes(depth_file(dense, image.name))[0],
            read_planes(normal_file(dense, image.name)).transpose(1, 2, 0),
            model.cameras[image.camera_id].calibration_matrix(),
            truth.images[key_of(image.name)],
            similarity.scale,
        )
        for image in images
    )
    in_sky = [_depth_and_sky(dense, image.name, model.cameras[image.camera_id], truth) for image in images]
    with_depth, sky = np.sum(in_sky, axis=0)
    rows = read_ply(dense / "fused.ply")["vertex"]
    cloud = moved(np.stack([rows[axis] for axis in "xyz"], axis=1), similarity)
    before = np.sum([before_sky(cloud, image) for image in truth.images.values()], axis=0)
    true = np.concatenate([true_points(image, step=2) for image in truth.images.values()])
    draw = np.random.default_rng(0)
    some = [
        points[draw.choice(len(points), min(SAMPLES, len(points)), replace=False)] for points in (cloud, true)
    ]
    accuracy = surface_errors(some[0], true).accuracy
    completeness = surface_errors(cloud, some[1]).completeness
    found = {"depth, median error": f"{depth.median_percent:.3f} %"}
    for where, judged in (("all pixels", depth.all), ("0 to 4 px from edges", depth.near_edges)):
        found[f"right, wrong depths: {where}"] = f"{judged.right_percent:.1f}, {judged.wrong_percent:.1f} %"
    found |= _at_edges(edges)
    found["depths in the sky"] = f"{100 * sky / with_depth:.3f} %"
    of_one, of_three = (100 * float(np.mean(before >= views)) for views in (1, 3))
    found["points before the sky of one, of three photographs"] = f"{of_one:.3f}, {of_three:.3f} %"
    for percent in WITHIN_PERCENT:
        within = percent / 100 * truth.extent_m
        a, c = (100 * float(np.mean(errors <= within)) for errors in (accuracy, completeness))
        found[f"accuracy, completeness, F at {percent} %"] = f"{a:.1f}, {c:.1f}, {2 * a * c / (a + c):.1f} %"
    flat = dict(_flat(cloud, truth.extent_m))
    walls = 100 / truth.extent_m * np.array([away for wall, away in flat.items() if wall.axis != UPWARD])
    surfaces = 100 / truth.extent_m * np.array(list(flat.values()))
    found["walls, worst of how many"] = f"{np.median(walls):.4f}, {walls.max():.4f} % of {len(walls)}"
    found["flat surfaces, worst of how many"] = (
        f"{np.median(surfaces):.4f}, {surfaces.max():.4f} % of {len(surfaces)}"
    )
    return found


def _at_edges(edges: EdgeErrors) -> dict[str, str]:
    return {
        "far side of edges: with depth": f"{edges.far_side_covered_percent:.1f} %",
        "far side of edges: wrong, median error": f"{edges.far_side_wrong_percent:.1f} %,"
        f" {edges.far_side_median_percent:+.3f} %",
        "normals 2 to 6 px from edges: off by over 10 degrees": f"{edges.normals_near_wrong_percent:.1f} %",
        "normals elsewhere, median": f"{edges.normals_elsewhere_median_deg:.2f} degrees",
    }


def _depth_and_sky(dense: Path, name: str, camera: pycolmap.Camera, truth: Truth) -> tuple[int, int]:
    """Return how many pixels of an image have a depth, and how many of them see the sky."""
    held = read_planes(depth_file(dense, name))[0] > 0
    true = truth.images[key_of(name)]
    rows, columns, _ = true_pixels(held.shape, camera.calibration_matrix(), true)
    return int(held.sum()), int((held & (true.depth_m()[rows, columns] <= 0)).sum())


def _flat(cloud: Points, extent_m: float) -> Iterator[tuple[Rect, float]]:
    """Return, for the flat surfaces of the demo, the median distance in metres of their points from the plane that
    fits them best."""
    for patch in portico():
        wall = patch.shape
        if not isinstance(wall, Rect) or wall.disc or np.prod(wall.size_m) < WALL_M2:
            continue
        low, high = wall.box
        margin = np.full(3, -0.05)  # beside an edge other things begin
        margin[wall.axis] = 0.005 * extent_m
        points = cloud[((cloud > low - margin) & (cloud < high + margin)).all(axis=1)].astype(np.float64)
        if len(points) < WALL_POINTS:
            continue
        for _ in range(5):  # least squares of those nearest, again and again
            middle = points.mean(axis=0)
            normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
            away = np.abs((points - middle) @ normal)
            points = points[away <= 3 * 1.4826 * np.median(away)]
        yield wall, float(np.median(away))


if __name__ == "__main__":
    main()
