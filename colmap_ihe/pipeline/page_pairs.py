"""Draw pairs of photographs with their matches for the page of a project."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.colmap.native import quiet
from colmap_ihe.colmap.two_views import features_of, match, verified
from colmap_ihe.dense.undistort import read_colour, read_grey
from colmap_ihe.machine.progress import Progress
from colmap_ihe.project.folder import Project
from colmap_ihe.report import contents, pictures
from colmap_ihe.report.contents import PhotographEntry

_PAIRS = 3
_DRAWN = 1000  # pixels of the two photographs side by side
_MATCHED = 1000  # pixels of the longer side of each, at which they are matched again
_U8 = NDArray[np.uint8]


def drawn_pairs(
    project: Project,
    summary: Mapping[str, Any],
    grey_of: Mapping[str, str],
    matched: NDArray[np.int64] | None,
    photographs: Sequence[PhotographEntry],
    compared: bool,
    progress: Progress,
) -> list[contents.Pair]:
    """Draw the pairs on which the grey was measured, else those with most matches, matched again in the chosen grey,
    and if `compared` in COLMAP's default."""
    pairs = [tuple(pair) for pair in (summary["tried"] or {}).get("pairs", ())]
    names = [p.name for p in photographs]
    if not pairs and matched is not None and matched.any():
        best = np.argsort(np.triu(matched), axis=None)[::-1][: 4 * _PAIRS]
        rows = [np.unravel_index(n, matched.shape) for n in best if matched.flat[n]]
        taken: set[int] = set()
        for row in rows:  # each photograph once, so that the pairs are of several places
            if not taken & {int(n) for n in row}:
                taken |= {int(n) for n in row}
                pairs.append((names[row[0]], names[row[1]]))
    pairs = [pair for pair in pairs if all(name in grey_of for name in pair)][:_PAIRS]
    progress.start(len(pairs), "pairs drawn")
    found = []
    for first, second in pairs:
        found.append(_pair(project, (first, second), (grey_of[first], grey_of[second]), compared, progress))
        progress.advance()
    return found


def _pair(
    project: Project, names: tuple[str, str], greys: tuple[str, str], compared: bool, progress: Progress
) -> contents.Pair:
    """Draw the matches. They are not counted: `Grey.benefit` is the one measurement, on more of the pixels."""
    chosen = [pictures.shrunk(read_grey(project.grey / grey), _MATCHED) for grey in greys]
    alt = f"verified matches of {names[0]} and {names[1]}"
    drawn = _matches_drawn(chosen, f"{alt} in the chosen grey", progress)
    if not compared:
        return contents.Pair(*names, drawn)
    colours = [pictures.shrunk(read_colour(project.colour / grey), _MATCHED) for grey in greys]
    default = _matches_drawn([pictures.rec709(colour) for colour in colours], f"{alt} in Rec.709", progress)
    return contents.Pair(*names, drawn, default)


def _matches_drawn(greys: Sequence[_U8], alt: str, progress: Progress) -> contents.Picture:
    one, other = greys
    with quiet():
        first, second = features_of([one, other], progress, first_octave=0)
    pairs = match(first, second)
    ones, others = first.places[pairs[:, 0]], second.places[pairs[:, 1]]
    kept = verified(ones, others, (one.shape[1], one.shape[0]), (other.shape[1], other.shape[0]))
    return pictures.picture(pictures.matches_drawn(one, other, ones[kept], others[kept]), alt, _DRAWN)
