"""Gather what the page shows of the drawings of a project."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

import simplejpeg

from colmap_ihe.machine.files import read_at_most
from colmap_ihe.pipeline.drawings import finished
from colmap_ihe.project.folder import Project
from colmap_ihe.report.contents import Drawing, FileLink, Picture

_PICTURED = 12  # drawings with pictures; of others files are named
_MOST_BYTES = 4_000_000  # of a picture
_KINDS = {
    "facade": "façade",
    "plan": "plan from above",
    "cylinder": "cylinder, unrolled",
    "section": "section",
}
_WORDS = {
    "sheets.pdf": "sheets (PDF)",
    "orthophoto.tif": "orthophoto (TIFF)",
    "relief.tif": "relief in mm (TIFF)",
    "lines.dxf": "lines (DXF)",
    "lines.svg": "lines (SVG)",
    "deviation.jpg": "deviation from the plane (JPEG)",
    "hillshade.jpg": "hillshade (JPEG)",
}


def drawings_of(project: Project) -> list[Drawing]:
    """Return the drawings of a project, by name. One that somebody changed into something else is left out."""
    shown: list[Drawing] = []
    for folder, about in finished(project):
        kind = about.get("kind")
        if isinstance(kind, str) and kind in _KINDS and isinstance(about.get("files"), list):
            shown.append(_drawing(folder, about, with_pictures=len(shown) < _PICTURED))
    return shown


def _drawing(folder: Path, about: Mapping[str, Any], *, with_pictures: bool) -> Drawing:
    kind = _KINDS[about["kind"]]
    alts = {"preview.jpg": f"{folder.name}: {'orthophoto, ' if 'pixel' in about else ''}{kind}"}
    if "pixel" in about:
        alts["preview-relief.jpg"] = f"{folder.name}: relief{_range_of(about)}"
    pictures = [_picture(folder / name, alt) for name, alt in alts.items()] if with_pictures else []
    address = f"../drawings/{quote(folder.name)}"
    files = [FileLink(words, f"{address}/{name}") for name, words in _WORDS.items() if name in about["files"]]
    return Drawing(folder.name, _facts(about), [p for p in pictures if p is not None], files)


def _range_of(about: Mapping[str, Any]) -> str:
    most = about.get("deviation_range")
    if not isinstance(most, float) or not about.get("metric"):
        return ""
    return f", blue up to {1000 * most:g} mm behind the plane, red in front of it, grey farther"


def _facts(about: Mapping[str, Any]) -> list[tuple[str, str]]:
    scale = f"1:{about.get('scale')}" if about.get("metric") else "not to scale: the model is not metric"
    papers = about.get("papers")
    facts = [("sheets", ", ".join([scale, *map(str, papers if isinstance(papers, list) else [])]))]
    if isinstance(about.get("pixel_mm"), float):
        facts.append(("a pixel", f"{about['pixel_mm']:g} mm"))
    for name, words in (
        ("holes_percent", "without a surface"),
        ("without_photograph_percent", "not in photographs"),
    ):
        if isinstance(about.get(name), float):
            facts.append((words, f"{about[name]:.1f} %"))
    return facts


def _picture(file: Path, alt: str) -> Picture | None:
    try:
        content = read_at_most(file, _MOST_BYTES)
        height, width, *_ = simplejpeg.decode_jpeg_header(content)
    except (OSError, ValueError):
        return None
    return Picture(content, int(width), int(height), alt)
