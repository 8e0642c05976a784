"""pycolmap carries zlib symbols of its own: whoever imports it first must not crash us (nor we them)."""

from __future__ import annotations

import subprocess
import sys
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from small_demo import ROOT

from colmap_ihe.photographs.png import encode_png

CONVERT = """
from pathlib import Path
from colmap_ihe.cli import main
status = main(["convert", "IN", "OUT", "--method", "ihe", "-q"])
from colmap_ihe.colmap.native import pycolmap
for file in sorted(Path("OUT").glob("*.png")):
    bitmap = pycolmap.Bitmap.read(file, as_rgb=False)
    assert bitmap.to_array().shape[:2] == (90, 120)
raise SystemExit(status)
"""


def fresh(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Runs `code` in an interpreter that has imported nothing, in `folder`."""
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{code}"]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


def write(folder: Path, name: str) -> None:
    (folder / "IN").mkdir(exist_ok=True)
    pixels = np.random.default_rng(1).integers(0, 256, (90, 120, 3), np.uint8)
    Image.fromarray(pixels).save(folder / "IN" / name)


@pytest.mark.parametrize(
    "first",
    ["import pycolmap", "import colmap_ihe", "import colmap_ihe, pycolmap", "import pycolmap, colmap_ihe"],
)
def test_jpeg_is_converted_to_png_in_either_order(tmp_path: Path, first: str) -> None:
    for name in ("a.jpg", "b.jpg"):
        write(tmp_path, name)
    done = fresh(f"{first}\n{CONVERT}", tmp_path)
    assert done.returncode == 0, done.stderr
    for name in ("a.png", "b.png"):
        with Image.open(tmp_path / "OUT" / name) as image:
            image.load()
            assert (image.size, image.mode) == ((120, 90), "L")


@pytest.mark.parametrize("name", ["a.png", "a.tif"])
@pytest.mark.parametrize("first", ["import colmap_ihe, pycolmap", "import pycolmap"])
def test_png_and_tiff_are_read_in_either_order(tmp_path: Path, name: str, first: str) -> None:
    write(tmp_path, name)
    done = fresh(f"{first}\n{CONVERT}", tmp_path)
    assert done.returncode == 0, done.stderr
    with Image.open(tmp_path / "OUT/a.png") as image:
        image.load()
        assert image.size == (120, 90)


def test_after_our_import_other_png_writers_are_safe_beside_pycolmap(tmp_path: Path) -> None:
    code = """
import colmap_ihe, pycolmap, cv2, numpy as np
from PIL import Image
pixels = np.random.default_rng(1).integers(0, 256, (300, 400, 3), np.uint8)
for n in range(3):
    assert cv2.imwrite("a.png", pixels)
    Image.fromarray(pixels).save("b.png")
    assert (cv2.imread("a.png") == pixels).all()
"""
    done = fresh(code, tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_picture_of_a_page_too(tmp_path: Path) -> None:
    done = fresh(
        "import pycolmap\nimport numpy as np\nfrom colmap_ihe.report.charts import match_picture\n"
        "for n in range(2, 40): assert match_picture(np.arange(n * n).reshape(n, n)).side >= 320\n",
        tmp_path,
    )
    assert done.returncode == 0, done.stderr


def test_png_with_alpha_is_what_it_was() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (9, 12, 4), np.uint8)
    with Image.open(BytesIO(encode_png(pixels))) as image:
        assert image.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(image), pixels)
    with pytest.raises(ValueError, match="shape"):
        encode_png(pixels[..., :2])
