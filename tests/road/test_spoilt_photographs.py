"""Photographs, masks, what they say of themselves and what a decoder answers of them, spoilt."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from io import BytesIO
from mmap import ACCESS_COPY, mmap
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import tifffile
from dngs import write_kind
from exif_samples import GPS, IMAGE, SHOT
from exif_samples import cr3 as cr3_sample
from PIL import Image, ImageCms
from spoilt import BYTES, JSON, file, parser

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.child_process import Channel
from colmap_ihe.machine.decoder_process import Decoder
from colmap_ihe.machine.decoder_wire import SharedArrayReader, receive
from colmap_ihe.photographs.coded import read_coded
from colmap_ihe.photographs.decode import read_photograph, read_size
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.encode import encode_image
from colmap_ihe.photographs.exif import cr3
from colmap_ihe.photographs.exif.blocks import PREFIX, for_tiff, put_together
from colmap_ihe.photographs.exif.metadata import Metadata, decode_metadata, read_metadata, sized
from colmap_ihe.photographs.known_cameras import filled_in
from colmap_ihe.photographs.linear_tiff import encode_linear_tiff
from colmap_ihe.photographs.preview import small_picture
from colmap_ihe.photographs.raw.dng_black import black_plane
from colmap_ihe.pipeline.masks import write_masks
from colmap_ihe.project.options import CamerasOptions, KnownCamera

pytestmark = pytest.mark.filterwarnings("ignore")


def _saved(image: Image.Image, kind: str, **options: Any) -> bytes:
    buffer = BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def masks(_: Path) -> list[bytes]:
    mask = Image.fromarray(np.eye(16, 24, dtype=np.uint8) * 255)
    return [_saved(mask, kind) for kind in ("PNG", "PNG", "JPEG", "TIFF", "BMP")]


@parser(masks, BYTES, share=0.5)
def test_masks(data: bytes, folder: Path) -> object:
    (folder / "grey").mkdir()
    (folder / "masks").mkdir()
    Image.new("L", (24, 16)).save(folder / "grey/a.png")
    (folder / "masks/a.jpg.png").write_bytes(data)
    return write_masks(folder / "masks", {"a.jpg": "a.png"}, folder / "grey", folder / "made")


EXIF = put_together(IMAGE, SHOT, GPS)


def _jpeg_with(exif: bytes = b"", profile: bytes = b"", mode: str = "RGB") -> bytes:
    return _saved(Image.new(mode, (8, 8)), "JPEG", exif=exif and PREFIX + exif, icc_profile=profile)


_KNOWN = CamerasOptions({"*": KnownCamera(focal_length=24.0, sensor_width=36.0, make="A", override=True)})


def _carried_over(path: Path) -> object:
    """EXIF of a photograph, into grey images and linear TIFFs. Nothing is refused: what is broken in it is left out."""
    found = decode_metadata(path, "coded")
    for metadata in (sized(found, 640, 480), filled_in(sized(found, 96, 64), _KNOWN, "a.jpg", 96, 64)):
        for how in ("png", "tiff", "jpeg"):
            Image.open(BytesIO(encode_image(np.zeros((4, 6), np.uint8), metadata.exif, how))).load()
        encode_linear_tiff(np.zeros((2, 3, 3), np.uint16), metadata.exif)
        json.dumps([metadata.make, metadata.model, metadata.lens, metadata.serial]).encode()
    return found


@parser(lambda _: [EXIF, EXIF[:14] + b"\xff" * 400], BYTES, refuses=(), share=0.5)
def test_exif(data: bytes, folder: Path) -> object:
    return file("a.jpg", _carried_over)(_jpeg_with(data[:60_000]), folder)


def photographs(_: Path) -> list[bytes]:
    small, exif, big_endian = Image.new("RGB", (8, 8)), for_tiff(EXIF), BytesIO()
    tifffile.imwrite(big_endian, np.zeros((8, 8, 3), np.uint16), byteorder=">", photometric="rgb")
    return [
        *(_jpeg_with(EXIF), _saved(small, "PNG", exif=exif), _saved(small, "TIFF", exif=exif)),
        *(_saved(small, "TIFF", compression="tiff_lzw"), big_endian.getvalue()),
    ]


@parser(photographs, BYTES, refuses=(), share=0.5)
def test_headers(data: bytes, folder: Path) -> object:
    return file("a.tif" if data[:2] in (b"II", b"MM") else "a.jpg", _carried_over)(data, folder)


@parser(lambda _: [cr3_sample()], BYTES, refuses=())
def test_cr3(data: bytes, folder: Path) -> object:
    (folder / "a.cr3").write_bytes(data or b"\0")
    with (folder / "a.cr3").open("rb") as handle, mmap(handle.fileno(), 0, access=ACCESS_COPY) as file:
        blocks = cr3.blocks_of(file)
    return blocks, decode_metadata(folder / "a.cr3", "raw")


def dngs(folder: Path) -> list[bytes]:
    samples, zeros, pattern = [], np.zeros((16, 24), np.uint16), np.array([["R", "G"], ["G", "B"]])
    for name, count in (("delta_h", 24), ("delta_v", 16)):
        delta: dict[str, Any] = {name: np.arange(float(count))}
        write_kind(folder / "a.dng", zeros, pattern=pattern, black=(9,) * 4, repeat=(2, 2), **delta)
        samples.append((folder / "a.dng").read_bytes())
    return samples


test_black_levels_of_dng = parser(dngs, BYTES, refuses=())(
    file("a.dng", lambda dng: black_plane(dng, (16, 24)))
)


def profiles(_: Path) -> list[bytes]:
    return [ImageCms.ImageCmsProfile(ImageCms.createProfile(kind)).tobytes() for kind in ("sRGB", "LAB")]


@parser(profiles, BYTES, refuses=())
def test_icc_profiles(data: bytes, folder: Path) -> object:
    """Of RGB, where nothing is refused for its profile, and of CMYK, where it is needed."""
    for mode in ("RGB", "CMYK"):
        (folder / f"{mode}.jpg").write_bytes(_jpeg_with(profile=data, mode=mode))
        decode_metadata(folder / f"{mode}.jpg", "coded")
    with contextlib.suppress(PhotographError):
        read_coded(folder / "CMYK.jpg", lambda *_: None)
    return read_coded(folder / "RGB.jpg", lambda *_: None)


_ARRAY = {"shape": [2, 3, 3], "dtype": "uint8"}
_PHOTOGRAPH = {"rgb": 0, "encoding": "coded", "srgb_from_camera": None, "profile": "aGk="}


def answers(_: Path) -> list[bytes]:
    """What a decoder answers; the length in front is put there by `framed`."""
    answers: list[Any] = [
        {"value": [96, 64, ""]},
        {"value": _PHOTOGRAPH, "arrays": [_ARRAY], "is_new": False},
        {"value": asdict(Metadata(make="Canon")) | {"exif": ""}},
        {"error": "PhotographError", "message": "a.jpg: broken", "hint": "x"},
    ]
    return [json.dumps(answer).encode() for answer in answers]


def framed(data: bytes, rng: Random) -> bytes:
    return struct.pack(">I", rng.choice((len(data),) * 9 + (0, 1, len(data) + 1, (1 << 32) - 1))) + data


@contextlib.contextmanager
def answering(answer: Any) -> Iterator[None]:
    """Within, whatever is asked of a decoder has this answer: one that a photograph took over says anything."""

    def ask(*_: object) -> Any:
        return answer, [np.zeros((2, 3, 3), np.uint8)]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Decoder, "ask", ask)
        yield


def _sent(to: socket.socket, data: bytes) -> None:
    with contextlib.suppress(OSError):
        to.sendall(data)
        to.shutdown(socket.SHUT_WR)


@parser(answers, JSON, refuses=(ValueError, OSError), seal=framed)
def test_answers_of_a_decoder(data: bytes, folder: Path) -> object:
    ours, theirs = socket.socketpair()
    with ThreadPoolExecutor(1) as thread, theirs, Channel(ours.detach()) as channel:
        thread.submit(_sent, theirs, data)
        received = receive(channel)
    if received is None:
        return None
    answer, window = received[0], SharedArrayReader()
    with contextlib.suppress(ValueError, LookupError, TypeError, OverflowError):
        window.arrays(answer, None)
    capture = Capture("a.jpg", folder / "a.jpg", "coded", "a")
    with answering(answer):
        for ask in (
            lambda: read_size(capture),
            lambda: read_photograph(capture),
            lambda: read_metadata(capture.path, "coded"),
            lambda: small_picture(capture, 64),
        ):
            with contextlib.suppress(PhotographError):
                ask()
    return answer


@pytest.mark.parametrize(
    "value", [5, None, [1], {"encoding": "coded", "matrix": None, "profile": 10**12}, {"exif": 3}]
)
def test_an_answer_that_makes_no_sense_is_its_photographs_fault(tmp_path: Path, value: object) -> None:
    """A decoder that a photograph took over says anything."""
    capture = Capture("a.jpg", tmp_path / "a.jpg", "coded", "a")
    with answering({"value": value}):
        for ask in (read_size, read_photograph):
            with pytest.raises(PhotographError, match=r"a.jpg: the decoder lost its way on it"):
                ask(capture)
        assert "lost its way" in read_metadata(capture.path, "coded").problem
