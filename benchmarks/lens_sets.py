"""Simulate sets of photographs through known lenses, as COLMAP databases with matches, and try COLMAP on them.

    python benchmarks/lens_sets.py [--images 4 10 30] [--scenes facade ...] [--lenses barrel ...] [--seeds 1]

No photograph is made: features lie on the surfaces of a place (lens_scenes.py), are seen where nothing hides them, are
found again the less the view has turned, and are matched with some mistakes; COLMAP verifies the pairs. The table says,
for each place and lens: photographs registered, points, mean track length, mean reprojection error, mean position error
of COLMAP's default, and of one more bundle adjustment with the principal point free. In millimetres; places are metres.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from lens_scenes import PLACES, Floats, Panels, View
from numpy.typing import NDArray

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline.bars import print_table

Parameters = tuple[float, ...]
Draw = Callable[[np.random.Generator], Parameters]

SCENES: tuple[str, ...] = tuple(PLACES)
_SMALLEST_PX = 1.2  # scale of the smallest features of SIFT
_FACING = np.cos(np.radians(70))
_TURN, _OCTAVE = (
    np.radians(15),
    np.radians(20),
)  # how far a feature is known again; what a doubled distance counts
_FOUND, _MATCHED, _WRONG = 0.8, 0.9, 0.05
_PILOT = 20_000


@dataclass(frozen=True)
class Lens:
    """Describe a kind of lens: COLMAP's model, the range of focal lengths in longer sides, and what draws the rest."""

    model: str
    focal: tuple[float, float]
    distortion: Draw


def _ranges(*ranges: tuple[float, float]) -> Draw:
    return lambda rng: tuple(float(rng.uniform(low, high)) for low, high in ranges)


def _decentred(rng: np.random.Generator) -> Parameters:
    k1, k2, size, way = rng.uniform((-0.12, 0, 0.7e-3, 0), (-0.04, 0.04, 1.5e-3, 2 * np.pi)).tolist()
    return k1, k2, float(size * np.cos(way)), float(size * np.sin(way))


def _moustache(rng: np.random.Generator) -> Parameters:
    k1, k2, k3 = rng.uniform((-0.14, 0.12, -0.06), (-0.10, 0.18, -0.02)).tolist()
    return k1, k2, 0.0, 0.0, k3, 0.0, 0.0, 0.0


_USUAL = (0.75, 1.4)
LENSES: Mapping[str, Lens] = {
    "none": Lens("SIMPLE_PINHOLE", _USUAL, lambda rng: ()),
    "barrel": Lens("SIMPLE_RADIAL", _USUAL, _ranges((-0.15, -0.05))),
    "barrel2": Lens("RADIAL", _USUAL, _ranges((-0.15, -0.05), (0.01, 0.06))),
    "pincushion": Lens("SIMPLE_RADIAL", _USUAL, _ranges((0.03, 0.08))),
    "decentred": Lens("OPENCV", _USUAL, _decentred),
    "complex": Lens("FULL_OPENCV", _USUAL, _moustache),
    "fisheye": Lens(
        "OPENCV_FISHEYE",
        (0.53, 0.69),
        _ranges((-0.03, 0.03), (-0.01, 0.01), (-0.004, 0.004), (-0.001, 0.001)),
    ),
    "strong": Lens("RADIAL", (0.5, 0.7), _ranges((-0.32, -0.27), (0.09, 0.11))),
}
"""By name. A name with "+1" behind it has its principal point 1 % of the longer side off the middle."""


@dataclass(frozen=True)
class LensSet:
    """Hold a simulated set: `truth` is the camera in pixels, `poses` cam_from_world (3, 4) in metres by image name."""

    name: str
    scene: str
    lens: str
    images: int
    truth: pycolmap.Camera
    poses: dict[str, NDArray[np.float64]]
    database: Path


@dataclass(frozen=True)
class Features:
    """Hold features of the place: (n, 3) points, normals and tangents, sizes in metres, how far they are known again."""

    points: Floats
    normals: Floats
    sizes: Floats
    known: Floats


def true_camera(lens: str, size: tuple[int, int], rng: np.random.Generator) -> pycolmap.Camera:
    """Draw a camera of a kind of lens. ValueError where the lens is unknown or folds within the picture."""
    name, _, per_cent = lens.partition("+")
    if name not in LENSES:
        raise ValueError(
            f"lens {lens!r} is not known: take one of {', '.join(LENSES)}, with +1 behind it for 1 % off"
        )
    kind, longer = LENSES[name], max(size)
    focal, way, off = rng.uniform((kind.focal[0], 0, 0), (kind.focal[1], 2 * np.pi, 2)).tolist()
    distortion = kind.distortion(rng)
    shift = (float(per_cent) if per_cent else off) / 100 * longer
    middle = (size[0] / 2 + shift * np.cos(way), size[1] / 2 + shift * np.sin(way))
    single = kind.model.startswith("SIMPLE") or kind.model == "RADIAL"
    lengths = (focal * longer,) if single else (focal * longer, focal * longer)
    camera = pycolmap.Camera(
        model=kind.model, width=size[0], height=size[1], params=[*lengths, *middle, *distortion], camera_id=1
    )
    angles = ray_angles(camera, np.linspace((0.0, 0.0), middle, 400))
    if not (np.diff(angles) < 0).all():
        raise ValueError(f"lens {lens} folds within the picture: {camera.params_to_string()}")
    return camera


def ray_angles(camera: pycolmap.Camera, pixels: Floats) -> Floats:
    """Return the angles off the axis of (n, 2) pixels in radians."""
    rays = np.asarray(camera.cam_from_img(pixels))
    return np.asarray(np.arctan(np.linalg.norm(rays, axis=1)))


def _view(camera: pycolmap.Camera) -> View:
    x, y = camera.principal_point_x, camera.principal_point_y
    side, top = ray_angles(camera, np.array([[camera.width, y], [x, 0.0]])).tolist()
    return View(side, top)


def scatter(panels: Panels, number: int, smallest: float, rng: np.random.Generator) -> Features:
    """Scatter features on panels by their texture; sizes are as many at every scale (Pareto), from `smallest` metres."""
    weight = panels.area * panels.texture
    panel = rng.choice(len(weight), number, p=weight / weight.sum())
    share = rng.uniform(size=(number, 2))
    points = panels.corner[panel] + share[:, :1] * panels.across[panel] + share[:, 1:] * panels.up[panel]
    sizes = smallest / np.sqrt(1 - rng.uniform(size=number))
    return Features(points, panels.normal[panel], sizes, _TURN * rng.lognormal(0, 0.5, number))


def _hidden(points: Floats, centre: Floats, panels: Panels) -> NDArray[np.bool_]:
    """Tell which of (n, 3) points lie behind a panel that faces `centre`."""
    normal, hidden = panels.normal, np.zeros(len(points), bool)
    ahead = np.einsum("ij,ij->i", normal, panels.corner - centre)
    rays = points - centre
    for number in np.flatnonzero(ahead < 0):
        corner, across, up = panels.corner[number], panels.across[number], panels.up[number]
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = ahead[number] / (rays @ normal[number])
        near = np.flatnonzero((reach > 0) & (reach < 0.999) & ~hidden)
        hit = centre + reach[near, None] * rays[near] - corner
        u, v = hit @ across / (across @ across), hit @ up / (up @ up)
        hidden[near] |= (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
    return hidden


def _visible(features: Features, camera: pycolmap.Camera, pose: Floats, panels: Panels) -> NDArray[np.bool_]:
    """Tell which features a photograph shows, large enough to be found, (n,)."""
    centre = -pose[:, :3].T @ pose[:, 3]
    local = features.points @ pose[:, :3].T + pose[:, 3]
    rays = features.points - centre
    distance = np.linalg.norm(rays, axis=1)
    facing = -np.einsum("ij,ij->i", rays, features.normals) > _FACING * distance
    large = features.sizes * camera.mean_focal_length() > _SMALLEST_PX * distance
    corners = np.array([[0.0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]])
    ahead = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2]) <= ray_angles(camera, corners).max()
    chosen = np.flatnonzero(facing & large & ahead)
    pixels = np.asarray(camera.img_from_cam(local[chosen])).reshape(-1, 2)
    chosen = chosen[((pixels > 0) & (pixels < (camera.width, camera.height))).all(axis=1)]
    visible = np.zeros(len(local), bool)
    visible[chosen[~_hidden(features.points[chosen], centre, panels)]] = True
    return visible


def _looks(features: Features, centres: Floats) -> Floats:
    """Return from where each feature is seen, (images, n, 4): direction, and the distance's octaves as an angle."""
    rays = features.points[None] - centres[:, None]
    distance = np.linalg.norm(rays, axis=2, keepdims=True)
    return np.concatenate([rays / distance, _OCTAVE * np.log2(distance)], axis=2)


def _detected(
    visible: NDArray[np.bool_], looks: Floats, known: Floats, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Tell which features each photograph finds (images, n): each has one photograph that shows it best."""
    lots = rng.uniform(size=visible.shape) * visible
    best = lots.argmax(axis=0)
    home = looks[best, np.arange(looks.shape[1])]
    apart = np.linalg.norm(looks - home, axis=2) / known
    found = rng.uniform(size=visible.shape) < _FOUND * np.exp(-0.5 * apart**2)
    return np.asarray(found & visible)


def _pixels(
    features: Features, camera: pycolmap.Camera, pose: Floats, look: Floats, seed: int, noise_px: float
) -> tuple[Floats, Floats]:
    """Return the (n, 2) places where features are found and their (n,) scales in pixels."""
    rng = np.random.default_rng(seed)
    local = features.points @ pose[:, :3].T + pose[:, 3]
    scale = camera.mean_focal_length() * features.sizes / np.linalg.norm(local, axis=1)
    rank = (scale * rng.lognormal(0, 0.3, len(scale))).argsort().argsort() / max(len(scale), 1)
    spread = np.select([rank < 0.7, rank < 0.95], [0.35, 0.8], 2.0) * noise_px / 0.545
    return np.asarray(camera.img_from_cam(local)) + rng.normal(size=(len(local), 2)) * spread[:, None], scale


def simulate(
    folder: Path,
    scene: str,
    lens: str,
    images: int,
    seed: int,
    *,
    size: tuple[int, int] = (1600, 1067),
    prior_focal: bool = True,
    noise_px: float = 0.5,
    points: int = 3000,
) -> LensSet:
    """Simulate a set below `folder`: its database has one camera as COLMAP begins with, features, matches and verified
    pairs. `points`: features an image, about. One seed gives one place, walk and noise, whatever the lens."""
    place_rng, lens_rng, feature_rng, noise_rng = (
        np.random.default_rng([seed, stream]) for stream in range(4)
    )
    camera = true_camera(lens, size, lens_rng)
    panels, poses = PLACES[scene](images, _view(camera), place_rng)
    centres = np.array([-pose[:, :3].T @ pose[:, 3] for pose in poses])
    nearest = float(np.median([np.linalg.norm(panels.corner - centre, axis=1).min() for centre in centres]))
    smallest = 0.5 * _SMALLEST_PX * nearest / camera.mean_focal_length()

    def find(number: int) -> tuple[Features, Floats, NDArray[np.bool_]]:
        features = scatter(panels, number, smallest, feature_rng)
        visible = np.array([_visible(features, camera, pose, panels) for pose in poses])
        seen = visible.any(axis=0)
        features = Features(
            *(getattr(features, name)[seen] for name in ("points", "normals", "sizes", "known"))
        )
        looks = _looks(features, centres)
        return features, looks, _detected(visible[:, seen], looks, features.known, feature_rng)

    number = int(_PILOT * points * images / max(find(_PILOT)[2].sum(), 1))
    features, looks, found = find(number)
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{scene}-{lens}-{images}-{seed}"
    database = folder / f"{name}.db"
    database.unlink(missing_ok=True)
    rows = [noise_rng.permutation(np.flatnonzero(row)) for row in found]
    names = [f"{number:04d}.jpg" for number in range(images)]
    keypoints = []
    for row, pose, look in zip(rows, poses, looks, strict=True):
        part = Features(features.points[row], features.normals[row], features.sizes[row], features.known[row])
        place, scale = _pixels(part, camera, pose, look[row], int(noise_rng.integers(2**31)), noise_px)
        keypoints.append(np.column_stack([place, scale, np.zeros(len(scale))]).astype(np.float32))
    _write(database, start_camera(camera, prior_focal, lens_rng), names, keypoints)
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        for (first, second), pair in _matches(rows, looks, features.known, noise_rng):
            opened.write_matches(first + 1, second + 1, pair)
    verify(database, seed)
    return LensSet(name, scene, lens, images, camera, dict(zip(names, poses, strict=True)), database)


def _matches(
    rows: list[NDArray[np.intp]], looks: Floats, known: Floats, rng: np.random.Generator
) -> Iterator[tuple[tuple[int, int], NDArray[np.uint32]]]:
    """Match the features of each pair of photographs, the less the more the view has turned; some are wrong."""
    for first, second in combinations(range(len(rows)), 2):
        shared, left, right = np.intersect1d(
            rows[first], rows[second], assume_unique=True, return_indices=True
        )
        apart = np.linalg.norm(looks[first, shared] - looks[second, shared], axis=1) / (2 * known[shared])
        kept = rng.uniform(size=len(shared)) < _MATCHED * np.exp(-0.5 * apart**2)
        left, right = left[kept], right[kept]
        wrong = int(_WRONG * len(left)) + 10
        others = [
            rng.choice(np.setdiff1d(np.arange(len(rows[image])), used), wrong, replace=False)
            for image, used in ((first, left), (second, right))
        ]
        pair = np.column_stack([np.concatenate([left, others[0]]), np.concatenate([right, others[1]])])
        yield (first, second), rng.permutation(pair).astype(np.uint32)


def start_camera(truth: pycolmap.Camera, prior_focal: bool, rng: np.random.Generator) -> pycolmap.Camera:
    """Return the camera that COLMAP begins with: SIMPLE_RADIAL, its focal length from EXIF or guessed."""
    longer = max(truth.width, truth.height)
    focal = truth.mean_focal_length() * rng.uniform(0.985, 1.015) if prior_focal else 1.2 * longer
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", focal, truth.width, truth.height)
    camera.has_prior_focal_length = prior_focal
    return camera


def write_camera_model(database: Path, model: str) -> None:
    """Make the camera of a database another model of COLMAP's, of the same focal length, without distortion."""
    with pycolmap.Database.open(database) as opened:
        old = opened.read_camera(1)
        new = pycolmap.Camera.create_from_model_name(1, model, old.mean_focal_length(), old.width, old.height)
        new.has_prior_focal_length = old.has_prior_focal_length
        opened.update_camera(new)


def verify(database: Path, seed: int = 0) -> None:
    """Verify the matches of a database anew, by COLMAP with one thread."""
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = seed
    with pycolmap.Database.open(database) as opened:
        opened.clear_two_view_geometries()
    pycolmap.geometric_verification(
        database, pycolmap.GeometricVerifierOptions(num_threads=1), two_view_geometry_options=options
    )


def _write(
    database: Path, camera: pycolmap.Camera, names: list[str], keypoints: list[NDArray[np.float32]]
) -> None:
    with pycolmap.Database.open(database) as opened, pycolmap.DatabaseTransaction(opened):
        opened.write_camera(camera, use_camera_id=True)
        rig = pycolmap.Rig(rig_id=1)
        rig.add_ref_sensor(camera.sensor_id)
        opened.write_rig(rig, use_rig_id=True)
        for image_id, (name, places) in enumerate(zip(names, keypoints, strict=True), start=1):
            image = pycolmap.Image(name=name, camera_id=1, image_id=image_id)
            frame = pycolmap.Frame(frame_id=image_id, rig_id=1)
            frame.add_data_id(image.data_id)
            opened.write_frame(frame, use_frame_id=True)
            image.frame_id = image_id
            opened.write_image(image, use_image_id=True)
            opened.write_keypoints(image_id, places)


def position_error_mm(model: pycolmap.Reconstruction, poses: Mapping[str, NDArray[np.float64]]) -> float:
    """Return the mean distance of camera centres from the truth after the best similarity; nan with fewer than 3."""
    images = [image for image in model.images.values() if image.has_pose]
    if len(images) < 3:
        return float("nan")
    centres = np.array([image.projection_center() for image in images])
    truth = np.array([-poses[image.name][:, :3].T @ poses[image.name][:, 3] for image in images])
    fit = pycolmap.estimate_sim3d(centres, truth)
    if fit is None:
        return float("nan")
    return float(1000 * np.linalg.norm(fit * centres - truth, axis=1).mean())


def reconstruct(database: Path, folder: Path) -> pycolmap.Reconstruction | None:
    """Reconstruct a database by COLMAP's default with one thread; the largest model, None where there is none."""
    options = pycolmap.IncrementalPipelineOptions(num_threads=1, random_seed=0, extract_colors=False)
    models = pycolmap.incremental_mapping(database, folder, folder, options)
    return max(models.values(), key=lambda model: model.num_reg_images(), default=None)


def _row(made: LensSet, folder: Path) -> tuple[str, ...]:
    began = time.monotonic()
    model = reconstruct(made.database, folder)
    seconds = time.monotonic() - began
    if model is None:
        return (made.scene, made.lens, f"0 of {made.images}", *"-----", f"{seconds:.1f}")
    found = (
        f"{model.num_reg_images()} of {made.images}",
        f"{model.num_points3D()}",
        f"{model.compute_mean_track_length():.2f}",
        f"{model.compute_mean_reprojection_error():.3f}",
        f"{position_error_mm(model, made.poses):.1f}",
    )
    pycolmap.bundle_adjustment(
        model, pycolmap.BundleAdjustmentOptions(refine_principal_point=True, print_summary=False)
    )
    freed = f"{position_error_mm(model, made.poses):.1f}"
    return (made.scene, made.lens, *found, freed, f"{seconds:.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--images", type=int, nargs="+", default=[10])
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES)
    parser.add_argument("--lenses", nargs="+", default=tuple(LENSES))
    parser.add_argument("--seed", type=int, default=1)
    parsed = parser.parse_args()
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    head = ("scene", "lens", "registered", "points", "track", "px", "mm", "mm, pp free", "s")
    for images in parsed.images:
        rows = []
        for scene in parsed.scenes:
            for lens in parsed.lenses:
                with tempfile.TemporaryDirectory() as folder:
                    made = simulate(Path(folder), scene, lens, images, parsed.seed)
                    rows.append(_row(made, Path(folder)))
        print_table(f"{images} photographs", rows, head)


if __name__ == "__main__":
    main()
