"""Canon's CR3 keeps EXIF in boxes of its own. Files made here, after its description: there is no camera at hand."""

from __future__ import annotations

from pathlib import Path

import pytest
from exif_samples import IMAGE, SHOT, cr3

from colmap_ihe.photographs.exif.blocks import take_apart
from colmap_ihe.photographs.exif.metadata import read_metadata


@pytest.mark.parametrize("large", [False, True])
def test_the_boxes_are_found(tmp_path: Path, large: bool) -> None:
    (tmp_path / "a.cr3").write_bytes(cr3(large))
    found = read_metadata(tmp_path / "a.cr3", "raw")
    assert (found.make, found.model, found.focal_mm, found.focal_35mm) == ("Canon", "Canon EOS 5D", 24, 24)
    assert (found.orientation, found.lens, found.has_gps, found.problem) == (6, "EF 24-70", True, "")
    left = take_apart(bytearray(found.exif))
    assert (set(left.shot), set(left.image) - {0x8769, 0x8825}) == (set(SHOT), set(IMAGE))


def test_a_file_that_is_cut_short_keeps_what_stands_before(tmp_path: Path) -> None:
    whole = cr3()
    for end, make in ((20, ""), (whole.index(b"CMT2"), ""), (len(whole) - 50, "Canon")):
        (tmp_path / "a.cr3").write_bytes(whole[:end])
        assert read_metadata(tmp_path / "a.cr3", "raw").make == make
