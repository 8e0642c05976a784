"""Measure dense stereo on the CPU: coverage, error at the sparse points, cloud, time, memory.

    python benchmarks/dense.py ../shared/data/fountain-p11 --scale 0.5
    python benchmarks/dense.py ../shared/data/fountain-p11
    python benchmarks/dense.py ../shared/data/sceaux --max-image-size 1600

Sparse reconstruction (features, exhaustive matches, mapping) runs first, with the K.txt of the data set as the
prior: what dense costs is told in its core-seconds too. "Error" is the median difference between depth map and
sparse points seen by three images or more; it is no truth, but independent of the dense part. Memory is the
highest that the process came to in each part.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from colmap_ihe.colmap.measures import images_seeing
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.dense.depth_maps import sgm_depth_maps
from colmap_ihe.dense.fusion import fuse
from colmap_ihe.dense.undistort import undistort

BASE = "sparse"
REC709 = np.array([0.2126, 0.7152, 0.0722])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("photographs", type=Path)
    parser.add_argument("--scale", type=float, default=1.0, help="of the photographs, before anything else")
    parser.add_argument("--max-image-size", type=int, default=-1, help="of the undistorted images")
    parser.add_argument("--sources", type=int, default=5, help="matched with each image")
    parser.add_argument("--work", type=Path, help="kept, and its sparse model used again")
    parser.add_argument("--json", action="store_true", help="print the table as JSON")
    arguments = parser.parse_args()
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    with tempfile.TemporaryDirectory() as temporary:
        work = arguments.work or Path(temporary)
        rows = [(BASE, *_timed(lambda: _sparse(arguments.photographs, work, arguments.scale)))]
        folder = work / "dense"
        model, grey, colour = work / "sparse" / "0", work / "grey", work / "colour"
        size = arguments.max_image_size
        rows += [
            ("undistort", *_timed(lambda: undistort(model, grey, colour, folder, max_image_size=size))),
            (
                "depth maps",
                *_timed(lambda: sgm_depth_maps(folder, sources_per_image=arguments.sources)),
            ),
            ("fuse", *_timed(lambda: fuse(folder))),
        ]
        _print_table(rows, folder, arguments.json)


def _sparse(photographs: Path, work: Path, scale: float) -> int:
    """Make grey and colour copies in `work`, and a model of them; nothing if they are there."""
    if (work / "sparse" / "0").is_dir():
        return 0
    names = []
    for path in sorted(photographs.glob("*.[jJ][pP][gG]")):
        pixels = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is None:
            raise SystemExit(f"{path} cannot be read")
        rgb = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)[..., ::-1]
        names.append(f"{path.stem}.png")
        for folder, values in (("grey", rgb @ REC709), ("colour", rgb)):
            (work / folder).mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.round(values).astype(np.uint8)).save(work / folder / names[-1])
    K = np.array((photographs / "K.txt").read_text().split()[:9], float).reshape(3, 3)
    reader = pycolmap.ImageReaderOptions(camera_model="RADIAL")
    focal, cx, cy = scale * (K[0, 0] + K[1, 1]) / 2, scale * (K[0, 2] + 0.5), scale * (K[1, 2] + 0.5)
    reader.camera_params = f"{focal},{cx},{cy},0,0"
    database = work / "database.db"
    single = pycolmap.CameraMode.SINGLE
    pycolmap.extract_features(database, work / "grey", names, camera_mode=single, reader_options=reader)
    pycolmap.match_exhaustive(database)
    (work / "sparse").mkdir()
    return len(pycolmap.incremental_mapping(database, work / "grey", work / "sparse"))


def _timed(call: Callable[[], Any]) -> tuple[Any, float, float, float]:
    """Return what `call` returns, its seconds, its core-seconds, and the most memory in GB."""
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # the highest begins again
    wall, cores = time.perf_counter(), time.process_time()
    result = call()
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = int(status.partition("VmHWM:")[2].split()[0]) / 1e6
    return result, time.perf_counter() - wall, time.process_time() - cores, peak


def _errors(folder: Path) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return relative depth differences at the sparse points of all images."""
    model = pycolmap.Reconstruction(folder / "sparse")
    errors = []
    for image in model.images.values():
        written = pycolmap.DepthMap()
        written.read(folder / "stereo" / "depth_maps" / f"{image.name}.geometric.bin")
        depth = written.to_array()
        pose = image.cam_from_world().matrix()
        for seen in image.get_observation_points2D():
            point = model.points3D[seen.point3D_id]
            column, row = (seen.xy - 0.01).astype(int)
            found = depth[min(row, depth.shape[0] - 1), min(column, depth.shape[1] - 1)]
            if found > 0 and images_seeing(point) >= 3:
                errors.append(abs(found / (pose[2, :3] @ point.xyz + pose[2, 3]) - 1))
    return np.array(errors)


def _print_table(rows: list[tuple[str, Any, float, float, float]], folder: Path, as_json: bool) -> None:
    results = {name: result for name, result, *_ in rows}
    counts = results["depth maps"]
    errors = 100 * _errors(folder)
    cores = {name: core for name, _, _, core, _ in rows}
    megapixels = counts.pixels_with_depth / 1e6
    base = cores.pop(BASE)
    lines = [
        (
            "images, pairs used, left out",
            f"{counts.images}, {counts.pairs_used}, {len(counts.pairs_left_out)}",
        ),
        ("pixels with depth", f"{100 * counts.pixels_with_depth / counts.pixels:.1f} %"),
        ("error at sparse points, median", f"{np.median(errors):.4f} %"),
        ("error at sparse points, 90 %", f"{np.percentile(errors, 90):.3f} %"),
        ("fused points", f"{results['fuse']:,}"),
        ("megapixels of depth per core-second", f"{megapixels / cores['depth maps']:.3f}"),
        ("core-seconds, of those of sparse", f"{sum(cores.values()):.0f}, {sum(cores.values()) / base:.2f}"),
    ]
    lines += [
        (f"{name}: seconds, core-seconds, peak memory", f"{wall:.1f}, {core:.1f}, {peak:.2f} GB")
        for name, _, wall, core, peak in rows
    ]
    if as_json:
        print(json.dumps(dict(lines), indent=2))
        return
    print("| measure | value |\n|---|---|")
    for name, value in lines:
        print(f"| {name} | {value} |")


if __name__ == "__main__":
    main()
