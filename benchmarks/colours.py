"""Measure what the second grey brings on paintings that the first does not see.

    python benchmarks/colours.py demo PROJECT
    python benchmarks/colours.py loss [FOLDER ...]

"demo" takes a project that `colmap-ihe demo` made, and its cameras for both rows: the share of the pixels of each
painted panel with a depth within 0.5 % of the truth, over all photographs; of all pixels that see the scene those
within 0.2 %, and of the depths those that are wrong by over 1 % away from edges; how much of the true surface is within
0.2 % of the scene's extent of the fused cloud; and COLMAP's features within the panels, beside those of each channel
alone. "loss" prints of folders of photographs what share of the places with detail COLMAP's grey and the fitted one
lose.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from surface_errors import moved, surface_errors, true_points

from colmap_ihe import convert_folder
from colmap_ihe.colmap.native import pycolmap, quiet
from colmap_ihe.colmap.two_views import features_of
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.dense.depth_maps import depth_file, read_planes, sgm_depth_maps
from colmap_ihe.dense.fusion import fuse
from colmap_ihe.dense.ply import read_ply
from colmap_ihe.dense.second_grey import add_second_grey
from colmap_ihe.dense.undistort import read_colour, read_grey, undistort
from colmap_ihe.evaluation.demo.paintings import PANELS, painted_depth_percent, panel_pixels
from colmap_ihe.evaluation.depth_errors import true_pixels
from colmap_ihe.evaluation.truth import Truth, key_of, pose_errors, read_truth
from colmap_ihe.grey.second import SecondGrey
from colmap_ihe.grey.second_fit import blocks_of, fit_second
from colmap_ihe.machine.files import read_json
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.pipeline.second_grey import second_of
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import FitOptions

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SETS = [DATA / name for name in ("sceaux", "fountain-p11", "sacre-coeur")]
WITHIN_PERCENT = 0.2
SAMPLES = 1_000_000
U8 = NDArray[np.uint8]


def demo(project: Project) -> None:
    record = read_json(project.records / "convert.json")
    assert record is not None
    second = second_of({"convert": record})
    truth = read_truth(project.root / "truth")
    assert second is not None
    columns: dict[str, dict[str, str]] = {}
    for name, grey in (("one grey", None), ("with the second", second)):
        with tempfile.TemporaryDirectory() as temporary:
            columns[name] = of_dense(project, Path(temporary), grey, truth)
    print_table(
        "", [(row, *(c[row] for c in columns.values())) for row in columns["one grey"]], ("", *columns)
    )
    features(project, truth)


def of_dense(project: Project, dense: Path, second: SecondGrey | None, truth: Truth) -> dict[str, str]:
    undistort(project.sparse / "0", project.grey, project.colour, dense)
    began = time.process_time()
    if second is not None:
        add_second_grey(dense, second, SILENT)
    sgm_depth_maps(dense)
    seconds = time.process_time() - began
    fuse(dense)
    model = pycolmap.Reconstruction(dense / "sparse")
    images = [model.images[i] for i in model.reg_image_ids()]
    similarity = pose_errors({i.name: i.cam_from_world().matrix() for i in images}, truth).world_from_model
    maps = [
        (
            np.asarray(read_planes(depth_file(dense, image.name))[0]),
            model.cameras[image.camera_id].calibration_matrix(),
            truth.images[key_of(image.name)],
        )
        for image in images
    ]
    painted = painted_depth_percent(maps, similarity.scale)
    seen = near = depths = wrong = 0
    for depth, calibration, true_image in maps:
        rows, columns, inside = true_pixels(depth.shape, calibration, true_image)
        true = true_image.depth_m()[rows, columns]
        scene, held = inside & (true > 0), depth > 0
        error = np.abs(depth * similarity.scale / np.where(scene, true, 1) - 1)
        seen += int(scene.sum())
        near += int((scene & held & (error <= 0.002)).sum())
        depths += int((scene & held).sum())
        wrong += int((scene & held & (error > 0.01)).sum())
    rows_of = read_cloud(dense)
    true_surface = np.concatenate([true_points(image, step=2) for image in truth.images.values()])
    some = true_surface[np.random.default_rng(0).choice(len(true_surface), SAMPLES, replace=False)]
    away = surface_errors(moved(rows_of, similarity), some).completeness
    complete = 100 * float(np.mean(away <= WITHIN_PERCENT / 100 * truth.extent_m))
    return {
        **{f"{name}: depth within 0.5 %, of its pixels": f"{share:.1f} %" for name, share in painted.items()},
        "depth within 0.2 %, of all pixels": f"{100 * near / seen:.2f} %",
        "wrong by over 1 %, of all depths": f"{100 * wrong / depths:.2f} %",
        "surface within 0.2 % of the extent of a point": f"{complete:.2f} %",
        "core seconds of depth maps": f"{seconds:.1f}",
    }


def read_cloud(dense: Path) -> NDArray[np.float32]:
    rows = read_ply(dense / "fused.ply")["vertex"]
    return np.stack([rows[axis] for axis in "xyz"], axis=1)


def features(project: Project, truth: Truth) -> None:
    """Count features within the panels, over all photographs."""
    names = sorted(p.name for p in project.grey.iterdir())
    counts: dict[str, Mapping[str, int]] = {"project's": in_panels(project, truth)}
    pictures: dict[str, Callable[[U8, U8], U8]] = {
        "first grey": lambda grey, _: grey,
        "red": lambda _, colour: colour[..., 0],
        "green": lambda _, colour: colour[..., 1],
        "blue": lambda _, colour: colour[..., 2],
    }
    for label, make in pictures.items():
        total = dict.fromkeys(PANELS, 0)
        for name in names:
            picture = make(read_grey(project.grey / name), read_colour(project.colour / name))
            places = features_of([np.ascontiguousarray(picture)])[0].places
            for panel, count in counted(places, truth, name).items():
                total[panel] += count
        counts[label] = total
    rows = [(label, *(str(c[p]) for p in PANELS)) for label, c in counts.items()]
    print_table("features", rows, ("", *PANELS))


def in_panels(project: Project, truth: Truth) -> dict[str, int]:
    total = dict.fromkeys(PANELS, 0)
    with pycolmap.Database.open(project.database) as opened:
        for image in opened.read_all_images():
            places = np.asarray(opened.read_keypoints(image.image_id))[:, :2]
            for panel, count in counted(places, truth, image.name).items():
                total[panel] += count
    return total


def counted(places: NDArray[np.floating], truth: Truth, name: str) -> dict[str, int]:
    pixels = panel_pixels(truth.images[key_of(name)])
    height, width = next(iter(pixels.values())).shape
    columns, rows = (np.clip(places[:, k].astype(int), 0, n - 1) for k, n in ((0, width), (1, height)))
    return {panel: int(seen[rows, columns].sum()) for panel, seen in pixels.items()}


def loss(folders: list[Path]) -> None:
    rows = []
    for folder in folders:
        for method in ("rec709", "ihe"):
            with tempfile.TemporaryDirectory() as temporary:
                grey, colour = Path(temporary) / "grey", Path(temporary) / "colour"
                convert_folder(folder, grey, fit=FitOptions(method=method), colour=colour)
                names = sorted(p.relative_to(grey).as_posix() for p in grey.rglob("*.png"))
                blocks = [blocks_of(read_grey(grey / n), read_colour(colour / n)) for n in names]
                fit = fit_second(blocks)
                second = fit.second
                direction = (
                    "" if second is None else f"{second.red:+.2f} {second.green:+.2f} {second.blue:+.2f}"
                )
                worst = f"{100 * max(fit.by_photograph):.2f}"
                rows.append((folder.name, method, f"{100 * fit.lost:.2f}", worst, direction))
                shutil.rmtree(grey)
    print_table("", rows, ("set", "grey", "lost, %", "of the worst photograph", "second"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="part", required=True)
    commands.add_parser("demo").add_argument("project", type=Path)
    commands.add_parser("loss").add_argument("folders", type=Path, nargs="*", default=SETS)
    parsed = parser.parse_args()
    with quiet():
        if parsed.part == "demo":
            demo(Project.at(parsed.project))
        else:
            loss(parsed.folders)


if __name__ == "__main__":
    main()
