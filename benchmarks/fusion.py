"""Measure the memory and time of fusion as a set grows: the images of a dense workspace, each several times over.

    python benchmarks/dense.py ../shared/data/fountain-p11 --scale 0.5 --work WORK
    python benchmarks/fusion.py WORK/dense [--times 1 2 4 8] [--most-gb 1.6]

The copies stand where their originals do, so that all the images see one place: the hardest case for memory. "At
once" is fusion in one piece. Peaks are what a process of its own came to.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table
from colmap_ihe.dense.fusion import FUSION_BYTES, fuse
from colmap_ihe.machine.progress import Silent

_FOLDERS = ("images", "stereo/depth_maps", "stereo/normal_maps")


def multiplied(dense: Path, out: Path, times: int) -> None:
    """Make a workspace in which every image of `dense` is there `times`, as a link."""
    source, model = pycolmap.Reconstruction(dense / "sparse"), pycolmap.Reconstruction()
    tracks: dict[int, pycolmap.Track] = {}
    ids = list(source.reg_image_ids())
    for camera in source.cameras.values():
        model.add_camera_with_trivial_rig(pycolmap.Camera(camera.todict()))
    names = []
    for copy in range(times):
        for place, image_id in enumerate(ids):
            image = source.images[image_id]
            seen = image.get_observation_points2D()
            new_id, name = copy * len(ids) + place + 1, f"{copy}-{image.name}"
            pixels = np.array([point.xy for point in seen]).reshape(-1, 2)
            added = pycolmap.Image(name=name, keypoints=pixels, camera_id=image.camera_id, image_id=new_id)
            model.add_image_with_trivial_frame(added, image.cam_from_world())
            for index, point in enumerate(seen):
                tracks.setdefault(point.point3D_id, pycolmap.Track()).add_element(new_id, index)
            names.append(name)
            for folder in _FOLDERS:
                suffix = "" if folder == "images" else ".geometric.bin"
                (out / folder).mkdir(parents=True, exist_ok=True)
                os.link(dense / folder / f"{image.name}{suffix}", out / folder / f"{name}{suffix}")
    for point_id, track in tracks.items():
        model.add_point3D(source.points3D[point_id].xyz, track, np.zeros(3, np.uint8))
    (out / "sparse").mkdir()
    model.write(out / "sparse")
    (out / "stereo" / "fusion.cfg").write_text("".join(f"{name}\n" for name in names))


class Cells(Silent):
    count = 0

    def start(self, total: int, unit: str = "images") -> None:
        self.count = total


def one(dense: Path, most_bytes: float) -> None:
    """Fuse, and print time and memory."""
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    progress, began = Cells(), time.perf_counter()
    points = fuse(dense, most_bytes=int(most_bytes), progress=progress)
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = int(status.partition("VmHWM:")[2].split()[0]) / 1e6
    print(json.dumps([progress.count, points, time.perf_counter() - began, peak]))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dense", type=Path)
    parser.add_argument("--times", type=int, nargs="+", default=[1, 2, 4, 8])
    parser.add_argument("--most-gb", type=float, default=FUSION_BYTES / 1e9)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    parsed = parser.parse_args()
    if parsed.one:
        one(parsed.dense, parsed.most_gb * 1e9)
        return
    rows = []
    for times in parsed.times:
        with tempfile.TemporaryDirectory(dir=parsed.dense.parent) as temporary:
            multiplied(parsed.dense, Path(temporary), times)
            images = len(list((Path(temporary) / "images").iterdir()))
            for most_gb, words in ((parsed.most_gb, "in cells"), (1e6, "at once")):
                call = [sys.executable, __file__, temporary, "--one", "--most-gb", str(most_gb)]
                done = subprocess.run(call, stdout=subprocess.PIPE, check=True, text=True)
                cells, points, seconds, peak = json.loads(done.stdout.splitlines()[-1])
                rows.append(
                    (str(images), words, str(cells), f"{points:,}", f"{seconds:.0f} s", f"{peak:.2f} GB")
                )
                print_table("", rows, ("images", "", "cells", "points", "time", "peak"))


if __name__ == "__main__":
    main()
