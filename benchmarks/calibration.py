"""Compare COLMAP's cameras with calibrated ones: position errors, models chosen, deviations, time; side by side.

    python benchmarks/calibration.py [sets] [photographs] [--images 4 10 20] [--seeds 1] [--first 0] [--no-prior]

`sets` simulates lenses (lens_sets.py) before a facade, a courtyard and an object, and maps each set once with
`sparse.calibration: colmap` and once with `auto`: mean position error after a similarity, the camera model, and whether
two standard deviations about focal length and principal point hold the truth. A model is right if it can show the true
lens to a tenth of a pixel over the picture, and has no more coefficients than that lens. `photographs` maps
fountain-p11, whose poses are known, at 1,600 and 640 pixels, sceaux and sacre-coeur with COLMAP's own grey, features
and matches, three times each, with the time of features and matches, and of mapping with the calibration. All is
printed as JSON too.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from guard_sets import DATA
from lens_kinds import LENSES
from lens_sets import LensSet, position_error_mm, simulate
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.colmap.calibration.calibrate import Calibration, Known
from colmap_ihe.colmap.calibration.freedom import FISHEYE, PERSPECTIVE
from colmap_ihe.colmap.calibration.lens import fitted
from colmap_ihe.colmap.mapping import map_images
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.errors import MappingError
from colmap_ihe.machine import threads
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.project.options import SparseOptions

_SHOWN_PX = 0.1
_SCENES = ("facade", "courtyard", "object")


@dataclass(frozen=True)
class Outcome:
    """Hold a set before and after: errors in millimetres; `within`: of f, cx and cy that are free, whether the truth
    lies within two standard deviations."""

    name: str
    registered: tuple[int, int]
    colmap_mm: float
    calibrated_mm: float
    model: str
    right: bool
    within: tuple[bool, ...]

    @property
    def ratio(self) -> float:
        return self.calibrated_mm / self.colmap_mm


def mapped(
    database: Path, folder: Path, calibration: str, images: int, known: Known
) -> tuple[pycolmap.Reconstruction, Calibration | None]:
    options = SparseOptions.model_validate({"calibration": calibration})
    found = map_images(database, folder, folder / calibration, options, images, SILENT, known=known)
    return pycolmap.Reconstruction(folder / calibration / "0"), found.calibration


def outcome(made: LensSet, folder: Path) -> Outcome | None:
    known = Known(check_shared=True)
    try:
        with threads.limited(1):  # so that both begin with the same model
            before, _ = mapped(made.database, folder, "colmap", made.images, known)
            after, calibration = mapped(made.database, folder, "auto", made.images, known)
    except MappingError:
        return None
    camera = next(iter(after.cameras.values()))
    deviations = calibration.deviations[camera.camera_id].values if calibration else ()
    return Outcome(
        f"{made.scene} {made.lens} {made.images}",
        (before.num_reg_images(), after.num_reg_images()),
        position_error_mm(before, made.poses),
        position_error_mm(after, made.poses),
        camera.model_name,
        is_right(camera, made.truth),
        within_two(camera, deviations, made.truth),
    )


def is_right(camera: pycolmap.Camera, truth: pycolmap.Camera) -> bool:
    """Tell whether a camera's model can show the true lens to a tenth of a pixel, by the root mean square over the
    picture, and has no more coefficients than the true lens or than it takes."""
    ladder = [model for model, _ in (FISHEYE if truth.model_name.endswith("FISHEYE") else PERSPECTIVE)]
    enough = next((n for n, model in enumerate(ladder) if shows(model, n, truth)), len(ladder) - 1)
    own = ladder.index(truth.model_name) if truth.model_name in ladder else 0
    return camera.model_name in ladder[enough : max(enough, own) + 1]


def shows(model: str, step: int, truth: pycolmap.Camera) -> bool:
    coefficients = (FISHEYE if "FISHEYE" in model else PERSPECTIVE)[step][1]
    across, down = (np.linspace(0, side, 25) for side in (truth.width, truth.height))
    pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    rays = np.column_stack([np.asarray(truth.cam_from_img(pixels)), np.ones(len(pixels))])
    shown = np.asarray(fitted(truth, model, coefficients).img_from_cam(rays))
    return float(np.sqrt(np.nanmean(((shown - pixels) ** 2).sum(axis=1)))) < _SHOWN_PX


def within_two(
    camera: pycolmap.Camera, deviations: tuple[float, ...], truth: pycolmap.Camera
) -> tuple[bool, ...]:
    first = camera.focal_length_idxs()[0]
    x, y = camera.principal_point_idxs()
    pairs = (
        (first, camera.mean_focal_length() - truth.mean_focal_length()),
        (x, camera.principal_point_x - truth.principal_point_x),
        (y, camera.principal_point_y - truth.principal_point_y),
    )
    return tuple(abs(error) < 2 * deviations[i] for i, error in pairs if deviations and deviations[i])


def sets(images: list[int], seeds: int, first: int, prior: bool, folder: Path) -> list[Outcome]:
    found = []
    for number, (count, scene, lens, seed) in enumerate(
        (c, s, one, k) for c in images for s in _SCENES for one in LENSES for k in range(seeds)
    ):
        place = folder / f"set-{number}"
        place.mkdir()
        made = simulate(place, scene, lens, count, first + 1000 * seed + number, prior_focal=prior)
        result = outcome(made, place)
        shutil.rmtree(place)
        if result is None:
            print(f"{scene} {lens} {count}: nothing registers")
            continue
        found.append(result)
        print(json.dumps({**asdict(result), "ratio": round(result.ratio, 3)}))
    return found


def summed_up(found: list[Outcome]) -> None:
    measured = [one for one in found if np.isfinite(one.ratio)]
    ratios = [one.ratio for one in measured]
    within = [hit for one in measured for hit in one.within]
    rows = [
        ("sets", f"{len(measured)}"),
        ("mean of calibrated / COLMAP's position error", f"{np.mean(ratios):.3f}"),
        ("geometric mean", f"{np.exp(np.mean(np.log(ratios))):.3f}"),
        ("sets above 1.05", f"{sum(ratio > 1.05 for ratio in ratios)}"),
        ("largest", f"{max(ratios):.2f}, {measured[int(np.argmax(ratios))].name}"),
        ("model right", f"{np.mean([one.right for one in measured]):.3f}"),
        ("truth within two deviations", f"{np.mean(within):.3f} of {len(within)}"),
    ]
    print_table("simulated lenses", rows, ("", ""))


def truth_of(folder: Path) -> dict[str, NDArray[np.float64]]:
    """Return cam_from_world (3, 4) by image name, from the files that fountain-p11 comes with."""
    poses = {}
    for file in sorted((folder / "gt").glob("*.camera")):
        rows = [
            [float(value) for value in line.split()] for line in file.read_text().splitlines() if line.strip()
        ]
        rotation, centre = np.array(rows[4:7]).T, np.array(rows[7])
        poses[file.stem] = np.column_stack([rotation, -rotation @ centre])
    return poses


def prepared(name: str, size: int, folder: Path) -> tuple[Path, int, float]:
    """Return a database of a set's photographs at a size in pixels, their number, and the seconds that features and
    matches took; grey, features and cameras are COLMAP's own, with one camera but for sacre-coeur."""
    images = folder / "images"
    images.mkdir(parents=True)
    files = sorted((DATA / name).glob("*.[jJ][pP][gG]"))
    for file in files:
        with Image.open(file) as picture:
            scale = min(1.0, size / max(picture.size))
            sides = [round(side * scale) for side in picture.size]
            picture.resize(sides, Image.Resampling.LANCZOS).save(images / file.name, quality=95)
    mode = pycolmap.CameraMode.AUTO if name == "sacre-coeur" else pycolmap.CameraMode.SINGLE
    begun = time.perf_counter()
    pycolmap.extract_features(folder / "database.db", images, camera_mode=mode)
    pycolmap.match_exhaustive(folder / "database.db")
    return folder / "database.db", len(files), time.perf_counter() - begun


def photographs(folder: Path) -> None:
    """Print the table of photographs: of each set the three mappings with seeds 0 to 2."""
    rows = []
    for name, size in (
        ("fountain-p11", 1600),
        ("fountain-p11", 640),
        ("sceaux", 1600),
        ("sacre-coeur", 1600),
    ):
        place = folder / f"{name}-{size}"
        database, images, seconds = prepared(name, size, place)
        poses = truth_of(DATA / name) if name == "fountain-p11" else {}
        for calibration in ("colmap", "auto"):
            errors, points, took, model = [], [], [], pycolmap.Reconstruction()
            for seed in range(3):
                options = SparseOptions.model_validate({"calibration": calibration, "seed": seed})
                out = place / f"{calibration}-{seed}"
                begun = time.perf_counter()
                map_images(
                    database, place / "images", out, options, images, SILENT, known=Known(check_shared=True)
                )
                took.append(time.perf_counter() - begun)
                model = pycolmap.Reconstruction(out / "0")
                points.append(model.num_points3D())
                errors.append(position_error_mm(model, poses) if poses else float("nan"))
            rows.append(
                (
                    f"{name}, {size} px",
                    calibration,
                    f"{model.num_reg_images()} of {images}",
                    f"{np.mean(points):,.0f}",
                    f"{model.compute_mean_reprojection_error():.3f}",
                    f"{np.mean(errors):.2f} ({min(errors):.2f} to {max(errors):.2f})" if poses else "-",
                    next(iter(model.cameras.values())).model_name,
                    f"{seconds:.1f}",
                    f"{np.mean(took):.1f}",
                )
            )
            print(json.dumps(rows[-1]))
    columns = (
        "set",
        "cameras",
        "registered",
        "points",
        "error px",
        "position error mm",
        "model",
        "before s",
        "mapping s",
    )
    print_table("photographs, three seeds each", rows, columns)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", default=["photographs", "sets"])
    parser.add_argument("--images", type=int, nargs="+", default=[4, 6, 10, 20])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="seed of the first set")
    parser.add_argument("--no-prior", action="store_true")
    parsed = parser.parse_args()
    parts: dict[str, Callable[[Path], None]] = {
        "photographs": photographs,
        "sets": lambda folder: summed_up(
            sets(parsed.images, parsed.seeds, parsed.first, not parsed.no_prior, folder)
        ),
    }
    for part in parsed.parts:
        with tempfile.TemporaryDirectory() as temporary:
            parts[part](Path(temporary))


if __name__ == "__main__":
    main()
