"""The folder control/: what is read, and how each bad line is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from colmap_ihe.errors import ControlFileError
from colmap_ihe.survey.control import CameraPosition, ScaleBar, Sight, SurveyedPoint
from colmap_ihe.survey.control_files import control_files, read_control

POINTS = "name,x,y,z,accuracy_m,role\nP1,1,2,3,0.002,check\nP2,4,5,6,,\n"


def test_all_four_tables_are_read(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(POINTS)
    (tmp_path / "positions.csv").write_text("image,x,y,z\na.jpg,1,2,3\n")
    (tmp_path / "observations.csv").write_text("image,name,x_px,y_px\na.jpg,P1,10.5,20\n")
    (tmp_path / "scalebars.csv").write_text("a,b,length_m\nP1,P2,2.5\n")
    (tmp_path / "notes.txt").write_text("")
    control = read_control(tmp_path)
    assert control.points == {
        "P1": SurveyedPoint("P1", (1, 2, 3), 0.002, "check"),
        "P2": SurveyedPoint("P2", (4, 5, 6), 0.01, "control"),
    }
    assert control.positions == [CameraPosition("a.jpg", (1, 2, 3), 0.05)]
    assert control.sights == [Sight("a.jpg", "P1", 10.5, 20, "observations.csv", 2)]
    assert control.scale_bars == [ScaleBar("P1", "P2", 2.5, 0.001)]
    assert control.unused == ["notes.txt"]
    assert read_control(tmp_path / "none").coordinates() == []


def test_a_spreadsheet_of_half_of_europe_is_read(tmp_path: Path) -> None:
    text = "\ufeffName;X;Y;Z\r\nP1;1,5;2;3\r\n;;;\r\n# P2;1;1;1\r\n"
    (tmp_path / "Points.CSV").write_bytes(text.encode())
    assert read_control(tmp_path).points["P1"].xyz == (1.5, 2, 3)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("points.csv", "", "is empty"),
        ("points.csv", "name,x,y\nA,1,2\n", "has no column z"),
        ("points.csv", "name,x,y,z,colour\nA,1,2,3,red\n", "a column 'colour' that is not used"),
        (
            "points.csv",
            "name,x,y,z\nA,1,two,3\nB,1,nan,3\n",
            "line 2: y is 'two', expected a number; line 3: y is",
        ),
        ("points.csv", "name,x,y,z\nA,1,2,3\nA,4,5,6\n", "has the point A 2 times"),
        ("points.csv", "name,x,y,z,role\nA,1,2,3,tie\n", "role is 'tie', expected control or check"),
        ("points.csv", "name,x,y,z\nA,1,2,3,4\n", "line 2: has 5 values, expected 4"),
        ("positions.csv", "image,x,y,z,accuracy_m\na.jpg,1,2,3,0\n", "expected a number above 0"),
        ("scalebars.csv", "a,b,length_m\nT1,T1,2\n", "expected two points"),
        ("observations.csv", "image,name,x_px,y_px\na,P,1,1\na,P,2,2\n", "has the point P 2 times in a"),
        (
            "gcp_list.txt",
            "EPSG:32632\n1 2 x 4 5 a.jpg\n",
            "line 2: is '1 2 x 4 5 a.jpg', expected x y z px py",
        ),
        ("markers.xml", "<document>", "is no XML"),
        ("markers.xml", "<document/>", "has no markers"),
    ],
)
def test_each_bad_line_is_named(tmp_path: Path, name: str, text: str, words: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ControlFileError) as caught:
        read_control(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / name}: ")
    assert words in str(caught.value)


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_bytes(b"name,x,y,z\n\xff\xfe,1,2,3\n")
    with pytest.raises(ControlFileError, match="not text in UTF-8"):
        read_control(tmp_path)


def test_another_programs_list_is_not_read_beside_the_projects_tables(tmp_path: Path) -> None:
    (tmp_path / "gcp_list.txt").write_text("EPSG:32632\n1 2 3 4 5 a.jpg\n")
    assert [file.name for file in control_files(tmp_path)] == ["gcp_list.txt"]
    (tmp_path / "points.csv").write_text(POINTS)
    assert [file.name for file in control_files(tmp_path)] == ["points.csv"]
    assert read_control(tmp_path).unused == ["gcp_list.txt"]
