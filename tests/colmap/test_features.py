"""Cameras and features in the database: counted, the same from workers elsewhere, and with which camera model."""

from __future__ import annotations

from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from grey_noise import WHOLE, noise

from colmap_ihe.colmap.features import FeatureCounts, extract_features
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.project.options import CameraOptions, FeaturesOptions


def extracted(
    root: Path, names: list[str], executor: Executor, camera: CameraOptions
) -> tuple[FeatureCounts, dict[str, int]]:
    """Extract features below `root`; return their counts and the camera ids by name."""
    database = root / "database.db"
    database.unlink(missing_ok=True)
    counts = extract_features(
        database, root / "grey", names, None, camera, FeaturesOptions(), root, executor, SILENT
    )
    with pycolmap.Database.open(database) as opened:
        return counts, {str(image.name): image.camera_id for image in opened.read_all_images()}


def test_cameras_are_shared_and_counted_the_same_on_workers_elsewhere(tmp_path: Path) -> None:
    names = [noise(tmp_path / "grey", f"scan-{n}.png") for n in range(3)]
    names += [noise(tmp_path / "grey", f"photograph-{n}.png", **WHOLE, f35=50) for n in range(2)]
    names += [noise(tmp_path / "grey", "upright.png", (66, 90))]
    with ThreadPoolExecutor(1) as threads:
        counts, cameras = extracted(tmp_path, names, threads, CameraOptions())
        assert (counts.images, counts.cameras, counts.with_focal_prior) == (6, 3, 2)
        assert counts.assumed == (3,)
        assert [cameras[name] for name in names] == [2, 2, 2, 1, 1, 3]
        each, _ = extracted(tmp_path, names, threads, CameraOptions(mode="per_image"))
        assert (each.cameras, each.assumed) == (6, ())
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as processes:
        assert extracted(tmp_path, names, processes, CameraOptions()) == (counts, cameras)
