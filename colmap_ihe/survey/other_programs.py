"""Read what other programs know of a survey: OpenDroneMap's list, Metashape's markers and its table of references.

OpenDroneMap: the first line names the system, each other line is `x y z px py image [name]`; its pixels are counted
from the centre of the top left one. Metashape's XML: markers with a reference, and their projections in cameras; its
pixels are COLMAP's, (0.5, 0.5) is that centre. Metashape's CSV: the reference of markers, or of cameras, which have
angles too; a first line names the system.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

from colmap_ihe.survey.control import (
    POINT_ACCURACY_M,
    POSITION_ACCURACY_M,
    CameraPosition,
    Control,
    Role,
    Sight,
    SurveyedPoint,
)
from colmap_ihe.survey.control_tables import refuse, text_of

_SYSTEM = "# CoordinateSystem:"
_DISABLED = ("false", "0")
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
    return Control(points=points, sights=sights, crs=_without_local(crs))


def _without_local(crs: str) -> str:
    return "" if crs.startswith("LOCAL") else crs


def _add_marker(
    name: str, reference: ElementTree.Element, points: dict[str, SurveyedPoint], problems: list[str]
) -> None:
    values = [_number(reference.get(axis)) for axis in "xyz"]
    if any(map(math.isnan, values)):
        problems.append(f"marker {name}: its reference is no three numbers")
        return
    accuracies = [a for a in (_number(reference.get(f"s{axis}")) for axis in "xyz") if a > 0]
    accuracy = max(accuracies, default=POINT_ACCURACY_M)
    role: Role = "check" if reference.get("enabled") in _DISABLED else "control"
    points[name] = SurveyedPoint(name, (values[0], values[1], values[2]), accuracy, role)


def _pixel(location: ElementTree.Element) -> tuple[float, float] | None:
    x, y = _number(location.get("x")), _number(location.get("y"))
    return None if math.isnan(x) or math.isnan(y) else (x, y)


def _number(text: str | None) -> float:
    try:
        value = float(text or "nan")
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def is_reference_table(file: Path) -> bool:
    """Tell whether a CSV file begins as what Metashape's *Export Reference* writes; False where it cannot be read."""
    try:
        with file.open("rb") as stream:
            return stream.readline(200).decode("utf-8-sig", "replace").startswith(_SYSTEM)
    except OSError:
        return False


def read_reference_table(file: Path) -> Control:
    """Return the points of Metashape's reference table, those not enabled as check points, or the camera positions, and
    the system it names; lines without a reference are passed over. Raises `ControlFileError`."""
    first, *lines = text_of(file).splitlines()
    delimiter = max(";\t,", key=(lines[0] if lines else "").count)
    columns = [c.lstrip("# ").casefold().split("/")[0] for c in lines[0].split(delimiter)] if lines else []
    if not {"label", "x", "y", "z"} <= set(columns):
        refuse(
            file, ["line 2: expected the columns Label, X, Y and Z, as Metashape's Export Reference has them"]
        )
    points: dict[str, SurveyedPoint] = {}
    positions: list[CameraPosition] = []
    problems: list[str] = []
    for number, cells in enumerate(csv.reader(lines[1:], delimiter=delimiter), start=3):
        row = dict(zip(columns, map(str.strip, cells), strict=False))
        if not cells or cells[0].startswith("#") or not any(row.get(axis) for axis in "xyz"):
            continue
        name, (x, y, z) = row["label"], (_number(row.get(axis)) for axis in "xyz")
        if not name or any(map(math.isnan, (x, y, z))):
            problems.append(
                f"line {number}: is {delimiter.join(cells)!r:.60}, expected a label and three numbers"
            )
            continue
        disabled = row.get("enable", "").casefold() in _DISABLED
        if "yaw" not in columns:
            role: Role = "check" if disabled else "control"
            points[name] = SurveyedPoint(name, (x, y, z), _accuracy(row) or POINT_ACCURACY_M, role)
        elif not disabled:
            positions.append(CameraPosition(name, (x, y, z), _accuracy(row) or POSITION_ACCURACY_M))
    if not (points or positions):
        problems.append("has no line with a reference")
    refuse(file, problems)
    return Control(
        points=points, positions=positions, crs=_without_local(first.partition(_SYSTEM)[2].strip())
    )


def _accuracy(row: Mapping[str, str]) -> float:
    """Return the largest of the accuracies of a line, 0 without any. Metashape names their column Accuracy_X/Y/Z_(m),
    or Accuracy_(m), and writes 0.02 or 0.02/0.02/0.05."""
    given = (_number(a) for a in (row.get("accuracy_x") or row.get("accuracy_(m)") or "").split("/"))
    return max((a for a in given if a > 0), default=0.0)
