"""Points of OpenDroneMap and Metashape."""

from __future__ import annotations

from pathlib import Path

import pytest

from colmap_ihe.errors import ControlFileError
from colmap_ihe.survey.control import CameraPosition, Sight, SurveyedPoint
from colmap_ihe.survey.control_files import read_control
from colmap_ihe.survey.other_programs import read_gcp_list, read_marker_xml

MARKERS = """<document version="1.5.0"><chunk label="Chunk 1">
<cameras><camera id="0" label="DSC1.JPG"/><camera id="1" label="DSC2.JPG"/></cameras>
<markers><marker id="3" label="point 1"><reference x="10.5" y="20" z="3" sx="0.004" sy="0.004"
sz="0.006" enabled="true"/></marker>
<marker id="4" label="point 2"><reference x="1" y="2" z="3" enabled="false"/></marker>
<marker id="5" label="seen only"/></markers>
<frames><frame id="0"><markers>
<marker marker_id="3"><location camera_id="0" pinned="true" x="100.5" y="200.25"/>
<location camera_id="1" x="7" y="8"/></marker></markers></frame></frames>
<reference>EPSG:25832</reference></chunk></document>"""


def test_a_list_of_opendronemap(tmp_path: Path) -> None:
    file = tmp_path / "gcp_list.txt"
    lines = [
        "EPSG:32632",
        "691234.5 5334765.25 512.3 100 200 DSC 1.JPG P1",
        "691234.5 5334765.25 512.3 5 6 b.jpg P1",
        "",
    ]
    file.write_text("\n".join([*lines, "1\t2\t3\t4\t5\tc.jpg"]))
    control = read_gcp_list(file)
    assert control.crs == "EPSG:32632"
    assert {name: point.xyz for name, point in control.points.items()} == {
        "P1": (691234.5, 5334765.25, 512.3),
        "1 2 3": (1, 2, 3),
    }
    assert control.sights[0] == Sight("DSC 1.JPG", "P1", 100.5, 200.5, "gcp_list.txt", 2)
    assert control.sights[2].image == "c.jpg"


def test_markers_of_metashape(tmp_path: Path) -> None:
    file = tmp_path / "markers.xml"
    file.write_text(MARKERS)
    control = read_marker_xml(file)
    assert control.crs == "EPSG:25832"
    first, second = control.points["point 1"], control.points["point 2"]
    assert (first.xyz, first.accuracy_m, first.role) == ((10.5, 20, 3), 0.006, "control")
    assert (second.role, second.accuracy_m) == ("check", 0.01)
    assert [(s.image, s.name, s.x_px, s.y_px) for s in control.sights] == [
        ("DSC1.JPG", "point 1", 100.5, 200.25),
        ("DSC2.JPG", "point 1", 7, 8),
    ]


SYSTEM = '# CoordinateSystem: PROJCS["ETRS89 / UTM zone 32N",AUTHORITY["EPSG","25832"]]'


def test_the_reference_table_of_markers_of_metashape(tmp_path: Path) -> None:
    (tmp_path / "export.csv").write_text(
        f"\ufeff{SYSTEM}\n"
        "#Label,Enable,X/Easting,Y/Northing,Z/Altitude,Accuracy_X/Y/Z_(m),Error_(m),X_error,X_est\n"
        "P1,1,691234.5,5334765.25,512.3,0.002/0.002/0.005,0.01,0.01,691234.51\n"
        "P2,0,691244.5,5334765.25,512.3,,0.01,0.01,1\n"
        "seen only,1,,,,,,,5\n"
        "# Total error,,,,,0.01\n"
    )
    control = read_control(tmp_path)
    assert control.crs == SYSTEM.partition(": ")[2]
    assert control.points == {
        "P1": SurveyedPoint("P1", (691234.5, 5334765.25, 512.3), 0.005, "control"),
        "P2": SurveyedPoint("P2", (691244.5, 5334765.25, 512.3), 0.01, "check"),
    }
    assert (control.positions, control.unused) == ([], [])


def test_the_reference_table_of_cameras_of_metashape(tmp_path: Path) -> None:
    (tmp_path / "cameras.csv").write_text(
        '# CoordinateSystem: LOCAL_CS["Local Coordinates (m)"]\n'
        "Label;X;Y;Z;Yaw;Pitch;Roll;Accuracy_(m)\n"
        "DSC1.JPG;1;2;3;0;0;0;0.03\n"
        "DSC2.JPG;a;2;3;0;0;0;0.03\n"
    )
    with pytest.raises(ControlFileError, match="line 4: is 'DSC2"):
        read_control(tmp_path)
    good = (tmp_path / "cameras.csv").read_text().replace(";a;", ";4;")
    (tmp_path / "cameras.csv").write_text(good)
    control = read_control(tmp_path)
    assert control.positions[0] == CameraPosition("DSC1.JPG", (1, 2, 3), 0.03)
    assert (len(control.positions), control.crs, control.points) == (2, "", {})
    (tmp_path / "more.csv").write_text(good)
    with pytest.raises(ControlFileError, match=r"2 lists of positions, cameras\.csv, more\.csv"):
        read_control(tmp_path)
    (tmp_path / "more.csv").write_text(good.replace("Label", "Name"))
    with pytest.raises(ControlFileError, match="line 2: expected the columns Label"):
        read_control(tmp_path)
