"""ICC profiles made by the specification (ICC.1:2001-04, version 2), so that tests need no files of others."""

from __future__ import annotations

import itertools
import struct

D50 = (0.9642, 1.0, 0.8249)


def _xyz(*values: float) -> bytes:
    return b"XYZ \0\0\0\0" + b"".join(struct.pack(">i", round(v * 65536)) for v in values)


def _description(name: str) -> bytes:
    text = name.encode() + b"\0"
    return b"desc\0\0\0\0" + struct.pack(">I", len(text)) + text + bytes(4 + 4 + 2 + 1 + 67)


def _profile(kind: bytes, colours: bytes, connection: bytes, tags: dict[bytes, bytes]) -> bytes:
    place, table, data = 128 + 4 + 12 * len(tags), struct.pack(">I", len(tags)), b""
    for name, content in tags.items():
        padded = content + bytes(-len(content) % 4)
        table += name + struct.pack(">II", place + len(data), len(content))
        data += padded
    header = struct.pack(">I4sI4s4s4s", place + len(data), bytes(4), 0x02400000, kind, colours, connection)
    header += struct.pack(">6H", 2016, 1, 1, 0, 0, 0) + b"acsp" + bytes(28) + _xyz(*D50)[8:]
    return header.ljust(128, b"\0") + table + data


def rgb_profile(name: str, gamma: float = 2.2) -> bytes:
    """Adobe RGB's primaries, adapted to D50, with a plain gamma."""
    curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(gamma * 256))
    tags = {
        b"desc": _description(name), b"wtpt": _xyz(*D50), b"rXYZ": _xyz(0.60974, 0.31111, 0.01947),
        b"gXYZ": _xyz(0.20528, 0.62567, 0.06087), b"bXYZ": _xyz(0.14919, 0.06322, 0.74457),
        b"rTRC": curve, b"gTRC": curve, b"bTRC": curve,
    }  # fmt: skip
    return _profile(b"mntr", b"RGB ", b"XYZ ", tags)


def red_cyan_profile() -> bytes:
    """CMYK whose inks darken, but for cyan, which prints the red of sRGB: Lab (54, 81, 70)."""
    grid = b""
    for cyan, *others in itertools.product((0, 1), repeat=4):
        if any(others):
            lightness, a, b = 5.0, 0.0, 0.0
        else:
            lightness, a, b = (54.0, 81.0, 70.0) if cyan else (100.0, 0.0, 0.0)
        grid += struct.pack(">3H", round(lightness * 652.8), round((a + 128) * 256), round((b + 128) * 256))
    identity = b"".join(struct.pack(">i", 65536 if n in (0, 4, 8) else 0) for n in range(9))
    line = struct.pack(">2H", 0, 65535)
    table = b"mft2\0\0\0\0" + bytes([4, 3, 2, 0]) + identity + struct.pack(">2H", 2, 2)
    table += line * 4 + grid + line * 3
    tags = {b"desc": _description("Red cyan"), b"wtpt": _xyz(*D50), b"A2B0": table}
    return _profile(b"prtr", b"CMYK", b"Lab ", tags)


def grey_profile() -> bytes:
    curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(2.2 * 256))
    tags = {b"desc": _description("Dot gain"), b"wtpt": _xyz(*D50), b"kTRC": curve}
    return _profile(b"mntr", b"GRAY", b"XYZ ", tags)
