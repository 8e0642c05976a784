"""Make the test sets of `benchmarks/guard.py`: photographs, RAW made from photographs, painted isoluminant pairs.

A set is a few images, the pairs among them that overlap, and what tells a correct match: the true
epipolar geometry, or one estimated from the matches of three greys pooled, the same for every triplet.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rawpy
from numpy.typing import NDArray

from colmap_ihe.evaluation.demo.dng import write_dng
from colmap_ihe.evaluation.demo.exif import PhotoExif
from colmap_ihe.photographs.raw.develop import develop

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FOUNTAIN = ("0004", "0005", "0006")
SCEAUX = ("100_7100", "100_7101", "100_7102")
BLACK, WHITE = 512, 16383
GAINS = {"a": (0.50, 1.00, 0.62), "tungsten": (0.95, 1.00, 0.33), "cloudy": (0.42, 1.00, 0.80)}
FULL_WELL_E = 40_000.0  # at ISO 100
READ_NOISE_E = 5.0

Rgb = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass
class Set:
    """Hold a set. `images`: (H, W, 3), uint8 coded or uint16 linear. `fundamental` or `homography`: by pair, where
    known. `mosaics`: the RAW files of linear images."""

    images: list[Rgb]
    pairs: list[tuple[int, int]]
    fundamental: dict[tuple[int, int], NDArray[np.float64]] = field(default_factory=dict)
    homography: dict[tuple[int, int], NDArray[np.float64]] = field(default_factory=dict)
    mosaics: list[Path] = field(default_factory=list)


def read_rgb(path: Path, shrink: int = 1) -> NDArray[np.uint8]:
    bgr = cv2.imread(str(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if bgr is None:
        raise FileNotFoundError(path)
    if shrink > 1:
        bgr = cv2.resize(bgr, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(bgr[..., ::-1], np.uint8)


def recompress(rgb: NDArray[np.uint8], quality: int, halved_chroma: bool = True) -> NDArray[np.uint8]:
    """Return it as a JPEG of this quality would show it."""
    sampling = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420 if halved_chroma else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling]
    _, coded = cv2.imencode(".jpg", rgb[..., ::-1], options)
    return np.ascontiguousarray(np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR))[..., ::-1], np.uint8)


def fountain_truth(scale: float) -> dict[tuple[int, int], NDArray[np.float64]]:
    cameras = []
    for name in FOUNTAIN:
        rows = (DATA / "fountain-p11" / "gt" / f"{name}.jpg.camera").read_text().splitlines()
        values = [np.array(list(map(float, r.split()))) for r in rows]
        calibration = np.stack(values[:3])
        calibration[:2] *= scale
        cameras.append((calibration, np.stack(values[4:7]).T, values[7]))
    return {(0, 1): epipolar(cameras[0], cameras[1]), (1, 2): epipolar(cameras[1], cameras[2])}


def epipolar(first: Any, second: Any) -> NDArray[np.float64]:
    """Return F with x2' F x1 = 0, from (K, R world to camera, centre) each."""
    (k1, r1, c1), (k2, r2, c2) = first, second
    rotation = r2 @ r1.T
    t = r2 @ (c1 - c2)
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    result: NDArray[np.float64] = np.linalg.inv(k2).T @ cross @ rotation @ np.linalg.inv(k1)
    return result


def originals(name: str, shrink: int) -> list[NDArray[np.uint8]]:
    stems = FOUNTAIN if name == "fountain-p11" else SCEAUX
    suffix = ".jpg" if name == "fountain-p11" else ".JPG"
    return [read_rgb(DATA / name / f"{stem}{suffix}", shrink) for stem in stems]


def photographs(name: str, quality: int | None = None) -> Set:
    """Halve the resolution; with `quality`, compressed again as a camera of that resolution would."""
    images = originals(name, 2)
    if quality is not None:
        images = [recompress(rgb, quality) for rgb in images]
    return Set(list(images), [(0, 1), (1, 2)], fountain_truth(0.5) if name == "fountain-p11" else {})


def crops(name: str, size: tuple[int, int] = (1536, 1024)) -> Set:
    """Cut, at full resolution, where chroma is still subsampled: windows of two images that see the same."""
    whole = originals(name, 1)
    small = [
        np.asarray(cv2.resize(i, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA), np.uint8)
        for i in whole
    ]
    middle = np.array([whole[1].shape[1], whole[1].shape[0]]) / 2
    corners = []
    for n in range(3):
        shift = np.zeros(2) if n == 1 else 4 * _shift(small[1], small[n])
        corner = middle + shift - np.array(size) / 2
        room = np.array([whole[n].shape[1], whole[n].shape[0]]) - size
        corners.append((np.clip(corner, 0, room) / 16).astype(int) * 16)
    images: list[Rgb] = [
        np.ascontiguousarray(i[y : y + size[1], x : x + size[0]])
        for i, (x, y) in zip(whole, corners, strict=True)
    ]
    fundamental = {}
    if name == "fountain-p11":
        moves = [np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]]) for x, y in corners]
        fundamental = {(a, b): moves[b].T @ f @ moves[a] for (a, b), f in fountain_truth(1.0).items()}
    return Set(images, [(0, 1), (1, 2)], fundamental)


def _shift(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the median way from a feature near the middle of the first image to its match in the second."""
    sift = cv2.SIFT.create(3000)
    (k1, d1), (k2, d2) = (
        sift.detectAndCompute(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY), None) for i in (first, second)
    )
    pairs = [m for m, n in cv2.BFMatcher().knnMatch(d1, d2, 2) if m.distance < 0.7 * n.distance]
    a = np.array([k1[m.queryIdx].pt for m in pairs])
    b = np.array([k2[m.trainIdx].pt for m in pairs])
    near = (np.abs(a - np.array(first.shape[1::-1]) / 2) < np.array(first.shape[1::-1]) / 4).all(axis=1)
    return np.asarray(np.median((b - a)[near], axis=0))


def linear_of(coded: NDArray[np.uint8]) -> NDArray[np.float32]:
    share = coded.astype(np.float32) / 255
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4).astype(np.float32)


def developed(path: Path, demosaic: str = "LINEAR") -> NDArray[np.uint16]:
    """Develop as `develop`, by this algorithm of LibRaw's."""
    if demosaic == "AHD":
        return develop(path).linear_rgb
    with rawpy.imread(str(path)) as raw:
        pixels = raw.postprocess(
            demosaic_algorithm=rawpy.DemosaicAlgorithm[demosaic],
            gamma=(1, 1), no_auto_bright=True, no_auto_scale=True, output_bps=16, use_camera_wb=False,
            user_wb=[1, 1, 1, 1], output_color=rawpy.ColorSpace.raw, user_flip=0,
        )  # fmt: skip
        span = float(raw.white_level) - min(raw.black_level_per_channel)
    return np.asarray(cv2.multiply(pixels, np.full(4, 65535 / span)), np.uint16)


def raw_set(
    name: str,
    folder: Path,
    gains: str,
    iso: int,
    exposure: float | tuple[float, float, float] = 1.0,
    demosaic: str = "LINEAR",
    lights: tuple[tuple[float, float, float], ...] = ((1.0, 1.0, 1.0),) * 3,
) -> Set:
    """Make RAW of the same scenes, of one exposure or of one each, in one light or in one each: see `expose`."""
    scenes = [
        cv2.resize(linear_of(i), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        for i in originals(name, 1)
    ]
    scenes = [s[: s.shape[0] // 2 * 2, : s.shape[1] // 2 * 2] for s in scenes]
    brightest = float(np.percentile(np.stack([s[::4, ::4] for s in scenes]), 99.8))
    exposures = np.broadcast_to(np.array(exposure, np.float32), 3)
    factors = [e * np.array(light, np.float32) for e, light in zip(exposures, lights, strict=True)]
    lit = [s * (f / np.float32(brightest)) for s, f in zip(scenes, factors, strict=True)]
    found = expose(lit, folder, GAINS[gains], iso, demosaic)
    found.pairs = [(0, 1), (1, 2)]
    if name == "fountain-p11":
        found.fundamental = fountain_truth(0.5)
    return found


def expose(
    scenes: list[NDArray[np.float32]],
    folder: Path,
    gains: tuple[float, float, float],
    iso: int,
    demosaic: str = "LINEAR",
    focal_35mm: int = 35,
) -> Set:
    """Write DNG of linear scenes (1 is white), with the photon and read noise of that ISO, and develop it."""
    folder.mkdir(parents=True, exist_ok=True)
    images: list[Rgb] = []
    files = []
    for n, scene in enumerate(scenes):
        rng = np.random.default_rng((n, iso))
        well = FULL_WELL_E * 100 / iso
        electrons = scene * np.array(gains, np.float32) * np.float32(well)
        spread = np.sqrt(electrons + np.float32(READ_NOISE_E**2))
        electrons += spread * rng.standard_normal(scene.shape, dtype=np.float32)
        response = electrons / np.float32(well)
        plane = response[..., 1].copy()
        plane[0::2, 0::2] = response[0::2, 0::2, 0]
        plane[1::2, 1::2] = response[1::2, 1::2, 2]
        mosaic = np.clip(np.rint(plane * (WHITE - BLACK)) + BLACK, 0, WHITE).astype(np.uint16)
        path = folder / f"{n}.dng"
        write_dng(
            path,
            mosaic,
            black=BLACK,
            white=WHITE,
            as_shot_neutral=gains,
            colour_matrix=np.eye(3),
            exif=PhotoExif(
                taken="2016:06:21 10:00:00", exposure_time_s=Fraction(1, 100), focal_length_35mm=focal_35mm
            ),
        )
        files.append(path)
        images.append(developed(path, demosaic))
    return Set(images, [], mosaics=files)


def demo_set(folder: Path, suffix: str) -> Set:
    """Return three views of the demo scene, rendered before with `colmap-ihe demo`."""
    stems = ("portico_05", "portico_06", "portico_07")
    record = json.loads((folder / "truth" / "cameras.json").read_text())["cameras"]
    cameras = []
    for stem in stems:
        pose = np.array(record[stem]["cam_from_world"])
        cameras.append((np.array(record[stem]["calibration"]), pose[:, :3], -pose[:, :3].T @ pose[:, 3]))
    paths = [folder / "images" / f"{stem}{suffix}" for stem in stems]
    truth = {(0, 1): epipolar(cameras[0], cameras[1]), (1, 2): epipolar(cameras[1], cameras[2])}
    if suffix == ".jpg":
        return Set([read_rgb(p) for p in paths], [(0, 1), (1, 2)], truth)
    return Set([developed(p) for p in paths], [(0, 1), (1, 2)], truth, mosaics=paths)


def painted(kind: str, folder: Path) -> Set:
    """Paint a wall in two colours of one Rec.709 grey, and a little relief in grey; seen twice.

    In sRGB for JPEG; in the sensor's own linear values for RAW, since there Rec.709 is taken of those.
    """
    size = (1344, 960)
    rng = np.random.default_rng(7)
    drawing = np.zeros(size[::-1], np.float32)
    for cell in (2, 3, 5, 9, 17, 33, 65):
        coarse = rng.standard_normal((size[1] // cell + 1, size[0] // cell + 1)).astype(np.float32)
        drawing += cell**0.6 * cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    relief = cv2.GaussianBlur(rng.standard_normal(size[::-1]).astype(np.float32), (0, 0), 3) * 4
    share = np.asarray(0.5 + 0.5 * np.tanh(drawing / drawing.std()), np.float32)
    first, second = np.array((0.75, 0.56, 0.45)), np.array((0.46, 0.63, 0.67))
    rec709 = np.array((0.2126, 0.7152, 0.0722))
    if kind != "jpeg":
        first, second = np.array((0.42, 0.50, 0.25)), np.array((0.25, 0.56, 0.40))
    second = second + (first - second) @ rec709
    wall = first + share[..., None] * (second - first) + 0.03 * relief[..., None]
    warp = np.array([[0.93, 0.06, 20], [-0.05, 0.96, 35], [2e-5, -3e-5, 1.0]])
    turned = cv2.warpPerspective(np.asarray(wall, np.float32), warp, size, flags=cv2.INTER_CUBIC)
    # What the second view sees beyond the wall is black; both are cut to where it sees the wall.
    inside = (slice(64, 864), slice(96, 1200))
    wall, turned = wall[inside], turned[inside]
    cut = np.array([[1, 0, -96], [0, 1, -64], [0, 0, 1]])
    warp = cut @ warp @ np.linalg.inv(cut)
    views = [np.clip(v, 0.01, 0.99).astype(np.float32) for v in (wall, turned)]
    if kind == "jpeg":
        noisy = [v + rng.normal(0, 0.006, v.shape) for v in views]
        found = Set([recompress(np.rint(255 * np.clip(v, 0, 1)).astype(np.uint8), 92) for v in noisy], [])
    else:
        found = expose(views, folder, (1.0, 1.0, 1.0), int(kind.removeprefix("raw")))
    found.pairs = [(0, 1)]
    # Centres of pixels are whole numbers to OpenCV and halves to COLMAP.
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    found.homography = {(0, 1): half @ warp @ np.linalg.inv(half)}
    return found


def all_sets(work: Path, demo: Path) -> dict[str, Callable[[], Set]]:
    """Return the sets by name, in order of interest."""
    sets: dict[str, Callable[[], Set]] = {
        "fountain-half": partial(photographs, "fountain-p11"),
        "sceaux-half": partial(photographs, "sceaux"),
        "demo-jpeg": partial(demo_set, demo, ".jpg"),
        "demo-raw": partial(demo_set, demo, ".dng"),
        "sceaux-crop": partial(crops, "sceaux"),
        "fountain-crop": partial(crops, "fountain-p11"),
        "iso-jpeg": partial(painted, "jpeg", work / "iso"),
        "iso-raw-400": partial(painted, "raw400", work / "iso"),
        "fountain-q80": partial(photographs, "fountain-p11", 80),
        "sceaux-q80": partial(photographs, "sceaux", 80),
    }
    shots = [
        ("a", 400, 1.0),
        ("a", 1600, 1.0),
        ("a", 100, 1.0),
        ("a", 6400, 1.0),
        ("tungsten", 400, 1.0),
        ("cloudy", 1600, 0.7),
        ("a", 100, 2.0),
    ]
    for demosaic in ("LINEAR", "AHD"):
        for gains, iso, exposure in shots:
            for name in ("fountain-p11", "sceaux"):
                short = f"{name.split('-')[0]}-{'raw' if demosaic == 'LINEAR' else demosaic.lower()}-{gains}-{iso}"
                short += f"-x{exposure:g}" if exposure != 1 else ""
                sets[short] = partial(raw_set, name, work / short, gains, iso, exposure, demosaic)
    return sets
