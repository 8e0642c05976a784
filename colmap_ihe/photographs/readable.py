"""Find the photographs of a folder that can be read: of a shot the JPEG, where LibRaw does not know its RAW file."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.decoder_pool import in_decoder
from colmap_ihe.machine.words import counted
from colmap_ihe.photographs.discover import Capture, Discovery, discover
from colmap_ihe.photographs.exif.metadata import Metadata, decode_metadata, read_metadata
from colmap_ihe.photographs.raw.develop import unknown_format


@dataclass(frozen=True)
class RawFormat:
    """Hold make and model of a RAW file's camera, empty for a file that does not even say that, and LibRaw's words
    where it does not know the format, else empty."""

    camera: str
    unknown: str


def find_photographs(folder: Path) -> Discovery:
    """Return what `discover` does, with the JPEG in the place of RAW files of an unknown format. Raises
    `ProjectError`."""
    discovery = discover(folder)
    captures, notes = with_readable_halves(discovery.captures)
    return replace(discovery, captures=captures, notes=(*discovery.notes, *notes))


def with_readable_halves(captures: Sequence[Capture]) -> tuple[tuple[Capture, ...], list[str]]:
    """Return the captures in the order of their names, and a sentence for each camera whose shots are now their JPEG
    files.

    Three RAW files with a JPEG of each folder and suffix are opened. If LibRaw does not know the format of one, all
    shots of that camera that have a JPEG become it: RAW and JPEG differ in tone and distortion, so a camera is to
    have one kind.
    """
    formats = [_format_of(capture) for capture in _samples(captures)]
    reasons = {known.camera: known.unknown for known in formats if known.unknown and known.camera}
    if not reasons:
        return tuple(captures), []
    instead: dict[str, list[Capture]] = defaultdict(list)
    used = []
    for capture in captures:
        camera = _camera_of(capture) if capture.paired else ""
        if camera in reasons:
            instead[camera].append(capture)
        used.append(_jpeg_of(capture) if camera in reasons else capture)
    notes = [_sentence(shots, camera, reasons[camera]) for camera, shots in instead.items()]
    return tuple(sorted(used, key=lambda c: c.name)), notes


def _samples(captures: Iterable[Capture]) -> list[Capture]:
    groups: dict[tuple[str, str], list[Capture]] = defaultdict(list)
    for capture in captures:
        if capture.paired:
            path = PurePosixPath(capture.name)
            groups[str(path.parent), path.suffix.lower()].append(capture)
    chosen = [(group[0], group[len(group) // 2], group[-1]) for group in groups.values()]
    return list({c.name: c for three in chosen for c in three}.values())


def _format_of(capture: Capture) -> RawFormat:
    try:
        return in_decoder(decode_format, capture, pixels=0)
    except PhotographError:  # whoever reads it will say so
        return RawFormat("", "")


def decode_format(capture: Capture) -> RawFormat:
    """Return the format of a RAW file, in this process."""
    return RawFormat(_named(decode_metadata(capture.path, "raw")), unknown_format(capture.path))


def _camera_of(capture: Capture) -> str:
    return _named(read_metadata(capture.path, "raw"))


def _named(metadata: Metadata) -> str:
    return f"{metadata.make} {metadata.model}".strip()


def _jpeg_of(capture: Capture) -> Capture:
    name = capture.paired[0]
    folder = Path(str(capture.path).removesuffix(capture.name))
    return replace(capture, name=name, path=folder / name, kind="coded", paired=())


def _sentence(shots: Sequence[Capture], camera: str, reason: str) -> str:
    return (
        f"the RAW files of {camera} are of a format that LibRaw does not know, as {shots[0].name}"
        f" ({reason}): its JPEG files are used, of {counted(len(shots), 'shot')}. To use the RAW files, convert them"
        " to DNG or TIFF with the maker's program, or have the camera write another compression"
    )
