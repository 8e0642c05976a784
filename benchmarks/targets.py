"""Measure how many coded targets are found, and how near to their true centres.

    python benchmarks/targets.py [--count N] [--demo DIR] [--json]

Rendered targets of AprilTag 36h11, seen at several sizes and angles, then with more blur, noise and less contrast: the
share that is found, RMS and bias of the centre per coordinate, and the deviation that is said of it. The size is the
mean length of a side in the picture. With `--demo`, also on the photographs of the demo in DIR, against its truth: all
targets that nothing hides; and if DIR has been reconstructed, on its grey images, with the points in its model, after a
similarity from all of them.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image
from target_scenes import Sight, target_picture

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.demo.targets import SIDE_M, TARGETS
from colmap_ihe.evaluation.truth import TrueImage, read_truth
from colmap_ihe.survey.target_observations import targets_of_set
from colmap_ihe.survey.targets import Target, find_targets, target_name
from colmap_ihe.survey.triangulate import triangulation

Floats = npt.NDArray[np.float64]
Figures = Mapping[str, float | str]

SIDES_PX, TILTS_DEG = (16, 20, 24, 32, 48, 100), (0, 30, 45, 60)
OTHER_SIGHTS = {
    "sharp": Sight(40, 30, blur_px=0),
    "blur of 1.5 px": Sight(40, 30, blur_px=1.5),
    "blur of 2.5 px": Sight(100, 45, blur_px=2.5),
    "noise of 12 levels": Sight(40, 30, noise=12),
    "contrast of 30 levels": Sight(40, 30, black=90, white=120),
    "70 degrees": Sight(60, 70),
}
_BOARD = 1.35  # sides of the black square that nothing may hide
_WALL = 0.05  # metres that a depth may be off


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=60, help="targets of each kind")
    parser.add_argument("--demo", type=Path, help="a demo with its truth")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parsed = parser.parse_args()
    rows = [rendered(_sight(side, tilt), parsed.count, str(tilt)) for side in SIDES_PX for tilt in TILTS_DEG]
    rows += [rendered(sight, parsed.count, name) for name, sight in OTHER_SIGHTS.items()]
    figures: dict[str, Sequence[Figures]] = {"rendered": rows}
    if parsed.demo:
        figures["demo"] = [in_photographs(parsed.demo)]
        if (parsed.demo / "workspace" / "sparse" / "0").is_dir():
            figures["model of the demo"] = [in_model(parsed.demo)]
    if parsed.json:
        print(json.dumps(figures, indent=2))
        return
    for title, table in figures.items():
        print_table(title, [tuple(map(_word, row.values())) for row in table], tuple(table[0]))


def _sight(side_px: float, tilt_deg: float) -> Sight:
    """A sight whose sides are `side_px` long on average: those that are tilted away are shorter."""
    return Sight(2 * side_px / (1 + np.cos(np.radians(tilt_deg))), tilt_deg)


def rendered(sight: Sight, count: int, name: str) -> Figures:
    """Figures of `count` targets seen in one way."""
    rng = np.random.default_rng(1)
    off, deviations, sides, wrong = [], [], [], 0
    for _ in range(count):
        picture = target_picture(sight, rng)
        sides.append(picture.side_px)
        for target in find_targets(picture.grey):
            if target.name == target_name(picture.number):
                off.append(np.subtract(target.centre_px, picture.centre_px))
                deviations.append(target.deviation_px)
            else:
                wrong += 1
    size: dict[str, float | str] = {"side, px": round(float(np.mean(sides)), 1), "tilt, degrees": name}
    return size | _errors(off, deviations, count, wrong)


def _errors(
    off: Sequence[Floats], deviations: Sequence[float], count: int, wrong: int
) -> dict[str, float | str]:
    errors = np.array(off).reshape(-1, 2)
    bias, rms = errors.mean(axis=0), np.sqrt((errors**2).mean()) if off else np.nan
    return {
        "found, %": round(100 * len(off) / count, 1),
        "wrong": wrong,
        "RMS, px": round(float(rms), 3),
        "bias, px": round(float(np.linalg.norm(bias)), 3) if off else float("nan"),
        "largest, px": round(float(np.abs(errors).max()), 2) if off else float("nan"),
        "said, px": round(float(np.sqrt(np.mean(np.square(deviations)))), 3) if off else float("nan"),
    }


def in_photographs(demo: Path) -> Figures:
    """Figures of the JPEG photographs of a demo."""
    off, deviations, wrong, expected = [], [], 0, 0
    names = {target_name(target.number): target.centre for target in TARGETS}
    for stem, image in read_truth(demo / "truth").images.items():
        visible = {
            name: project(image, centre[None])[0] for name, centre in names.items() if _is_seen(image, centre)
        }
        expected += len(visible)
        grey = np.asarray(Image.open(demo / f"images/{stem}.jpg").convert("L"))
        targets = find_targets(grey)
        wrong += sum(_is_elsewhere(target, image, names) for target in targets)
        for target in targets:
            if target.name in visible:
                off.append(np.subtract(target.centre_px, visible[target.name]))
                deviations.append(target.deviation_px)
    return {"expected": expected} | _errors(off, deviations, expected, wrong)


def _is_elsewhere(target: Target, image: TrueImage, names: Mapping[str, Floats]) -> bool:
    true = names.get(target.name)
    return true is None or bool(np.abs(project(image, true[None])[0] - target.centre_px).max() > 1)


def _is_seen(image: TrueImage, centre: Floats) -> bool:
    """Whether a target and the white around it are in the picture, with nothing before them, larger than 20 px and
    seen at less than 60 degrees."""
    half = SIDE_M * _BOARD / 2
    points = centre + np.array(
        ((0, 0, 0), (-half, 0, -half), (half, 0, -half), (half, 0, half), (-half, 0, half))
    )
    pixels = project(image, points)
    if pixels.min() < 1 or (pixels >= (image.width - 1, image.height - 1)).any():
        return False
    distance = points @ image.cam_from_world[2, :3] + image.cam_from_world[2, 3]
    depth = image.depth_m()[pixels[:, 1].astype(int), pixels[:, 0].astype(int)]
    ray = centre + image.cam_from_world[:, :3].T @ image.cam_from_world[:, 3]
    angle = np.degrees(np.arccos(ray[1] / np.linalg.norm(ray)))
    side = SIDE_M * image.calibration[0, 0] / distance[0] * (1 + np.cos(np.radians(angle))) / 2
    return bool((np.abs(depth - distance) < _WALL).all() and side > 20 and angle < 60)


def project(image: TrueImage, points: Floats) -> Floats:
    """(N, 2): where points (N, 3) of the world are in a picture."""
    pixels = (points @ image.cam_from_world[:, :3].T + image.cam_from_world[:, 3]) @ image.calibration.T
    return np.asarray(pixels[:, :2] / pixels[:, 2:])


def in_model(demo: Path) -> Figures:
    """Figures of the targets in the model of a demo."""
    model = pycolmap.Reconstruction(demo / "workspace" / "sparse" / "0")
    with ThreadPoolExecutor() as executor:
        found = targets_of_set(model, demo / "workspace" / "images", executor)
    located = triangulation(model, found.observations)
    true = np.array([target.centre for target in TARGETS if target_name(target.number) in located.points])
    names = [target_name(target.number) for target in TARGETS if target_name(target.number) in located.points]
    points = np.array([located.points[name].xyz for name in names])
    world_from_model = pycolmap.estimate_sim3d(points, true)
    assert world_from_model is not None
    off = np.array([world_from_model * point for point in points]) - true
    residuals = [point.residuals_px[image] for point in located.points.values() for image in point.used]
    extent_m = read_truth(demo / "truth").extent_m
    deviations = [
        np.sqrt(np.diag(located.points[name].covariance)) * world_from_model.scale for name in names
    ]
    return {
        "sights": len(found.observations),
        "left out": sum(len(point.left_out) for point in located.points.values()),
        "points": len(points),
        "RMS, px": round(float(np.sqrt(np.mean(np.square(residuals)))), 3),
        "RMS, mm": round(1000 * float(np.sqrt((off**2).mean())), 2),
        "said, mm": round(1000 * float(np.sqrt(np.mean(np.square(deviations)))), 2),
        "RMS 3D, % of the extent": round(100 * float(np.sqrt((off**2).sum(axis=1).mean())) / extent_m, 4),
    }


def _word(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"


if __name__ == "__main__":
    main()
