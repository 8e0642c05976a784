"""Parsers of photographs, masks and what they say of themselves, and of what a decoder answers."""

from __future__ import annotations

import contextlib
import json
import random
import socket
import struct
import threading
from dataclasses import asdict
from io import BytesIO
from mmap import ACCESS_COPY, mmap
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from fuzz_mutations import BYTES, JSON, Target
from PIL import Image, ImageCms
from PIL.TiffImagePlugin import IFDRational

import colmap_ihe  # noqa: F401  before pycolmap
from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.decoder_process import Decoder
from colmap_ihe.machine.decoder_wire import SharedArrayReader, receive
from colmap_ihe.photographs.coded import read_coded
from colmap_ihe.photographs.decode import read_photograph, read_size
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.encode import encode_image
from colmap_ihe.photographs.exif import cr3
from colmap_ihe.photographs.exif.blocks import for_tiff, put_together
from colmap_ihe.photographs.exif.metadata import Metadata, decode_metadata, read_metadata, sized
from colmap_ihe.photographs.known_cameras import filled_in
from colmap_ihe.photographs.linear_tiff import encode_linear_tiff
from colmap_ihe.photographs.preview import small_picture
from colmap_ihe.photographs.raw.dng_black import black_plane
from colmap_ihe.pipeline.convert import write_masks
from colmap_ihe.project.options import CamerasOptions, KnownCamera


def _mask_samples() -> list[bytes]:
    found = []
    for how in ("PNG", "JPEG", "TIFF", "BMP"):
        buffer = BytesIO()
        Image.fromarray(np.eye(16, 24, dtype=np.uint8) * 255).save(buffer, how)
        found.append(buffer.getvalue())
    return [found[0], *found]


def _mask(data: bytes, folder: Path) -> object:
    (folder / "grey").mkdir()
    (folder / "masks").mkdir()
    Image.new("L", (24, 16)).save(folder / "grey/a.png")
    (folder / "masks/a.jpg.png").write_bytes(data)
    return write_masks(folder / "masks", {"a.jpg": "a.png"}, folder / "grey", folder / "made")


def exif_block() -> bytes:
    """With text, numbers, fractions and a maker note in three directories."""
    shot = {
        0x829A: IFDRational(1, 125),
        0x8827: 200,
        0x9003: "2016:06:21 10:00:00",
        0x920A: IFDRational(24),
        0xA405: 24,
    }
    shot |= {0xA002: 96, 0xA003: 64, 0xA20E: IFDRational(9600, 36), 0xA20F: IFDRational(6400, 24), 0xA210: 3}
    shot |= {0x927C: b"Canon" + bytes(range(60)), 0xA434: "EF 24-70", 0xA432: (IFDRational(24),) * 4}
    gps = {
        1: "N",
        2: (IFDRational(48),) * 3,
        3: "E",
        4: (IFDRational(2),) * 3,
        5: b"\0",
        6: IFDRational(855, 10),
    }
    return put_together(
        {0x010E: "portal", 0x010F: "Canon", 0x0110: "EOS", 0x0112: 6, 0x8298: "CC0"}, shot, gps
    )


def jpeg_with(exif: bytes = b"", profile: bytes = b"", mode: str = "RGB") -> bytes:
    buffer = BytesIO()
    Image.new(mode, (8, 8)).save(
        buffer, "JPEG", exif=b"Exif\0\0" + exif if exif else b"", icc_profile=profile
    )
    return buffer.getvalue()


_KNOWN = CamerasOptions({"*": KnownCamera(focal_length=24.0, sensor_width=36.0, make="A", override=True)})


def _said(path: Path, kind: str) -> object:
    """EXIF of a photograph, all the way into grey images and linear TIFFs. Nothing is refused here: what is broken in
    it is left out."""
    found = decode_metadata(path, kind)
    for said in (sized(found, 640, 480), filled_in(sized(found, 96, 64), _KNOWN, "a.jpg", 96, 64)):
        for how in ("png", "tiff", "jpeg"):
            Image.open(BytesIO(encode_image(np.zeros((4, 6), np.uint8), said.exif, how))).load()
        encode_linear_tiff(np.zeros((2, 3, 3), np.uint16), said.exif)
        json.dumps([said.make, said.model, said.lens, said.serial]).encode()
    return found


def _exif(data: bytes, folder: Path) -> object:
    (folder / "a.jpg").write_bytes(jpeg_with(data[:60_000]))
    return _said(folder / "a.jpg", "coded")


def _photograph_samples() -> list[bytes]:
    found = [jpeg_with(exif_block())]
    kinds: list[tuple[str, dict[str, Any]]] = [
        ("PNG", {}),
        ("TIFF", {}),
        ("TIFF", {"compression": "tiff_lzw"}),
    ]
    for how, more in kinds:
        buffer = BytesIO()
        Image.new("RGB", (8, 8)).save(buffer, how, **(more or {"exif": for_tiff(exif_block())}))
        found.append(buffer.getvalue())
    return [*found, _big_endian()]


def _big_endian() -> bytes:
    buffer = BytesIO()
    tifffile.imwrite(buffer, np.zeros((8, 8, 3), np.uint16), byteorder=">", photometric="rgb")
    return buffer.getvalue()


def _photograph(data: bytes, folder: Path) -> object:
    path = folder / ("a.tif" if data[:2] in (b"II", b"MM") else "a.jpg")
    path.write_bytes(data)
    return _said(path, "coded")


def box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">L4s", 8 + len(content), kind) + content


def _cr3_samples() -> list[bytes]:
    canon = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")
    blocks = b"".join(box(kind, exif_block()) for kind in (b"CMT1", b"CMT2", b"CMT4"))
    return [
        box(b"ftyp", b"crx \0\0\0\1") + box(b"moov", box(b"uuid", canon + blocks)) + box(b"mdat", bytes(64))
    ]


def _cr3(data: bytes, folder: Path) -> object:
    (folder / "a.cr3").write_bytes(data or b"\0")
    with (folder / "a.cr3").open("rb") as handle, mmap(handle.fileno(), 0, access=ACCESS_COPY) as file:
        blocks = cr3.blocks_of(file)
    return blocks, decode_metadata(folder / "a.cr3", "raw")


def _dng_samples() -> list[bytes]:
    found = []
    for delta in ("BlackLevelDeltaH", "BlackLevelDeltaV"):
        buffer = BytesIO()
        tag = (
            (50715, 10, 24, (1, 2) * 24, True) if delta.endswith("H") else (50716, 10, 16, (3, 2) * 16, True)
        )
        black = [(50713, 3, 2, (2, 2), True), (50714, 5, 4, (9, 1) * 4, True), tag]
        tifffile.imwrite(buffer, np.zeros((16, 24), np.uint16), photometric=32803, extratags=[*black, *_CFA])
        found.append(buffer.getvalue())
    return found


_CFA = [(33421, 3, 2, (2, 2), True), (33422, 1, 4, bytes((0, 1, 1, 2)), True)]


def _dng(data: bytes, folder: Path) -> object:
    (folder / "a.dng").write_bytes(data)
    return black_plane(folder / "a.dng", (16, 24))


def _profile_samples() -> list[bytes]:
    return [ImageCms.ImageCmsProfile(ImageCms.createProfile(kind)).tobytes() for kind in ("sRGB", "LAB")]


def _profile(data: bytes, folder: Path) -> object:
    """Of RGB, where nothing is refused for its profile, and of CMYK, where it is needed."""
    for mode in ("RGB", "CMYK"):
        (folder / f"{mode}.jpg").write_bytes(jpeg_with(profile=data, mode=mode))
        decode_metadata(folder / f"{mode}.jpg", "coded")
    with contextlib.suppress(PhotographError):
        read_coded(folder / "CMYK.jpg", lambda *_: None)
    return read_coded(folder / "RGB.jpg", lambda *_: None)


_ARRAY = {"shape": [2, 3, 3], "dtype": "uint8"}
_PHOTOGRAPH = {"rgb": 0, "encoding": "coded", "srgb_from_camera": None, "profile": "aGk="}


def _wire_samples() -> list[bytes]:
    """What a decoder answers; the length in front is put there by `_framed`."""
    answers: list[Any] = [
        {"value": [96, 64, ""]},
        {"value": _PHOTOGRAPH, "arrays": [_ARRAY], "is_new": False},
        {"value": asdict(Metadata(make="Canon")) | {"exif": ""}},
        {"error": "PhotographError", "message": "a.jpg: broken", "hint": "x"},
    ]  # fmt: skip
    return [json.dumps(answer).encode() for answer in answers]


def _framed(data: bytes, rng: random.Random) -> bytes:
    return struct.pack(">I", rng.choice((len(data),) * 9 + (0, 1, len(data) + 1, (1 << 32) - 1))) + data


class Answering:
    """Within, whatever is asked of a decoder has this answer: one that a photograph took over says anything."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def __enter__(self) -> None:
        self._before = Decoder.ask

        def ask(*_: object) -> Any:
            return self.answer, [np.zeros((2, 3, 3), np.uint8)]

        Decoder.ask = ask  # type: ignore[assignment,method-assign]

    def __exit__(self, *_: object) -> None:
        Decoder.ask = self._before  # type: ignore[method-assign]


def _sent(to: socket.socket, data: bytes) -> None:
    with contextlib.suppress(OSError):
        to.sendall(data)
        to.shutdown(socket.SHUT_WR)


def _wire(data: bytes, folder: Path) -> object:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.settimeout(2)
        sending = threading.Thread(target=_sent, args=(theirs, data))
        sending.start()
        try:
            received = receive(ours)
        finally:
            ours.close()
            sending.join()
    if received is None:
        return None
    answer, window = received[0], SharedArrayReader()
    with contextlib.suppress(ValueError, LookupError, TypeError, OverflowError):
        window.arrays(answer, None)
    capture = Capture("a.jpg", folder / "a.jpg", "coded", "a")
    with Answering(answer):
        for ask in (
            lambda: read_size(capture),
            lambda: read_photograph(capture),
            lambda: read_metadata(capture.path, "coded"),
            lambda: small_picture(capture, 64),
        ):
            with contextlib.suppress(PhotographError):
                ask()
    return answer


TARGETS = (
    Target("masks", _mask_samples, BYTES, _mask, share=0.5),
    Target("EXIF", lambda: [exif_block()], BYTES, _exif, refuses=(), share=0.5),
    Target("JPEG, PNG, TIFF headers", _photograph_samples, BYTES, _photograph, refuses=(), share=0.5),
    Target("CR3 boxes", _cr3_samples, BYTES, _cr3, refuses=()),
    Target("DNG black levels", _dng_samples, BYTES, _dng, refuses=()),
    Target("ICC profiles", _profile_samples, BYTES, _profile, refuses=()),
    Target("answers of a decoder", _wire_samples, JSON, _wire, refuses=(ValueError, OSError), finish=_framed),
)
