"""Name files that are no photographs to us as what they are, by their suffix or by their first bytes."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable
from pathlib import Path, PurePosixPath

from colmap_ihe.machine.words import counted, listed

_PICTURE = "save it as JPEG, TIFF or PNG"
_ADVICE = {
    "WebP picture": f"{_PICTURE}, best from the original",
    "AVIF picture": _PICTURE,
    "JPEG XL picture": _PICTURE,
    "JPEG 2000 picture": _PICTURE,
    "BMP picture": _PICTURE,
    "GIF picture": "it has 256 colours: take the original",
    "Photoshop file": "save it flattened, as a 16-bit TIFF",
    "HDR picture": "save it as a 16-bit TIFF",
    "double fisheye photograph": "export flat views from it with the maker's program",
    "PDF document": "export its pictures as JPEG or TIFF",
    "film": "take single frames from it, as by ffmpeg -i FILM -vf fps=2 -q:v 2 frame_%05d.jpg",
}
"""By kind, what to do with such a file."""
_SUFFIXES = {
    "WebP picture": ".webp",
    "AVIF picture": ".avif .avifs",
    "JPEG XL picture": ".jxl",
    "JPEG 2000 picture": ".jp2 .j2k .jpx",
    "BMP picture": ".bmp",
    "GIF picture": ".gif",
    "Photoshop file": ".psd .psb",
    "HDR picture": ".exr .hdr",
    "double fisheye photograph": ".insp",
    "film": ".mp4 .mov .m4v .avi .mkv .webm .mts .m2ts .mpg .mpeg .wmv .3gp .360 .insv .lrv",
}
_KIND_OF_SUFFIX = {suffix: kind for kind, suffixes in _SUFFIXES.items() for suffix in suffixes.split()}
_HEADS = (
    (rb"RIFF....WEBP", "WebP picture"),
    (rb"....ftypavi[fs]", "AVIF picture"),
    (rb"\xff\x0a|....JXL ", "JPEG XL picture"),
    (rb"....jP  |\xff\x4f\xff\x51", "JPEG 2000 picture"),
    (rb"BM....\0\0\0\0", "BMP picture"),
    (rb"GIF8[79]a", "GIF picture"),
    (rb"8BPS", "Photoshop file"),
    (rb"\x76\x2f\x31\x01|#\?RADIANCE", "HDR picture"),
    (rb"%PDF", "PDF document"),
    (rb"....ftyp(?:qt  |isom|iso[2-6]|mp4[12]|M4V |avc1|3gp)|RIFF....AVI |\x1a\x45\xdf\xa3", "film"),
)


def kind_by_content(path: Path) -> str:
    """Return what a file is by its first bytes, empty for what is not known."""
    try:
        with path.open("rb") as file:
            head = file.read(32)
    except OSError:
        return ""
    return next((kind for pattern, kind in _HEADS if re.match(pattern, head, re.DOTALL)), "")


def advice_on(kind: str) -> str:
    """Return what to do with a file of a kind."""
    return _ADVICE[kind]


def unread_files(ignored: Iterable[str], photographs: Collection[str]) -> list[str]:
    """Return a sentence for each kind of picture or film among `ignored` names. The films that phones take with each
    photograph, of the same name as one of the `photographs`, are no loss."""
    stems = {_stem(name) for name in photographs}
    kinds: dict[str, list[str]] = defaultdict(list)
    for name in ignored:
        kind = _KIND_OF_SUFFIX.get(PurePosixPath(name).suffix.lower(), "")
        if kind and not (kind == "film" and _stem(name) in stems):
            kinds[kind].append(name)
    return [
        f"{counted(len(names), kind)} cannot be used, {listed(names)}: {advice_on(kind)}"
        for kind, names in kinds.items()
    ]


def _stem(name: str) -> str:
    return str(PurePosixPath(name).with_suffix("")).casefold()
