"""What stands around the pixels of a PNG or TIFF, changed in memory alone."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin

from colmap_ihe.photographs.container import not_turned, without_text


def test_text_is_taken_out_and_nothing_else() -> None:
    plain, annotated, text = BytesIO(), BytesIO(), PngImagePlugin.PngInfo()
    text.add_text("a", "b" * 100)
    text.add_text("c", "d" * 100, zip=True)
    text.add_itxt("e", "ü")
    picture = Image.fromarray(np.arange(64 * 64, dtype=np.uint8).reshape(64, 64))
    picture.save(plain, "PNG")
    picture.save(annotated, "PNG", pnginfo=text)
    assert without_text(annotated).read() == plain.getvalue()
    assert without_text(plain) is plain


@pytest.mark.parametrize(
    "content", [b"", b"\x89PNG\r\n\x1a\n", b"\x89PNG\r\n\x1a\n\xff\xff\xff\xfftEXt", b"II*\0"]
)
def test_a_broken_file_stays_as_short_as_it_is(content: bytes) -> None:
    assert len(without_text(BytesIO(content)).read()) <= len(content)


def test_a_turned_tiff_is_not_turned_and_a_broken_one_is_told(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[274] = 6
    Image.new("L", (64, 64)).save(tmp_path / "a.tif", exif=exif)
    with Image.open(BytesIO(not_turned(tmp_path / "a.tif").tobytes())) as image:
        assert image.getexif()[274] == 1
    (tmp_path / "b.tif").write_bytes(b"II*\0\xff\xff\xff\0")
    with pytest.raises(OSError, match="a TIFF cut short"):
        not_turned(tmp_path / "b.tif")
