"""Positions that drones write into XMP."""

from __future__ import annotations

from pathlib import Path

import pytest

from colmap_ihe.photographs.exif.xmp import RtkPosition, rtk_position

AS_ATTRIBUTES = b"""\xff\xd8<rdf:Description drone-dji:AbsoluteAltitude="+562.10" drone-dji:GpsLatitude="48.1402"
 drone-dji:GpsLongitude="+11.5801" drone-dji:RtkFlag="50" drone-dji:RtkStdLon="0.012" drone-dji:RtkStdLat="0.014"
 drone-dji:RtkStdHgt="0.031"/>"""
AS_ELEMENTS = (
    b"<drone-dji:RtkFlag>50</drone-dji:RtkFlag><drone-dji:GpsLatitude>-33.5</drone-dji:GpsLatitude>"
    b"<drone-dji:GpsLongitude>-70.25</drone-dji:GpsLongitude>"
    b"<drone-dji:AbsoluteAltitude>12</drone-dji:AbsoluteAltitude>"
)


@pytest.mark.parametrize(
    ("content", "position"),
    [
        (AS_ATTRIBUTES, RtkPosition(11.5801, 48.1402, 562.1, 0.031)),
        (AS_ELEMENTS, RtkPosition(-70.25, -33.5, 12.0, 0.01)),
        (AS_ATTRIBUTES.replace(b'Flag="50"', b'Flag="16"'), None),
        (AS_ATTRIBUTES.replace(b"GpsLatitude", b"Elsewhere"), None),
        (AS_ATTRIBUTES.replace(b"48.1402", b"4.8.1"), None),
        (b"no XMP", None),
    ],
)
def test_only_fixed_solutions_count(tmp_path: Path, content: bytes, position: RtkPosition | None) -> None:
    (tmp_path / "a.jpg").write_bytes(content + bytes(300_000))
    assert rtk_position(tmp_path / "a.jpg") == position


def test_a_file_that_is_gone_has_none(tmp_path: Path) -> None:
    assert rtk_position(tmp_path / "a.jpg") is None
