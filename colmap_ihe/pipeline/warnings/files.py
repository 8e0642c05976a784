"""Say what files hold that COLMAP, or a grey of 8 bits, would take for something else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from colmap_ihe.fit.counting import SetCounts
from colmap_ihe.grey.weights import Encoding
from colmap_ihe.machine.words import counted, listed
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.survey import Surveyed

_CHANNELS = ((100, 0, 0), (0, 100, 0), (0, 0, 100))  # weights in hundredths
_LOW = 64
"""The highest of 255 levels of 14 bits that lie in files of 16."""
_DEEP_SUFFIXES = (".tif", ".tiff", ".png")


def panorama_warnings(surveyed: Sequence[Surveyed]) -> list[str]:
    """Warn of panoramas, which no model of a lens describes."""
    kinds: dict[str, list[str]] = {}
    for one in surveyed:
        if one.metadata.projection not in ("", "rectilinear", "perspective"):
            kinds.setdefault(one.metadata.projection, []).append(one.capture.name)
    return [
        f"{counted(len(names), f'{kind} panorama')} in the set, {listed(names)}: COLMAP takes each for a photograph"
        f" through one lens, which bends the model. {_what_to_do(kind, len(names) == len(surveyed))}"
        for kind, names in kinds.items()
    ]


def _what_to_do(kind: str, all_of_them: bool) -> str:
    if kind == "equirectangular" and all_of_them:
        return "Cut them into flat views, or for a sparse model alone use --set camera.model=EQUIRECTANGULAR --no-dense"
    return (
        "Cut it into flat views, or take it out"
        if kind == "equirectangular"
        else "Take single photographs instead"
    )


def depth_warnings(captures: Sequence[Capture], counts: Mapping[Encoding, SetCounts]) -> list[str]:
    """Warn of a gamma-coded set whose values lie in the lowest part of their range, as those of 12 bits do in files of
    16: they are a few levels of the 256 that COLMAP sees."""
    coded = counts.get("coded")
    if coded is None or not any(c.name.lower().endswith(_DEEP_SUFFIXES) for c in captures):
        return []
    highest = max(
        int(levels.nonzero()[0].max(initial=0)) for levels in coded.histogram.levels(_CHANNELS).values()
    )
    if not 0 < highest <= _LOW:
        return []
    return [
        f"no channel of the photographs goes above level {highest} of 255, as where {_bits(highest)} bits lie in files"
        " of 16: few tones are left to match. Export them again with values up to 65535, all by the same factor"
    ]


def _bits(highest: int) -> int:
    """Return the bits of values that become levels up to `highest` of 255."""
    return (257 * highest - 128).bit_length()  # of the least value that is rounded to it
