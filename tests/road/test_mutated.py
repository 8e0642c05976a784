"""Two hundred broken photographs among sound ones: each is named and left out, or converted; the run goes on.

What cannot be noticed is a changed value in pixels that nothing guards: those of RAW, TIFF and JPEG mostly. So a
file with flipped bytes may be converted, to the size that its header says; a truncated one may not.
"""

from __future__ import annotations

import json
import random
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from bombs import HUGE, chunk, png_of, with_sides
from PIL import Image, ImageCms
from small_demo import PHOTOGRAPHS
from spoilt import Mutation, flipped, replaced

from colmap_ihe.evaluation.demo.dng import write_dng
from colmap_ihe.evaluation.demo.exif import PhotoExif
from colmap_ihe.photographs.discover import RAW_SUFFIXES

MUTATED = 200
HEIGHT, WIDTH = 96, 128
MEGABYTE = 1 << 20

RUN = """
import json, resource, sys
from pathlib import Path
from colmap_ihe import convert_folder
from colmap_ihe.machine import decoder_pool as decoders
from colmap_ihe.project.options import FitOptions
# A fit would measure contrast in some of the photographs only, and in others where some are left out.
_, grey, left_out = convert_folder(Path(sys.argv[1]), Path(sys.argv[2]), fit=FitOptions(method="rec709"))
decoders.end_idle()
decoders_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss // 1024
(peak,) = [line for line in open("/proc/self/status") if line.startswith("VmHWM")]  # ru_maxrss is pytest's too
run_mb = int(peak.split()[1]) // 1024
print(json.dumps({"grey": grey, "left_out": left_out, "run_mb": run_mb, "decoders_mb": decoders_mb}))
"""


@dataclass(frozen=True)
class Mutated:
    """`must_go`: it cannot be converted, whatever a decoder makes of it."""

    data: bytes
    how: str
    must_go: bool = False


def photographs(folder: Path) -> dict[str, bytes]:
    """Sound photographs of every kind, small."""
    noise = np.random.default_rng(4).normal(0, 5, (HEIGHT, WIDTH, 3))
    ramp = np.add.outer(np.arange(HEIGHT), np.arange(WIDTH))[..., None] * np.array((0.9, 1.0, 0.6))
    rgb = np.clip(ramp + noise, 0, 255).astype(np.uint8)
    deep = rgb.astype(np.uint16) * 257
    picture, exif = Image.fromarray(rgb), Image.Exif()
    exif[0x010F], exif[0x0110] = "Acme", "Camera"
    exif.get_ifd(0x8769)[0x920A] = 35.0
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    cmyk = picture.convert("CMYK")
    pictures: list[tuple[str, Image.Image, dict[str, Any]]] = [
        ("plain.jpg", picture, {"quality": 92, "exif": exif, "icc_profile": profile}),
        ("progressive.jpg", picture, {"progressive": True}),
        ("cmyk.jpg", cmyk, {}),
        ("plain.png", picture, {"exif": exif, "icc_profile": profile}),
        ("palette.png", picture.quantize(32), {}),
        ("grey16.png", Image.fromarray(deep[..., 0]), {}),
        ("plain.tif", picture, {"exif": exif}),
        ("lzw.tif", picture, {"compression": "tiff_lzw"}),
        ("jpeg.tif", picture, {"compression": "jpeg"}),
        ("cmyk.tif", cmyk, {"compression": "tiff_adobe_deflate"}),
    ]
    for name, image, how in pictures:
        image.save(folder / name, **how)
    deep_ways: dict[str, dict[str, Any]] = {
        "deep.tif": {"compression": "zlib"},
        "strips.tif": {"rowsperstrip": 16},
        "tiles.tif": {"compression": "zlib", "tile": (64, 64)},
        "planes.tif": {"planarconfig": "separate"},
    }
    for name, options in deep_ways.items():
        pixels = deep.transpose(2, 0, 1) if name == "planes.tif" else deep
        tifffile.imwrite(folder / name, pixels, photometric="rgb", **options)
    write_dng(
        folder / "mosaic.dng", rgb[..., 1].astype(np.uint16) * 40 + 600, black=512, white=16383,
        as_shot_neutral=(0.5, 1, 0.7), colour_matrix=np.eye(3), exif=PhotoExif(),
    )  # fmt: skip
    real = ("raw/colorchart.dng", "raw/kodak_dc50.kdc", "exif/Nikon_D70.jpg", "exif/Canon_40D.jpg")
    files = [*folder.iterdir(), *(PHOTOGRAPHS / name for name in real if (PHOTOGRAPHS / name).is_file())]
    return {file.name: file.read_bytes() for file in files}


def cut(data: bytes, rng: random.Random) -> bytes:
    return data[: int(len(data) * rng.uniform(0, 0.97))]


def header_bytes(data: bytes, rng: random.Random) -> bytes:
    return replaced(data[:600], rng) + data[600:]


def wrong_numbers(data: bytes, rng: random.Random) -> bytes:
    """Other numbers in a TIFF's first directory; elsewhere four bytes of the header."""
    changed = bytearray(data)
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    number = rng.choice((0, 1, 3, 255, 65535, 1 << 16, (1 << 31) - 1, 1 << 31, (1 << 32) - 1))
    if order:
        (place,) = struct.unpack_from(order + "I", data, 4)
        (count,) = struct.unpack_from(order + "H", data, place)
        struct.pack_into(order + "I", changed, place + 2 + 12 * rng.randrange(count) + 8, number)
    else:
        struct.pack_into(">I", changed, rng.randrange(min(len(data), 200)), number)
    return bytes(changed)


WAYS: dict[str, Mutation] = {"cut": cut, "header": header_bytes, "flipped": flipped, "numbers": wrong_numbers}


def bombs(sound: dict[str, bytes]) -> Iterator[tuple[str, Mutated]]:
    """Files that say that they are huge, or become so."""
    zeros = bytes(64 * MEGABYTE)
    rows = bytes(HEIGHT * (1 + 3 * WIDTH))
    yield "bomb.png", Mutated(png_of(HUGE, HUGE, rows=zeros), "bomb", must_go=True)
    yield "thin.png", Mutated(png_of(1 << 30, 64, rows=zeros), "bomb", must_go=True)
    yield "more.png", Mutated(png_of(WIDTH, HEIGHT, rows=rows + zeros), "bomb")
    texts = chunk(b"zTXt", b"a\0\0" + zlib.compress(zeros)), chunk(b"iCCP", b"a\0\0" + zlib.compress(zeros))
    yield "texts.png", Mutated(png_of(WIDTH, HEIGHT, *texts, rows=rows), "bomb")
    for name in ("plain.tif", "lzw.tif", "deep.tif", "tiles.tif", "planes.tif", "mosaic.dng"):
        stem, _, suffix = name.partition(".")
        huge = with_sides(sound[name], HUGE, HUGE)
        yield f"bomb-{stem}.{suffix}", Mutated(huge, "bomb", must_go=True)
        most = with_sides(sound[name], 0x7FFFFFFF, 0x7FFFFFFF)
        yield f"most-{stem}.{suffix}", Mutated(most, "bomb", must_go=True)
    # Below the limit of pixels, so that the header alone does not give it away.
    for name in ("plain.tif", "mosaic.dng"):
        lies = with_sides(sound[name], 20_000, 20_000)
        yield f"lies-{name}", Mutated(lies, "bomb", must_go=True)
    place = sound["plain.jpg"].index(b"\xff\xc0")
    huge_jpeg = bytearray(sound["plain.jpg"])
    struct.pack_into(">HH", huge_jpeg, place + 5, 65500, 65500)
    yield "bomb.jpg", Mutated(bytes(huge_jpeg), "bomb", must_go=True)


def mutate(sound: dict[str, bytes], count: int) -> dict[str, Mutated]:
    """`count` broken files by name; the same each time."""
    rng = random.Random(20)
    found = dict(bombs(sound))
    names = sorted(sound, key=lambda n: (len(sound[n]) > MEGABYTE, n))
    for number in range(len(found), count):
        name, how = names[number % len(names)], list(WAYS)[(number // len(names)) % len(WAYS)]
        found[f"{number:03}-{name}"] = Mutated(WAYS[how](sound[name], rng), how, must_go=how == "cut")
    return found


def of_its_own(name: str) -> str:
    """With a stem that no other has: beside a RAW of its stem a JPEG would not be read at all."""
    return name.replace(".", "-") + Path(name).suffix


def write(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


def converted(images: Path, out: Path) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(images), str(out)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    result: dict[str, Any] = json.loads(done.stdout)
    return result


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """One run over all, and one over what the first could use."""
    folder = tmp_path_factory.mktemp("mutated")
    sound = photographs(folder)
    broken = mutate(sound, MUTATED)
    good = {of_its_own(f"good-{name}"): data for name, data in sound.items()}
    about = {of_its_own(f"bad-{name}"): mutated for name, mutated in broken.items()}
    mixed = good | {name: mutated.data for name, mutated in about.items()}
    first = converted(write(folder / "mixed", mixed), folder / "grey")
    usable = {name: data for name, data in mixed.items() if name not in first["left_out"]}
    second = converted(write(folder / "usable", usable), folder / "grey-of-usable")
    return {"folder": folder, "good": good, "broken": about, "first": first, "second": second}


def test_every_file_is_named_and_left_out_or_converted(runs: dict[str, Any]) -> None:
    grey, left_out = runs["first"]["grey"], runs["first"]["left_out"]
    assert len(runs["broken"]) == MUTATED
    assert set(grey) | set(left_out) == set(runs["good"]) | set(runs["broken"])
    assert not set(grey) & set(left_out)
    assert set(runs["good"]) <= set(grey)
    for name, reason in left_out.items():
        assert name in reason
        assert len(reason) > len(name) + 20, reason
        assert "\n" not in reason
    print(f"{MUTATED} mutated: {len(left_out)} named and left out, {MUTATED - len(left_out)} converted")


def test_what_cannot_be_used_is_left_out(runs: dict[str, Any]) -> None:
    must_go = {name for name, m in runs["broken"].items() if m.must_go}
    assert len(must_go) > MUTATED / 4
    assert must_go <= set(runs["first"]["left_out"])


def test_what_was_converted_has_the_size_it_says(runs: dict[str, Any]) -> None:
    """Of a photograph whose header was not touched, that of the photograph."""
    sizes = {}
    for name, grey in runs["first"]["grey"].items():
        with Image.open(runs["folder"] / "grey" / grey) as image:
            image.load()
            sizes[name] = image.size
    for name, mutated in runs["broken"].items():
        if mutated.how == "bomb" and name in sizes:
            assert sizes[name] == (WIDTH, HEIGHT)
    assert all(min(size) >= 64 for size in sizes.values())


def test_broken_files_change_nothing_for_the_others(runs: dict[str, Any]) -> None:
    assert runs["second"]["left_out"] == {}
    assert runs["second"]["grey"] == runs["first"]["grey"]
    for grey in runs["second"]["grey"].values():
        alone = (runs["folder"] / "grey-of-usable" / grey).read_bytes()
        assert alone == (runs["folder"] / "grey" / grey).read_bytes(), grey


def test_memory_stays_bounded(runs: dict[str, Any]) -> None:
    print(f"memory of the run {runs['first']['run_mb']} MB, of a decoder {runs['first']['decoders_mb']} MB")
    assert runs["first"]["decoders_mb"] < 500
    assert runs["first"]["run_mb"] < 600


def test_every_way_and_kind_was_tried(runs: dict[str, Any]) -> None:
    tried = {(m.how, Path(name).suffix in RAW_SUFFIXES) for name, m in runs["broken"].items()}
    assert tried == {(how, raw) for how in ("cut", "header", "flipped", "numbers", "bomb") for raw in (0, 1)}
