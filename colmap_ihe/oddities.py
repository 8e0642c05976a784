"""What is odd about a set of photographs, in sentences for its owner."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from colmap_ihe.preprocess import Surveyed

_UNREAD = frozenset(
    [".heic", ".heif", ".avif", ".webp", ".jp2", ".jxl", ".bmp", ".gif", ".exr", ".hdr", ".psd"]
)


def shared_by(surveyed: list[Surveyed]) -> int:
    """The least number of photographs that one camera took, as COLMAP tells cameras apart by EXIF."""
    groups = Counter(
        (s.metadata.make, s.metadata.model, s.metadata.focal_mm, s.width, s.height) for s in surveyed
    )
    known = all(s.metadata.model and s.metadata.focal_mm for s in surveyed)
    return min(groups.values()) if known else 1


def odd_sizes(surveyed: list[Surveyed], sizes: Counter[tuple[str, str, int, int]]) -> list[str]:
    """A lone size from a camera that else took another, upright or not, is usually a crop or an export."""
    warnings = []
    for one in surveyed:
        key = (one.metadata.make, one.metadata.model, one.width, one.height)
        usual = max((k for k in sizes if k[:2] == key[:2]), key=sizes.__getitem__)
        if sizes[usual] >= 3 * sizes[key] and sorted(usual[2:]) != sorted(key[2:]) and one.metadata.model:
            warnings.append(
                f"{one.capture.name} is {one.width}x{one.height}, the others of this camera {usual[2]}x{usual[3]}:"
                " it gets a camera of its own; use the uncropped original if there is one"
            )
    return warnings


def unread_pictures(ignored: tuple[str, ...]) -> list[str]:
    """Pictures of kinds that are not read are no photographs to us; their owner may think otherwise."""
    unread = [name for name in ignored if Path(name).suffix.lower() in _UNREAD]
    if not unread:
        return []
    return [
        f"{len(unread)} pictures are of a kind that is not read, as {unread[0]}: save them as JPEG or TIFF"
    ]


def exif_warnings(surveyed: list[Surveyed]) -> list[str]:
    broken = [f"{s.capture.name} ({s.metadata.problem})" for s in surveyed if s.metadata.problem]
    return [f"EXIF could not be read in full: {', '.join(broken[:5])}"] if broken else []
