"""Every kind of photograph to the pixels it holds, and every broken one to a line that names it."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pytest
import tifffile
from bombs import png_of
from numpy.typing import NDArray
from PIL import Image

from colmap_ihe.errors import PhotographError
from colmap_ihe.photographs.decode import PhotographHeader, read_photograph, read_size
from colmap_ihe.photographs.discover import Capture, discover
from colmap_ihe.photographs.exif.metadata import read_metadata
from colmap_ihe.photographs.png import encode_png

HEIGHT, WIDTH = 72, 100


def smooth() -> NDArray[np.uint8]:
    """(72, 100, 3): smooth, so that JPEG changes it little, and another in each channel and corner."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    rgb: NDArray[np.uint8] = np.dstack([40 + 2 * x, 20 + 3 * y, 230 - x - y]).clip(0, 255).astype(np.uint8)
    return rgb


def deep() -> NDArray[np.uint16]:
    return (smooth().astype(np.uint32) * 257 + np.arange(WIDTH)[None, :, None] % 100).astype(np.uint16)


def capture_of(file: Path) -> Capture:
    (capture,) = [c for c in discover(file.parent).captures if c.path == file]
    return capture


def read(file: Path) -> NDArray[Any]:
    capture = capture_of(file)
    photograph = read_photograph(capture)
    assert photograph.encoding == "coded"
    assert photograph.srgb_from_camera is None
    assert read_size(capture) == PhotographHeader(*photograph.rgb.shape[1::-1])
    return photograph.rgb


def refused(file: Path) -> str:
    """What reading says, wherever it is noticed; it must name the file and what to do."""
    with pytest.raises(PhotographError) as caught:
        read_photograph(capture_of(file))
    assert file.name in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.hint
    return str(caught.value)


def write_16_bit_png(file: Path, pixels: NDArray[np.uint16]) -> None:
    """By the specification, with the standard library: neither of the package's writers nor readers."""
    height, width = pixels.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in pixels.astype(">u2"))
    file.write_bytes(png_of(width, height, rows=rows, depth=16, colour=2 if pixels.ndim == 3 else 0))


ROUNDED = np.rint(deep() / 257).astype(np.uint8)


def in_three(grey: NDArray[Any]) -> NDArray[Any]:
    return np.repeat(grey[..., None], 3, axis=2)


def alpha(image: Image.Image) -> Image.Image:
    """With colours under transparent pixels, which are as stored: masks are what leaves a part out."""
    image.putalpha(Image.fromarray((np.arange(WIDTH) * 2 % 256 * np.ones((HEIGHT, 1))).astype(np.uint8)))
    return image


def colours_of(palette: Image.Image) -> NDArray[Any]:
    return np.asarray(np.array(palette.getpalette(), np.uint8).reshape(-1, 3)[np.asarray(palette)])


def tiff(pixels: NDArray[Any], **more: Any) -> Callable[[Path], Any]:
    return lambda file: tifffile.imwrite(file, pixels, **more)


PICTURE = Image.fromarray(smooth())
GREY, PALETTE, BITS = PICTURE.getchannel("G"), PICTURE.quantize(16), PICTURE.convert("1")
EXPECTED: tuple[tuple[str, Callable[[Path], None], NDArray[Any]], ...] = (
    ("tiff", PICTURE.save, smooth()),
    ("tif", partial(PICTURE.save, compression="tiff_lzw"), smooth()),
    ("tif", partial(PICTURE.save, compression="tiff_deflate"), smooth()),
    ("png", partial(PALETTE.save, transparency=3), colours_of(PALETTE)),
    ("png", PALETTE.save, colours_of(PALETTE)),
    *((s, image.save, expected)
      for s in ("png", "tif")
      for image, expected in (
          (PICTURE, smooth()),
          (GREY, in_three(smooth()[..., 1])),
          (BITS, in_three(np.asarray(BITS) * np.uint8(255))),
          (alpha(GREY.convert("LA")), in_three(smooth()[..., 1])),
          (alpha(PICTURE.convert("RGBA")), smooth()),
      )),
    ("png", lambda file: write_16_bit_png(file, deep()), ROUNDED),
    ("tif", tiff(deep(), photometric="rgb"), ROUNDED),
    ("tiff", tiff(deep(), photometric="rgb", compression="zlib", predictor=True), ROUNDED),
    ("png", lambda file: write_16_bit_png(file, deep()[..., 1]), in_three(ROUNDED[..., 1])),
    ("tif", tiff(deep()[..., 1], photometric="minisblack"), in_three(ROUNDED[..., 1])),
    ("tif", tiff(deep(), photometric="rgb", extratags=[(274, 3, 1, 6, True)]), ROUNDED),  # turned
    ("tif", tiff(np.dstack([deep(), deep()[..., :1] // 2]), photometric="rgb", extrasamples=["unassalpha"]), ROUNDED),
    *(("tif", tiff(np.moveaxis(pixels, 2, 0), photometric="rgb", planarconfig="separate"), ROUNDED)
      for pixels in (smooth(), deep())),
    *(("tif", tiff(grey, photometric="miniswhite"), in_three(255 - smooth()[..., 1]))
      for grey in (smooth()[..., 1], smooth()[..., 1].astype(np.uint16) * 257)),
)  # fmt: skip


@pytest.mark.parametrize(("suffix", "write", "expected"), EXPECTED)
def test_what_loses_nothing_is_read_to_the_letter_and_16_bits_rounded(
    tmp_path: Path, suffix: str, write: Callable[[Path], None], expected: NDArray[Any]
) -> None:
    write(tmp_path / f"a.{suffix}")
    rgb = read(tmp_path / f"a.{suffix}")
    assert rgb.dtype == np.uint8
    np.testing.assert_array_equal(rgb, expected)


@pytest.mark.parametrize(("image", "expected"), [(PICTURE, smooth()), (GREY, in_three(smooth()[..., 1]))])
def test_a_jpeg_is_read_in_red_green_blue_order(
    tmp_path: Path, image: Image.Image, expected: NDArray[Any]
) -> None:
    image.save(tmp_path / "a.jpg", quality=98, subsampling=0)
    rgb = read(tmp_path / "a.jpg").astype(int)
    assert np.abs(rgb - expected).max() <= 6
    assert np.ptp(rgb, axis=2).max() == 0 or image.mode != "L"


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_the_orientation_tag_is_not_applied(tmp_path: Path, suffix: str, orientation: int) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    options: dict[str, Any] = {"quality": 98, "subsampling": 0} if suffix == "jpg" else {}
    Image.fromarray(smooth()).save(tmp_path / f"a.{suffix}", exif=exif, **options)
    assert np.abs(read(tmp_path / f"a.{suffix}").astype(int) - smooth()).max() <= 6


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif", "lzw.tif", "deep.png", "deep.tif"])
@pytest.mark.parametrize("share", [0.95, 0.5, 0.02])
@pytest.mark.filterwarnings("ignore:Corrupt EXIF data:UserWarning")  # Pillow's, beside the error
def test_a_truncated_file_is_refused(tmp_path: Path, name: str, share: float) -> None:
    rng = np.random.default_rng(1)  # noise, so that the pixels are most of the file
    noise = rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    if name == "deep.png":
        write_16_bit_png(tmp_path / name, noise.astype(np.uint16) * 257 + 5)
    elif name == "deep.tif":
        tifffile.imwrite(tmp_path / name, noise.astype(np.uint16) * 257, photometric="rgb")
    else:
        Image.fromarray(noise).save(tmp_path / name, **({"compression": "tiff_lzw"} if "lzw" in name else {}))
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
    assert "cannot be read" in refused(tmp_path / name)


NOTES = b"this is no photograph\n" * 300
NOISE = np.random.default_rng(1).integers(0, 256, 5000, np.uint8).tobytes()


@pytest.mark.parametrize(
    ("names", "content", "reason"),
    [
        ("notes.jpg notes.png notes.tif", NOTES, "not a photograph of the kind its name says"),
        ("empty.jpg empty.png empty.tif empty.dng", b"", ""),
        ("noise.dng noise.nef noise.CR3", NOISE, "LibRaw cannot read this RAW file"),
        ("text.raf", b"no RAW" * 900, "LibRaw cannot read this RAW file"),
    ],
)
def test_what_is_no_photograph_is_refused(tmp_path: Path, names: str, content: bytes, reason: str) -> None:
    for name in names.split():
        (tmp_path / name).write_bytes(content)
        assert reason in refused(tmp_path / name)
        (tmp_path / name).unlink()


@pytest.mark.parametrize("size", [(63, 100), (100, 63), (1, 1)])
def test_a_photograph_too_small_is_refused_with_its_size(tmp_path: Path, size: tuple[int, int]) -> None:
    Image.new("RGB", size).save(tmp_path / "small.png")
    assert f"{size[0]}x{size[1]} pixels, expected at least 64" in refused(tmp_path / "small.png")
    with pytest.raises(PhotographError, match="expected at least 64"):
        read_size(capture_of(tmp_path / "small.png"))


def test_64_pixels_are_enough(tmp_path: Path) -> None:
    Image.new("RGB", (64, 64), (1, 2, 3)).save(tmp_path / "a.png")
    assert read(tmp_path / "a.png").tolist() == [[[1, 2, 3]] * 64] * 64


@pytest.mark.parametrize("shape", [(80, 80, 3), (80, 80)])
@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int16, np.int32, np.uint32])
def test_floating_point_signed_and_32_bit_pixels_are_refused(
    tmp_path: Path, shape: tuple[int, ...], dtype: type
) -> None:
    """Also those in 0..1: nothing says whether they are linear or coded."""
    for value in (0.5, 200.0, np.nan, np.inf) if issubclass(dtype, np.floating) else (1,):
        pixels: NDArray[Any] = np.full(shape, value, dtype)
        tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="rgb" if len(shape) == 3 else "minisblack")
        assert "expected 8 or 16 bit integers" in refused(tmp_path / "a.tif")


@pytest.mark.parametrize("depth", [8, 16])
@pytest.mark.parametrize("orientation", [1, 6])
def test_of_several_pages_the_first_is_read(tmp_path: Path, depth: int, orientation: int) -> None:
    pixels = smooth() if depth == 8 else deep()
    tags = [(274, 3, 1, orientation, True)]
    tifffile.imwrite(tmp_path / "a.tif", np.stack([pixels, pixels[::-1]]), photometric="rgb", extratags=tags)
    np.testing.assert_array_equal(read(tmp_path / "a.tif"), np.rint(deep() / 257).astype(np.uint8))
    assert read_metadata(tmp_path / "a.tif", "coded").pages == 2


def test_a_file_that_may_not_be_read_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").symlink_to(tmp_path / "gone")
    with pytest.raises(PhotographError, match=r"a.jpg: cannot be read"):
        read_photograph(Capture("a.jpg", tmp_path / "a.jpg", "coded", "a"))


@pytest.mark.parametrize("shape", [(70, 90), (70, 90, 3), (1, 1), (65, 64, 3), (65, 64, 4)])
@pytest.mark.parametrize("content", ["noise", "smooth", "flat", "not contiguous"])
def test_the_png_writer_against_pillow(tmp_path: Path, shape: tuple[int, ...], content: str) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (*shape[:1], 3 * shape[1], *shape[2:]), np.uint8)
    pixels = {
        "noise": noise[:, : shape[1]].copy(),
        "smooth": (np.arange(np.prod(shape)) // 7 % 256).astype(np.uint8).reshape(shape),
        "flat": np.full(shape, 255, np.uint8),
        "not contiguous": noise[::-1, ::-3],
    }[content]
    exif = Image.Exif()
    exif[0x0110] = "A camera"
    (tmp_path / "a.png").write_bytes(encode_png(pixels, exif.tobytes().removeprefix(b"Exif\0\0")))
    with Image.open(tmp_path / "a.png") as image:
        image.verify()  # the checksums
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == {1: "L", 3: "RGB", 4: "RGBA"}[pixels[0, 0].size]
        np.testing.assert_array_equal(np.asarray(image), pixels)
        assert image.getexif()[0x0110] == "A camera"


@pytest.mark.parametrize(
    "pixels", [np.zeros((4, 4), np.uint16), np.zeros((4, 4, 5), np.uint8), np.zeros(4, np.uint8)]
)
def test_the_png_writer_refuses_what_it_cannot_write(pixels: NDArray[Any]) -> None:
    with pytest.raises(ValueError, match=r"expected \(H, W\), .* or \(H, W, 4\) uint8"):
        encode_png(pixels)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_compressed_16_bit_tiff_is_read_as_stored_however_it_is_turned(
    tmp_path: Path, orientation: int
) -> None:
    """Compressed by LZW, as photo editors do."""
    file = tmp_path / "a.tif"
    cv2.imwrite(str(file), deep()[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    with tifffile.TiffFile(file) as tiff:
        assert tiff.pages.first.compression == 5
        (place,) = (
            t.offset for t in tiff.pages.first.tags if t.code == 284
        )  # of planes, which are 1 by default
    data = bytearray(file.read_bytes())
    data[place : place + 12] = struct.pack("<HHLHH", 274, 3, 1, orientation, 0)
    file.write_bytes(data)
    np.testing.assert_array_equal(read(file), ROUNDED)


@pytest.mark.parametrize("byteorder", ["<", ">"])
@pytest.mark.parametrize("bigtiff", [False, True])
def test_16_bit_tiffs_of_each_order_and_size(
    tmp_path: Path, byteorder: Literal["<", ">"], bigtiff: bool
) -> None:
    tags = [(274, 3, 1, 6, True)]
    file = tmp_path / "a.tif"
    tifffile.imwrite(file, deep(), photometric="rgb", byteorder=byteorder, bigtiff=bigtiff, extratags=tags)
    if bigtiff and byteorder == ">":
        assert refused(file) == "a.tif: is a big-endian BigTIFF"
    else:
        np.testing.assert_array_equal(read(file), ROUNDED)


def test_additional_channels_are_named(tmp_path: Path) -> None:
    channels = np.dstack([deep(), deep()[..., :2]])
    tifffile.imwrite(tmp_path / "a.tif", channels, photometric="rgb", extrasamples=[0, 0])
    assert refused(tmp_path / "a.tif").startswith(
        "a.tif: holds 5 channels of 16 bit; expected grey, RGB, RGBA"
    )


@pytest.mark.parametrize("behind", [False, True])
def test_text_costs_a_png_neither_pixels_nor_exif(tmp_path: Path, behind: bool) -> None:
    exif = Image.Exif()
    exif[0x0110] = "A camera"
    file = tmp_path / "a.png"
    Image.fromarray(smooth()).save(file, exif=exif.tobytes())
    text = b"x\0\0" + zlib.compress(b"y" * 2_000_000)
    chunk = len(text).to_bytes(4, "big") + b"zTXt" + text + zlib.crc32(b"zTXt" + text).to_bytes(4, "big")
    whole = file.read_bytes()
    at = whole.index(b"IEND") - 4 if behind else 33
    file.write_bytes(whole[:at] + chunk + whole[at:])
    np.testing.assert_array_equal(read(file), smooth())
    assert read_metadata(file, "coded").model == "A camera"


@pytest.mark.parametrize("planes", [2, 0])
def test_a_tiff_without_some_of_its_planes_is_refused(tmp_path: Path, planes: int) -> None:
    """Not filled up with what happened to be in memory."""
    file = tmp_path / "a.tif"
    tifffile.imwrite(file, deep(), photometric="rgb", compression="zlib")
    with tifffile.TiffFile(file, mode="r+") as tiff:
        tiff.pages.first.tags["PlanarConfiguration"].overwrite(planes)
    assert "some of its pixels are missing" in refused(file)


def test_a_jpeg_with_lost_pixels_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.jpg"
    Image.fromarray(smooth()).save(file, progressive=True)
    data = bytearray(file.read_bytes())
    scan = data.rindex(b"\xff\xda") + 12
    data[scan : scan + 40] = b"\xff\x00" * 20  # no Huffman code is all ones
    file.write_bytes(data)
    assert "JPEG data" in refused(file)
