"""Sets that no survey should hold and some do, small and with known truth: each function writes the photographs of one.

Textured rectangles before the cameras of `colmap_ihe.demo`, as JPEG with EXIF. World in metres: x to the right, y
away from the cameras, z up.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.evaluation.demo.exif import PhotoExif, jpeg_exif
from colmap_ihe.evaluation.demo.raycast import Surface, render
from colmap_ihe.evaluation.demo.shapes import Rect
from colmap_ihe.evaluation.demo.views import DemoView, looking
from colmap_ihe.grey.srgb import coded

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

SIZE = (384, 288)
BLACK = np.zeros((*SIZE[::-1], 3), np.uint8)
FOCAL_35MM = 28  # what COLMAP makes of it: over the diagonal of 36 x 24 mm
FOCAL_PX = FOCAL_35MM / 43.27 * math.hypot(*SIZE)
_TEXEL_M = 0.012
_LOW, _HIGH = (-7.0, 0.0), (7.0, 6.0)


def view(centre: Sequence[float], target: Sequence[float], focal_px: float = FOCAL_PX) -> DemoView:
    pose = looking(np.array(centre, float), np.array(target, float), roll=0.0)
    return DemoView("", *SIZE, focal_px, pose, Fraction(1, 125))


def row_of_views(count: int, *, width: float = 6.0, distance: float = 7.0) -> list[DemoView]:
    """Side by side along the wall, each turned a little towards its middle."""
    return [
        view((x, -distance, 2.6 + 0.5 * math.sin(3 * x)), (0.5 * x, 0, 3))
        for x in np.linspace(-width / 2, width / 2, count)
    ]


def walked(places: F64, distance: float) -> list[DemoView]:
    """Along the wall, each straight at it."""
    return [view((x, -distance, 2.8 + 0.4 * math.sin(2 * x)), (x, 0, 3)) for x in places]


def texture(width_m: float, height_m: float, seed: int) -> F32:
    """(H, W, 3): blobs of colour of many sizes, with hard edges."""
    draw = np.random.default_rng(seed)
    shape = (max(4, round(height_m / _TEXEL_M)), max(4, round(width_m / _TEXEL_M)))
    total = np.zeros((*shape, 3), np.float32)
    for sigma, weight in ((1.5, 0.5), (4, 0.8), (12, 1.0)):
        noise = cv2.GaussianBlur(draw.standard_normal((*shape, 3)).astype(np.float32), (0, 0), sigma)
        total += np.float32(weight) * np.tanh(2 * noise / noise.std())
    return np.asarray(np.clip(0.35 + 0.12 * total, 0.02, 1), np.float32)


def surface(shape: Rect, picture: F32) -> Surface:
    pyramid = [picture]
    while len(pyramid) < 5 and min(pyramid[-1].shape[:2]) > 3:
        pyramid.append(np.asarray(cv2.pyrDown(pyramid[-1]), np.float32))
    return Surface(shape, shape.size_m[1] / picture.shape[0], tuple(pyramid))


def panel(at: float, low: tuple[float, float], high: tuple[float, float], seed: int) -> Surface:
    """A textured rectangle that faces the cameras, at y = `at`."""
    return surface(Rect(1, at, low, high, -1), texture(high[0] - low[0], high[1] - low[1], seed))


@lru_cache(maxsize=4)
def flat_wall(seed: int = 1) -> tuple[Surface, ...]:
    return (panel(0, _LOW, _HIGH, seed),)


@lru_cache(maxsize=4)
def relief(seed: int = 1) -> tuple[Surface, ...]:
    """A wall with panels before it at depths up to 2 m."""
    draw = np.random.default_rng(seed)
    before = []
    for number in range(16):
        x, z = -5.6 + 1.6 * (number % 8) + 0.3 * draw.random(), 0.6 + 2.6 * (number // 8) + draw.random()
        wide, high = 0.7 + 0.6 * draw.random(2)
        before.append(panel(-0.3 - 1.7 * draw.random(), (x, z), (x + wide, z + high), 100 * seed + number))
    return (*flat_wall(seed), *before)


def photograph(
    scene: Sequence[Surface],
    seen: DemoView,
    file: Path,
    *,
    focal_35mm: int | None = FOCAL_35MM,
    model: str = "Demo camera",
) -> None:
    """Writes a JPEG, whose EXIF says `focal_35mm`, whatever the view's focal length is."""
    radiance = render(scene, seen).radiance
    seed = sum(file.name.encode())
    noise = np.random.default_rng(seed).standard_normal(radiance.shape, dtype=np.float32)
    pixels = np.rint(255 * coded(np.clip(radiance + np.float32(0.004) * noise, 0, 1))).astype(np.uint8)
    exif = PhotoExif(model=model, focal_length_35mm=focal_35mm, focal_length_mm=focal_35mm)
    save(pixels, file, exif)


def save(pixels: NDArray[np.uint8], file: Path, exif: PhotoExif | None = None) -> None:
    height, width = pixels.shape[:2]
    jpeg = BytesIO()
    block = {"exif": jpeg_exif(exif, width, height)} if exif else {}
    Image.fromarray(pixels).save(jpeg, "JPEG", quality=94, subsampling=0, **block)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(jpeg.getvalue())


def shoot(
    scene: Sequence[Surface],
    views: Sequence[DemoView],
    images: Path,
    name: str = "shot",
    focal_35mm: int | None = FOCAL_35MM,
) -> None:
    for number, seen in enumerate(views, start=1):
        photograph(scene, seen, images / f"{name}_{number:02}.jpg", focal_35mm=focal_35mm)


# The sets


def sound(images: Path) -> None:
    shoot(relief(), row_of_views(7), images)


def one(images: Path) -> None:
    shoot(relief(), row_of_views(1, width=0), images)


def two(images: Path) -> None:
    shoot(relief(), row_of_views(2, width=2.4), images)


def three(images: Path) -> None:
    shoot(relief(), row_of_views(3, width=3.6), images)


def two_identical(images: Path) -> None:
    one(images)
    (images / "shot_02.jpg").write_bytes((images / "shot_01.jpg").read_bytes())


def two_from_one_place(images: Path) -> None:
    """The shutter was released twice: other noise, the same view."""
    shoot(relief(), [*row_of_views(1, width=0)] * 2, images)


def sound_with_copies(images: Path) -> None:
    """A sound set with the same file twice, once in a folder."""
    sound(images)
    (images / "copies").mkdir()
    for number in (2, 5):
        (images / f"copies/copy_{number}.jpg").write_bytes((images / f"shot_0{number}.jpg").read_bytes())


def straight_row(images: Path) -> None:
    """Side by side on a straight line, all looking straight ahead: what a focal length is worth does not show."""
    shoot(relief(), [view((x, -6.5, 3), (x, 0, 3)) for x in np.linspace(-3, 3, 9)], images)


def pure_rotation(images: Path) -> None:
    turns = [view((0, -6.5, 3), (x, 0, 3)) for x in np.linspace(-3.5, 3.5, 6)]
    shoot(relief(), turns, images)


def partly_rotation(images: Path) -> None:
    """Five views side by side, and five that were taken from one tripod."""
    shoot(relief(), row_of_views(5, width=4), images)
    shoot(relief(), [view((0, -6, 3), (x, 0, 3)) for x in np.linspace(-2.5, 2.5, 5)], images, "turned")


def no_overlap(images: Path) -> None:
    for number in range(4):
        photograph(relief(10 + number), row_of_views(1, width=0)[0], images / f"shot_{number + 1:02}.jpg")


def flat_wall_set(images: Path) -> None:
    shoot(flat_wall(), row_of_views(6), images)


def flat_wall_unknown(images: Path) -> None:
    """As above, and no photograph says its focal length."""
    shoot(flat_wall(), row_of_views(6), images, focal_35mm=None)


def flat_wall_oblique(images: Path) -> None:
    """Turned towards the wall from both sides, which pins the focal length down."""
    places = ((-6, 3), (-4, 5), (-2, 2), (2, 5), (4, 2), (6, 3))
    shoot(flat_wall(), [view((x, -6, z), (0, 0, 3)) for x, z in places], images)


def moving_crowd(images: Path) -> None:
    """The relief behind people in clothes with patterns, elsewhere in every photograph."""
    crowd(images, 14)


def thick_crowd(images: Path) -> None:
    crowd(images, 45)


def crowd(images: Path, people: int) -> None:
    for number, seen in enumerate(row_of_views(7), start=1):
        draw = np.random.default_rng(number)
        there = []
        for person in range(people):
            x, y, tall = draw.uniform(-5, 5), draw.uniform(-4.2, -2.1), 2 + 0.13 * (person % 15)
            there.append(panel(y, (x, 0), (x + 0.8, tall), 1000 + person))
        photograph([*relief(), *there], seen, images / f"shot_{number:02}.jpg")


def all_black(images: Path) -> None:
    for number in range(3):
        taken = PhotoExif(taken=f"2016:06:21 10:0{number}:00")
        save(BLACK, images / f"shot_{number + 1:02}.jpg", taken)


def one_black(images: Path) -> None:
    """A sound set, and one photograph with the lens cap on."""
    sound(images)
    save(BLACK, images / "cap.jpg", PhotoExif(model="Demo camera", focal_length_35mm=28))


def one_colour(images: Path) -> None:
    for number in range(3):
        pixels = np.full((*SIZE[::-1], 3), (180, 90, 60 + number), np.uint8)
        save(pixels, images / f"shot_{number + 1:02}.jpg", PhotoExif())


def wrong_focal_lengths(images: Path) -> None:
    """Two cameras: one says its focal length, the other, as after a crop or a wrong lens, half of it."""
    cameras = (("wrong", FOCAL_35MM // 2, "Other camera"), ("right", FOCAL_35MM, "Demo camera"))
    for number, seen in enumerate(row_of_views(10), start=1):
        name, focal, model = cameras[number % 2]
        file = images / f"{name}_{number:02}.jpg"
        photograph(relief(), seen, file, focal_35mm=focal, model=model)


def lone_shot(images: Path) -> None:
    """A sound set and one photograph of something else."""
    sound(images)
    photograph(relief(9), row_of_views(1, width=0)[0], images / "elsewhere.jpg")


def double_focal_lengths(images: Path) -> None:
    shoot(relief(), row_of_views(8), images, focal_35mm=2 * FOCAL_35MM)


def two_wings(images: Path) -> None:
    """Two like wings and an unlike middle, walked along."""
    wing = texture(4.8, 6, 5)
    scene = []
    for left in (-7.2, 2.4):
        scene.append(surface(Rect(1, 0, (left, 0), (left + 4.8, 6), -1), wing))
        for part in range(4):
            x, z = left + 0.2 + 1.15 * part, 0.5 + 1.1 * (part % 3)
            scene.append(panel(-0.5 - 0.4 * part, (x, z), (x + 0.8, z + 1.8), 60 + part))
    scene.append(panel(0, (-2.4, 0), (2.4, 6), 70))
    scene += [panel(-1.2, (x, 1), (x + 0.7, 3), 80 + n) for n, x in enumerate((-1.6, -0.2, 1.1))]
    shoot(scene, walked(np.arange(-5.5, 5.6, 0.6), 5), images)


def two_halves(images: Path) -> None:
    """Two places, and no photograph of what is between."""
    for place in range(2):
        shoot(relief(20 + place), row_of_views(4, width=3), images, "north" if place else "south")


def street(images: Path) -> None:
    """Between two facades with bays, walked forward: the camera moves along its own axis."""
    long, draw, scene = 40.0, np.random.default_rng(3), []
    for side in (-1, 1):
        wall = Rect(0, 4.0 * side, (0, 0), (long, 6), -side)
        scene.append(surface(wall, texture(long, 6, 40 + side)))
        for bay in range(14):
            y, z = 1.5 + 2.6 * bay + draw.uniform(-0.4, 0.4), draw.uniform(0.5, 3)
            wide, high = draw.uniform(0.8, 1.8, 2)
            oriel = Rect(0, side * (4 - draw.uniform(0.1, 0.6)), (y, z), (y + wide, z + high), -side)
            scene.append(surface(oriel, texture(wide, high, 500 + 20 * side + bay)))
    scene.append(panel(long, (-4, 0), (4, 6), 77))
    steps = [(draw.normal(0, 0.08), 1.5 * number, draw.normal(0, 0.15)) for number in range(10)]
    shoot(scene, [view((x, y, 1.7), (x + aside, y + 12, 1.9)) for x, y, aside in steps], images)


def repeated_facade(images: Path) -> None:
    """Twelve bays, each like the next, walked along; and a few marks of which there is one each."""
    facade(images, marks=18)


def like_bays(images: Path) -> None:
    """The same without a mark: nothing in the photographs tells one bay from another."""
    facade(images, bays=7, step=0.8)


def facade(images: Path, *, bays: int = 10, marks: int = 0, step: float = 0.5, bay_m: float = 2.4) -> None:
    wall = np.tile(texture(bay_m, 6, 5), (1, bays, 1))
    half = bays * bay_m / 2
    scene = [surface(Rect(1, 0, (-half, 0), (half, 6), -1), wall)]
    for bay in range(bays):
        left = -half + bay * bay_m
        scene.append(panel(-0.8, (left + 0.3, 0.6), (left + 1.1, 2.8), 50))
        scene.append(panel(-1.5, (left + 1.3, 1.4), (left + 2.0, 5.2), 51))
    draw = np.random.default_rng(7)
    for mark in range(marks):
        x, z = draw.uniform(-half, half - 1), draw.uniform(0, 5.5)
        scene.append(panel(-1.6 * draw.random() - 0.05, (x, z), (x + 0.5, z + 0.5), 300 + mark))
    shoot(scene, walked(np.arange(-half + 3, half - 3 + 1e-6, step), 6.5), images)


SETS: Mapping[str, Callable[[Path], None]] = {
    f.__name__: f
    for f in (
        sound, one, two, three, two_identical, two_from_one_place, sound_with_copies, straight_row, pure_rotation,
        partly_rotation, no_overlap, flat_wall_set, flat_wall_unknown, flat_wall_oblique, moving_crowd, thick_crowd,
        all_black, one_black, one_colour, wrong_focal_lengths, double_focal_lengths, lone_shot, two_halves, two_wings,
        repeated_facade, like_bays, street,
    )
}  # fmt: skip
