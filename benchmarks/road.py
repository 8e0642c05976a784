"""Reconstruct simulated RAW, beside what other programs would give COLMAP of the same shots.

    python benchmarks/road.py [demo] [fountain-p11] [--iso 400 1600] [--seeds 3] [--work DIR]

The demo scene, and fountain-p11 at half size, all photographs, as RAW with photon and read noise (see
guard_sets.py). Side by side:
`raw`, the RAW files and our defaults; `jpeg`, the JPEGs that a camera would make of them (LibRaw's camera white
balance, sRGB, gamma, AHD, quality 95) and our defaults; `usual`, the same development without the loss of JPEG, and
COLMAP's grey, Rec.709. Verified matches are summed over all pairs; position errors are against the truth, which
the demo has exactly. That of fountain-p11 was surveyed: with its calibration held, the photographs themselves,
without any noise of ours, come no nearer to it than 2.6 mm. Mean and deviation over seeds of noise and mapper; the
ratio is of the same noise.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rawpy
from guard_sets import DATA, GAINS, expose, linear_of, read_rgb
from numpy.typing import NDArray
from PIL import Image

import colmap_ihe  # noqa: F401  before pycolmap
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.evaluation.demo.raycast import bake, render
from colmap_ihe.evaluation.demo.scene import portico
from colmap_ihe.evaluation.demo.views import FOCAL_LENGTH_35MM, arc_of_views
from colmap_ihe.evaluation.truth import TrueImage, Truth, pose_errors, read_truth
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
from colmap_ihe.project.options_file import load_options

VARIANTS = {"raw": "ihe", "jpeg": "ihe", "usual": "rec709"}
COLUMNS = ("set", "ISO", "variant", "registered", "verified matches", "to usual", "position mm", "error px")


@dataclass(frozen=True)
class Scenes:
    """Hold linear colours by name, 1 is white; the 35 mm equivalent focal length; where the truth is."""

    linear: Mapping[str, NDArray[np.float32]]
    focal_35mm: int
    truth: Truth


def fountain() -> Scenes:
    folder = DATA / "fountain-p11"
    linear = {
        file.stem: np.asarray(
            cv2.resize(linear_of(read_rgb(file)), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA),
            np.float32,
        )
        for file in sorted(folder.glob("*.jpg"))
    }
    return Scenes(linear, 35, read_truth(folder / "gt"))


def demo() -> Scenes:
    views = arc_of_views(14, (1504, 1000))
    with ThreadPoolExecutor(local_workers()) as pool:
        surfaces = bake(portico(), 0.0075, 0, pool)
        pictures = pool.map(lambda view: render(surfaces, view).radiance * np.float32(view.exposure), views)
        linear = {view.stem: picture for view, picture in zip(views, pictures, strict=True)}
    truth = {v.stem: TrueImage(v.width, v.height, v.calibration, v.cam_from_world) for v in views}
    return Scenes(linear, FOCAL_LENGTH_35MM, Truth(truth, extent_m=1.0))


SETS: Mapping[str, Callable[[], Scenes]] = {"demo": demo, "fountain-p11": fountain}


def simulate(scenes: Scenes, folder: Path, iso: int) -> None:
    """Write the three kinds of photographs, each in its folder, with the same EXIF."""
    white = np.float32(np.percentile(np.stack([s[::4, ::4] for s in scenes.linear.values()]), 99.8))
    lit = [scene / white for scene in scenes.linear.values()]
    files = expose(lit, folder / "shots", GAINS["a"], iso, focal_35mm=scenes.focal_35mm).mosaics
    for kind in VARIANTS:
        (folder / kind).mkdir()
    for file, name in zip(files, scenes.linear, strict=True):
        file.rename(folder / "raw" / f"{name}.dng")
        with rawpy.imread(str(folder / "raw" / f"{name}.dng")) as raw:
            rgb = raw.postprocess(use_camera_wb=True, no_auto_bright=True, output_bps=8)
        exif = Image.Exif()
        exif[0x010F], exif[0x0110] = "colmap-ihe", "Demo camera"
        exif.get_ifd(0x8769).update({0x920A: 30.0, 0xA405: scenes.focal_35mm})
        image = Image.fromarray(rgb)
        image.save(folder / "jpeg" / f"{name}.jpg", quality=95, exif=exif.tobytes())
        image.save(folder / "usual" / f"{name}.tif", exif=exif)


def position_mm(done: Reconstruction, truth: Truth) -> float:
    model = pycolmap.Reconstruction(done.sparse_model)
    poses = {model.images[i].name: model.images[i].cam_from_world().matrix() for i in model.reg_image_ids()}
    errors = pose_errors(poses, truth)
    return 1000 * errors.position_error_m


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="*", default=list(SETS), metavar="SET")
    parser.add_argument("--iso", type=int, nargs="+", default=[400, 1600])
    parser.add_argument("--seeds", type=int, default=3, help="of the noise and of the mapper")
    parser.add_argument("--work", type=Path, help="where the projects go; a temporary folder if not given")
    parsed = parser.parse_args()
    rows: list[tuple[str, ...]] = []
    with tempfile.TemporaryDirectory() as temporary:
        for name in parsed.sets:
            scenes = SETS[name]()
            for iso in parsed.iso:
                found: dict[str, list[tuple[float, ...]]] = {kind: [] for kind in VARIANTS}
                for seed in range(parsed.seeds):
                    work = (parsed.work or Path(temporary)) / f"{name}-{iso}-{seed}"
                    shutil.rmtree(work, ignore_errors=True)
                    simulate(scenes, work, iso + seed)  # next to the same ISO, and other noise
                    for kind, method in VARIANTS.items():
                        found[kind].append(measured(scenes, work, kind, method, seed))
                        print(name, iso, seed, kind, *found[kind][-1], sep=" | ", flush=True)
                rows += table_of(name, iso, len(scenes.linear), found)
                print_table("", rows, COLUMNS)


def measured(scenes: Scenes, work: Path, kind: str, method: str, seed: int) -> tuple[float, ...]:
    """Return registered images, verified matches, mean position error in millimetres, reprojection error in pixels."""
    options = load_options(None, [f"fit.method={method}", f"sparse.seed={seed}", "dense.enabled=false"])
    done = reconstruct(work / f"{kind}-project", options, images=work / kind)
    record = json.loads((done.project.records / "matches.json").read_text())
    summary = done.summary
    return (
        summary["registered_images"],
        record["inliers"],
        position_mm(done, scenes.truth),
        summary["mean_reprojection_error_px"],
    )


def table_of(
    name: str, iso: int, images: int, found: dict[str, list[tuple[float, ...]]]
) -> list[tuple[str, ...]]:
    usual = np.array(found["usual"])
    rows: list[tuple[str, ...]] = []
    for kind, values in found.items():
        one = np.array(values)
        ratio = 100 * (one[:, 1] / usual[:, 1] - 1)
        rows.append(
            (
                name,
                str(iso),
                kind,
                f"{one[:, 0].min():.0f} of {images}",
                f"{one[:, 1].mean():,.0f}",
                f"{ratio.mean():+.1f} +- {ratio.std():.1f} %",
                f"{one[:, 2].mean():.2f} +- {one[:, 2].std():.2f}",
                f"{one[:, 3].mean():.3f}",
            )
        )
    return rows


if __name__ == "__main__":
    main()
