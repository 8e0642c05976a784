"""Read the folder `control/` of a project: the project's own tables, and those of other programs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from colmap_ihe.errors import ControlFileError
from colmap_ihe.survey import other_programs
from colmap_ihe.survey.control import (
    LENGTH_ACCURACY_M,
    POINT_ACCURACY_M,
    POSITION_ACCURACY_M,
    CameraPosition,
    Control,
    ScaleBar,
    Sight,
    SurveyedPoint,
)
from colmap_ihe.survey.control_tables import Row, read_table, refuse

POINTS, POSITIONS, OBSERVATIONS, SCALE_BARS = (
    "points.csv",
    "positions.csv",
    "observations.csv",
    "scalebars.csv",
)
OWN = (POINTS, POSITIONS, OBSERVATIONS, SCALE_BARS)
GCP_LIST = "gcp_list.txt"
_ROLES = ("control", "check")


def control_files(folder: Path) -> list[Path]:
    """Return the files of a folder that are read, sorted; none where there is no such folder. Of a project's own tables
    and another program's list of the same points the list is not read."""
    files = sorted(f for f in folder.glob("*") if f.is_file() and not f.name.startswith("."))
    own = [f for f in files if f.name.casefold() in OWN]
    replaced = {POINTS, OBSERVATIONS} & {f.name.casefold() for f in own}
    lists = [] if replaced else [f for f in files if _is_list(f)]
    if not {POINTS, POSITIONS} & {f.name.casefold() for f in own}:
        lists += [f for f in files if _is_table_of_others(f)]
    return sorted([*own, *lists])


def _is_list(file: Path) -> bool:
    return file.name.casefold() == GCP_LIST or file.suffix.casefold() == ".xml"


def _is_table_of_others(file: Path) -> bool:
    own = file.name.casefold() in OWN
    return not own and file.suffix.casefold() == ".csv" and other_programs.is_reference_table(file)


def _read_other(file: Path) -> Control:
    if file.name.casefold() == GCP_LIST:
        return other_programs.read_gcp_list(file)
    xml = file.suffix.casefold() == ".xml"
    return other_programs.read_marker_xml(file) if xml else other_programs.read_reference_table(file)


def read_control(folder: Path) -> Control:
    """Return what a folder holds, nothing where there is none. Raises `ControlFileError`, which names each line that
    cannot be read, and a point, photograph or bar that is there twice."""
    files = {file.name.casefold(): file for file in control_files(folder)}
    used = set(files.values())
    unused = sorted(
        f.name for f in folder.glob("*") if f.is_file() and f not in used and f.name[0] not in ".~"
    )
    others = {name: _read_other(file) for name, file in files.items() if name not in OWN}
    for what in ("points", "sights", "positions"):
        lists = [name for name, other in others.items() if getattr(other, what)]
        if len(lists) > 1:
            raise ControlFileError(
                f"{folder}: has {len(lists)} lists of {what}, {', '.join(sorted(lists))}",
                hint="keep the one that counts",
            )
    points = {p.name: p for other in others.values() for p in other.points.values()}
    if POINTS in files:
        points = _by_name(files[POINTS], read_table(files[POINTS], _POINT, _POINT_MORE, _point))
    return Control(
        points=points,
        positions=_positions(files.get(POSITIONS)) or [p for o in others.values() for p in o.positions],
        scale_bars=_scale_bars(files.get(SCALE_BARS)),
        sights=_sights(files.get(OBSERVATIONS)) or [s for other in others.values() for s in other.sights],
        crs=next((other.crs for other in others.values() if other.crs), ""),
        unused=unused,
    )


_POINT, _POINT_MORE = ("name", "x", "y", "z"), ("accuracy_m", "role")


def _point(row: Row) -> SurveyedPoint:
    role = row.values.get("role", "").strip().casefold() or "control"
    if role not in _ROLES:
        row.problems.append(f"line {row.line}: role is {role!r:.40}, expected control or check")
    accuracy = row.number("accuracy_m", POINT_ACCURACY_M, positive=True)
    return SurveyedPoint(row.text("name"), _xyz(row), accuracy, "check" if role == "check" else "control")


def _xyz(row: Row) -> tuple[float, float, float]:
    return row.number("x"), row.number("y"), row.number("z")


def _by_name(file: Path, points: Sequence[SurveyedPoint]) -> dict[str, SurveyedPoint]:
    counts = Counter(point.name for point in points)
    refuse(file, [f"has the point {name} {n} times" for name, n in sorted(counts.items()) if n > 1])
    return {point.name: point for point in points}


def _positions(file: Path | None) -> list[CameraPosition]:
    if file is None:
        return []
    positions = read_table(
        file,
        ("image", "x", "y", "z"),
        ("accuracy_m",),
        lambda row: CameraPosition(
            row.text("image"), _xyz(row), row.number("accuracy_m", POSITION_ACCURACY_M, positive=True)
        ),
    )
    counts = Counter(position.image for position in positions)
    refuse(file, [f"has the photograph {name} {n} times" for name, n in sorted(counts.items()) if n > 1])
    return positions


def _sights(file: Path | None) -> list[Sight]:
    if file is None:
        return []
    sights = read_table(
        file,
        ("image", "name", "x_px", "y_px"),
        (),
        lambda row: Sight(
            row.text("image"), row.text("name"), row.number("x_px"), row.number("y_px"), file.name, row.line
        ),
    )
    counts = Counter((sight.image, sight.name) for sight in sights)
    twice = [f"has the point {name} {n} times in {image}" for (image, name), n in counts.items() if n > 1]
    refuse(file, twice)
    return sights


def _scale_bars(file: Path | None) -> list[ScaleBar]:
    if file is None:
        return []

    def bar(row: Row) -> ScaleBar:
        first, second = row.text("a"), row.text("b")
        if first and first == second:
            row.problems.append(f"line {row.line}: a and b are both {first}, expected two points")
        accuracy = row.number("accuracy_m", LENGTH_ACCURACY_M, positive=True)
        return ScaleBar(first, second, row.number("length_m", positive=True), accuracy)

    return read_table(file, ("a", "b", "length_m"), ("accuracy_m",), bar)
