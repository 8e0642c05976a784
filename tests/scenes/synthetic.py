"""Contents of a page without a project: a facade with windows, and made-up figures about it."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from colmap_ihe.report import pictures
from colmap_ihe.report.contents import (
    CameraPose,
    Cloud,
    Contents,
    Drawing,
    FileLink,
    Grey,
    ModelFrame,
    Pair,
    PhotographEntry,
    Picture,
    Slider,
    Surface,
)
from colmap_ihe.report.survey_contents import CameraPlan, OverlapMap, Residuals, SurveyBlock, Verdict

_WEIGHTS = (0.61, 0.34, 0.05)
coded = partial(pictures.picture, longest=960)


@cache
def facade_picture(width: int, height: int, shift: float = 0.0) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 sRGB: ashlar with windows under a sky, moved by `shift` of its width."""
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
    x, y = columns / width * 6 + 6 * shift, rows / height * 4
    draw = np.random.default_rng(1)
    stones = draw.normal(0, 1, (64, 64, 3)).astype(np.float32)
    course = np.floor(y * 3).astype(int)
    stone = np.floor(x * 2 + 0.5 * (course % 2)).astype(int)
    wall = np.array([196, 170, 132]) + stones[course % 64, stone % 64] * [14, 12, 10]
    joint = (np.mod(y * 3, 1) < 0.07) | (np.mod(x * 2 + 0.5 * (course % 2), 1) < 0.04)
    wall[joint] *= 0.8
    window = (np.abs(np.mod(x, 1.5) - 0.75) < 0.28) & (np.abs(np.mod(y, 1.6) - 1.0) < 0.42) & (y > 0.7)
    wall[window] = [58, 66, 78]
    wall[y < 0.6 + 0.05 * np.sin(3 * x)] = [150, 184, 222]
    wall += draw.normal(0, 4, wall.shape)
    return as_bytes(wall)


def as_bytes(values: ArrayLike) -> NDArray[np.uint8]:
    clipped: NDArray[np.uint8] = np.clip(np.asarray(values), 0, 255).astype(np.uint8)
    return clipped


def grey_of(rgb: NDArray[np.uint8], weights: tuple[float, float, float]) -> NDArray[np.uint8]:
    return as_bytes(np.round(rgb @ np.array(weights)))


def facade_cloud(points: int) -> Cloud:
    """A facade 12 by 8 units with a tower, in front of it some ground."""
    draw = np.random.default_rng(2)
    u, v = draw.random(points), draw.random(points)
    picture = facade_picture(1200, 800)
    colours = picture[(v * 799).astype(int), (u * 1199).astype(int)]
    dark = colours.mean(axis=1) < 90
    positions = np.stack(
        [12 * u - 6, 4 - 8 * v, np.where(dark, -0.5, 0.03 * draw.standard_normal(points))], axis=1
    )
    tower = (np.abs(positions[:, 0]) < 1.5) & (draw.random(points) < 0.9)
    positions[tower, 2] += 1.2
    ground = draw.random(points) < 0.25
    deep = draw.normal(-4, 0.04, int(ground.sum()))
    positions[ground] = np.stack([12 * u[ground] - 6, deep, 6 * v[ground]], axis=1)
    colours[ground] = as_bytes(draw.normal((128, 132, 96), 14, (int(ground.sum()), 3)))
    kept = ~((v < 0.16) & ~ground)
    positions, colours = positions[kept].astype(np.float32), colours[kept]
    return Cloud(positions, colours, grey_of(colours, _WEIGHTS), "dense", 4 * points)


def facade_surface(across: int = 60) -> Surface:
    """The facade as a flat mesh 12 by 8 units at z = 0, textured, and with triangles four and 16 times as large."""
    down = 2 * across // 3
    rows, columns = np.mgrid[0 : down + 1, 0 : across + 1]
    u, v = columns.ravel() / across, rows.ravel() / down
    positions = np.stack([12 * u - 6, 4 - 8 * v, np.zeros_like(u)], axis=1).astype(np.float32)
    normals = np.tile(np.array([0, 0, 1], np.float32), (len(u), 1))
    number = np.arange(len(u)).reshape(rows.shape)
    return Surface(
        positions,
        normals,
        _squares(number),
        [_squares(number[::2, ::2]), _squares(number[::4, ::4])],
        4 * across * down,
        texture=coded(facade_picture(1200, 800), "texture"),
        uv=np.stack([u, v], axis=1).astype(np.float32),
    )


def _squares(number: NDArray[np.int64]) -> NDArray[np.int64]:
    """(F, 3): two triangles for each square of a grid of vertices, seen from +z."""
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))]).astype(
        np.int64
    )


def facade_cameras(names: list[str]) -> list[CameraPose]:
    cameras = []
    for i, name in enumerate(names):
        x = -6 + 12 * i / max(len(names) - 1, 1)
        centre = np.array([x, -2.3 + 0.2 * (i % 3), 9.0], np.float32)
        corners = centre + np.array(
            [[-0.6, 0.4, -1], [0.6, 0.4, -1], [0.6, -0.4, -1], [-0.6, -0.4, -1]], np.float32
        )
        cameras.append(CameraPose(name, centre, corners, picture=_facade_from(centre)))
    return cameras


def _facade_from(centre: NDArray[np.float32]) -> Picture:
    """What such a camera sees of the plane of the facade, grey beside it."""
    picture = facade_picture(1200, 800)
    x, y = centre[0] + 5.4 * np.linspace(-1, 1, 480), centre[1] + 3.6 * np.linspace(1, -1, 320)
    u, v = (x + 6) / 12, (4 - y) / 8
    inside = ((u >= 0) & (u <= 1))[None, :] & ((v >= 0) & (v <= 1))[:, None]
    columns, rows = (np.clip(u, 0, 1) * 1199).astype(int), (np.clip(v, 0, 1) * 799).astype(int)
    seen = np.where(inside[..., None], picture[rows[:, None], columns[None, :]], 128)
    return coded(as_bytes(seen), "a photograph")


def facade_lens(hostile: str, by: str) -> dict[str, Any]:
    """A camera as in a summary; `hostile` stands in what EXIF says of it."""
    parameters = {"f": 1210.4, "cx": 498.2, "cy": 331.7, "k": -0.11}
    return {
        "model": "SIMPLE_RADIAL",
        "width": 1000,
        "height": 667,
        "photographs": 12,
        "by": by,
        "parameters": parameters,
        "standard_deviations": {"f": 0.9, "cx": 4.1, "cy": 2.8, "k": 0.0012} if by == "calibration" else None,
        "doubtful": [],
        "exif": {
            "make": f"NIKON{hostile}",
            "model": f"D850{hostile}",
            "focal_length_mm": 35.0,
            "focal_length_35mm": 35.0,
        },
    }


def synthetic_contents(points: int = 20_000, photographs: int = 24, hostile: str = "") -> Contents:
    """A whole page. `hostile` stands in every text that a user gives."""
    names = [f"{hostile}DSC_{4100 + i}.NEF" for i in range(photographs)]
    set_of = [
        PhotographEntry(
            name,
            coded(facade_picture(180, 120, 0.05 * i), f"{name}"),
            *((900 + 37 * i, 0.41, 0.5) if i != 7 else (0, None, None, f"{hostile}no overlap with others")),
        )
        for i, name in enumerate(names)
    ]
    near = np.abs(np.subtract.outer(np.arange(photographs), np.arange(photographs)))
    matches = np.where(near < 6, 900 // (1 + near), 0).astype(np.int64)
    if photographs > 7:
        matches[7], matches[:, 7] = 0, 0
    one = facade_picture(960, 640)
    chosen, rec709 = grey_of(one, _WEIGHTS), pictures.rec709(one)
    tones = [np.bincount(grey.ravel(), minlength=256) / grey.size for grey in (chosen, rec709)]
    patchwork = np.concatenate([facade_picture(240, 160, 0.2 * i) for i in range(4)], axis=1)
    sliders = [
        Slider(
            f"{hostile}DSC_{4100 + i}.NEF",
            coded(one, "The photograph in colour"),
            coded(chosen, "The photograph in the chosen grey"),
            coded(rec709, "The photograph in Rec.709"),
            coded(pictures.difference(chosen, rec709), "The difference of both greys"),
        )
        for i in range(3)
    ]
    pairs = [Pair(names[i], names[i + 1], _pair(chosen, 812 + i), _pair(rec709, 640 + i)) for i in range(2)]
    return Contents(
        title=f"{hostile}Priory of Saint-Cosme, west front",
        result=f"{hostile}A dense cloud of 812,400 points from 23 of 24 photographs, mean error 0.46 px.",
        rows=[
            (f"{hostile}photographs", f"24, 1 left out{hostile}"),
            ("registered images", "23 of 24"),
            ("points", "18,412"),
        ],
        grey=Grey(
            f"decolorize{hostile}",
            _WEIGHTS,
            f"{hostile}Grey is 61 % red, 34 % green, 5 % blue.",
            f"{hostile}Measured on six pairs of the set: 18 % more verified matches than with COLMAP's default grey.",
            tuple(map(float, tones[0])),
            tuple(map(float, tones[1])),
            coded(patchwork, "Four photographs of the set in colour"),
            coded(grey_of(patchwork, _WEIGHTS), "The same photographs in grey"),
        ),
        photographs=set_of,
        cloud=facade_cloud(points),
        surface=facade_surface(),
        frame=ModelFrame(np.diag([1.0, -1.0, -1.0]), np.array([10.0, 20.0, 30.0])),
        cameras=facade_cameras(names),
        lenses=[facade_lens(hostile, by) for by in ("calibration", "calibration", "colmap")],
        calibration=f"{hostile}Points that the calibration did not see are off by 0.38 px in the median.",
        sliders=sliders,
        pairs=pairs,
        points_by_images={2: 9120, 3: 4210, 4: 2310, 5: 1200, 6: 730, 7: 402, 8: 210, 9: 120, 11: 31},
        matches=matches,
        warnings=[f"{hostile}Two photographs are much darker than the others: DSC_4112.NEF, DSC_4113.NEF."],
        seconds={"captures": 12.1, "fit": 6.4, "features": 31.2, "matches": 44.8, "dense": 812.5},
        versions={"colmap-ihe": "0.1.0", "pycolmap": "4.2.0", f"opencv{hostile}": "5.0.0"},
        options=f"fit:\n  method: decolorize{hostile}\n  step: 0.01\ndense:\n  max_image_size: 2000\n",
        methods_sentence=f"{hostile}Photographs were made grey with one set of weights, fitted to the whole set.",
        block=_block(names, hostile),
        drawings=[
            Drawing(
                f"{hostile}north {number}",
                [(f"{hostile}sheets", f"1:50, A3{hostile}")],
                [
                    coded(facade_picture(60, 40), f"{hostile}orthophoto"),
                    coded(facade_picture(30, 20), "relief"),
                ],
                [FileLink(f"{hostile}sheets (PDF)", "../drawings/north/sheets.pdf")],
            )
            for number in range(2)
        ],
        citation=f"{hostile}A. Author, B. Author (2025). One grey for a whole set. Journal of Surveying 12, 3.",
    )


def _block(names: list[str], hostile: str) -> SurveyBlock:
    """A wall of 30 by 20 places that fewer photographs see at its sides, and a row of cameras."""
    cells = np.stack([n.ravel() for n in np.meshgrid(np.arange(30), np.arange(20), indexing="ij")], axis=1)
    seen = np.minimum(cells[:, 0], 29 - cells[:, 0]) + 1
    centres = np.stack([np.linspace(0, 12, len(names)), np.full(len(names), -9.0)], axis=1)
    return SurveyBlock(
        Verdict(
            "fair",
            "This model is usable, with care.",
            f"It is sound{hostile}.",
            [f"add {hostile}photographs"],
        ),
        [("photographs", f"23 registered of 24{hostile}"), (f"taken{hostile}", "2026-05-01")],
        [OverlapMap("from the front", cells, seen, seen == 3)],
        "0.41 m",
        CameraPlan(
            "from above",
            cells.astype(np.float64) * 0.4,
            0.4,
            centres,
            np.tile((0.0, 1.0), (len(names), 1)),
            names,
        ),
        [Residuals(f"points{hostile}", [50, 30, 15, 5], 0.2, 0.2, 0.55)],
    )


def _pair(grey: NDArray[np.uint8], matches: int) -> Picture:
    draw = np.random.default_rng(matches)
    places = draw.uniform([20, 120], [940, 620], (matches // 8, 2))
    drawn = pictures.matches_drawn(grey, grey, places, places + 2)
    return coded(drawn, f"Two photographs with {matches} matches drawn")
