"""What is odd about a set of photographs, in sentences for its owner."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from colmap_ihe.captures.decode import read_photograph
from colmap_ihe.captures.discover import Capture
from colmap_ihe.errors import PhotographError
from colmap_ihe.grey.conversions import CONVERSIONS
from colmap_ihe.grey.weights import Grey, Weights
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


def warnings_of(surveyed: Sequence[Surveyed], ignored: tuple[str, ...] = ()) -> list[str]:
    """What headers say that its owner should know, whatever is done with the set."""
    return [
        *exif_warnings(surveyed),
        *profile_warnings(surveyed),
        *page_warnings(surveyed),
        *unread_pictures(ignored),
    ]


def exif_warnings(surveyed: Sequence[Surveyed]) -> list[str]:
    broken = [f"{s.capture.name} ({s.metadata.problem})" for s in surveyed if s.metadata.problem]
    return [f"EXIF could not be read in full: {', '.join(broken[:5])}"] if broken else []


def profile_warnings(surveyed: Sequence[Surveyed]) -> list[str]:
    """Numbers are taken as stored, so one colour in two profiles is two colours to us."""
    profiles = Counter(s.metadata.profile for s in surveyed if s.capture.kind == "coded")
    if len(profiles) < 2:
        return []
    counts = ", ".join(f"{count} in {name}" for name, count in profiles.most_common())
    return [
        f"the photographs are in different colour profiles ({counts}): the same colour has different values in"
        " them, and so different greys; export all of them in one"
    ]


def page_warnings(surveyed: Sequence[Surveyed]) -> list[str]:
    several = [f"{s.capture.name} ({s.metadata.pages})" for s in surveyed if s.metadata.pages > 1]
    if not several:
        return []
    return [f"of TIFF files with several pages the first one is used: {', '.join(several[:5])}"]


def fit_warnings(captures: Sequence[Capture], weights: Iterable[Grey]) -> list[str]:
    """Says so where a grey is not the same in all photographs, and where a fit had nothing to fit to. Reads
    photographs up to the first one with colour in it, which mostly is the first."""
    weights = list(weights)
    if any(CONVERSIONS[w.method].scope == "image" for w in weights if w.method in CONVERSIONS):
        return [
            f"{weights[0].method} is fitted to each photograph: the same colour is another grey in another"
            " photograph, which costs matches; see docs/conversions.md"
        ]
    fitted = [w for w in weights if isinstance(w, Weights) and w.score is not None]
    if not fitted:
        return []
    if all(w.tones == 1 for w in fitted):
        return ["the photographs hold a single tone, as if all were black: nothing can be found in them"]
    for capture in captures:
        try:
            rgb = read_photograph(capture).rgb
        except PhotographError:
            continue
        if any((row != row[:, :1]).any() for row in rgb):
            return []
    return [
        "the photographs are greyscale (R = G = B): every triplet of weights gives the same grey, so none was"
        " found to be better"
    ]
