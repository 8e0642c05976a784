"""Read surveyed points with their sights from files of other programs: OpenDroneMap's list and Metashape's markers.

OpenDroneMap: the first line names the system, each other line is `x y z px py image [name]`; its pixels are counted
from the centre of the top left one. Metashape's XML: markers with a reference, and their projections in cameras; its
pixels are COLMAP's, (0.5, 0.5) is that centre.
"""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

from colmap_ihe.survey.control import POINT_ACCURACY_M, Control, Sight, SurveyedPoint
from colmap_ihe.survey.control_tables import refuse, text_of

_TO_CORNER = 0.5  # pixels, from OpenDroneMap's origin to COLMAP's


def read_gcp_list(file: Path) -> Control:
    """Return the points, sights and system of a `gcp_list.txt`. A point without a name is known by its coordinates.
    Raises `ControlFileError`."""
    lines = [line.strip() for line in text_of(file).splitlines()]
    crs = lines[0] if lines else ""
    points: dict[str, SurveyedPoint] = {}
    sights: list[Sight] = []
    problems = [] if crs else ["line 1: is empty, expected the coordinate system, as EPSG:32632"]
    for number, line in enumerate(lines[1:], start=2):
        if not line or line.startswith("#"):
            continue
        cells = line.split(maxsplit=5) if "\t" not in line else line.split("\t")
        values = _numbers(cells[:5])
        if len(cells) < 6 or values is None:
            problems.append(f"line {number}: is {line!r:.60}, expected x y z px py image [name]")
            continue
        image, name = _image_and_name(cells[5:])
        x, y, z, across, down = values
        name = name or f"{x:g} {y:g} {z:g}"
        if points.setdefault(name, SurveyedPoint(name, (x, y, z))).xyz != (x, y, z):
            problems.append(f"line {number}: {name} has other coordinates than before")
        sights.append(Sight(image, name, across + _TO_CORNER, down + _TO_CORNER, file.name, number))
    refuse(file, problems)
    return Control(points=points, sights=sights, crs=crs)


def _numbers(cells: list[str]) -> list[float] | None:
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        return None
    return values if len(values) == 5 and all(map(math.isfinite, values)) else None


def _image_and_name(cells: list[str]) -> tuple[str, str]:
    """Return the two last columns. Of columns divided by spaces they are still one text; a point's name has none."""
    if len(cells) > 1:
        return cells[0].strip(), cells[1].strip()
    image, _, name = cells[0].strip().rpartition(" ")
    return (image.strip(), name) if image else (name, "")


def read_marker_xml(file: Path) -> Control:
    """Return the markers of Metashape's XML that have a reference or are seen, and the system it names. Raises
    `ControlFileError`."""
    text = text_of(file)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        refuse(file, [f"is no XML ({error})"])
        raise
    cameras = {c.get("id"): c.get("label") or "" for c in root.iter("camera") if c.get("id")}
    labels: dict[str | None, str] = {}
    points: dict[str, SurveyedPoint] = {}
    problems: list[str] = []
    for marker in root.iter("marker"):
        name, reference = marker.get("label"), marker.find("reference")
        if name is None:
            continue
        labels[marker.get("id")] = name
        if reference is not None and reference.get("x") is not None:
            _add_marker(name, reference, points, problems)
    sights = [
        Sight(cameras[at.get("camera_id")], labels[seen.get("marker_id")], *pixel, file.name)
        for seen in root.iter("marker")
        if seen.get("marker_id") in labels
        for at in seen.iter("location")
        if at.get("camera_id") in cameras and (pixel := _pixel(at)) is not None
    ]
    system = root.find(".//reference[@crs]")
    crs = next((e.text or "" for e in root.iter("reference") if (e.text or "").strip()), "")
    if not labels:
        problems.append("has no markers, expected what Metashape's Export Markers writes")
    refuse(file, problems)
    crs = crs.strip() or (system.get("crs") or "" if system is not None else "")
    return Control(points=points, sights=sights, crs="" if crs.startswith("LOCAL") else crs)


def _add_marker(
    name: str, reference: ElementTree.Element, points: dict[str, SurveyedPoint], problems: list[str]
) -> None:
    values = [_number(reference.get(axis)) for axis in "xyz"]
    if any(map(math.isnan, values)):
        problems.append(f"marker {name}: its reference is no three numbers")
        return
    accuracies = [a for a in (_number(reference.get(f"s{axis}")) for axis in "xyz") if a > 0]
    accuracy = max(accuracies, default=POINT_ACCURACY_M)
    role = "check" if reference.get("enabled") in ("false", "0") else "control"
    points[name] = SurveyedPoint(
        name, (values[0], values[1], values[2]), accuracy, "check" if role == "check" else "control"
    )


def _pixel(location: ElementTree.Element) -> tuple[float, float] | None:
    x, y = _number(location.get("x")), _number(location.get("y"))
    return None if math.isnan(x) or math.isnan(y) else (x, y)


def _number(text: str | None) -> float:
    try:
        value = float(text or "nan")
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
