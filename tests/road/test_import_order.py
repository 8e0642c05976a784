"""pycolmap carries zlib symbols of its own: whoever imports it first must not crash us (nor we them)."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from small_demo import ROOT

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

WRITERS = """
import colmap_ihe, pycolmap, cv2, numpy as np
from PIL import Image
pixels = np.random.default_rng(1).integers(0, 256, (300, 400, 3), np.uint8)
for n in range(3):
    assert cv2.imwrite("a.png", pixels)
    Image.fromarray(pixels).save("b.png")
    assert (cv2.imread("a.png") == pixels).all()
"""
PAGE = """
import pycolmap
import numpy as np
from colmap_ihe.report.charts import match_picture
for n in range(2, 40):
    assert match_picture(np.arange(n * n).reshape(n, n)).side >= 320
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
    ("names", "first"),
    [
        (["a.jpg", "b.jpg"], "import pycolmap"),
        (["a.jpg", "b.jpg"], "import colmap_ihe"),
        (["a.jpg", "b.jpg"], "import colmap_ihe, pycolmap"),
        (["a.jpg", "b.jpg"], "import pycolmap, colmap_ihe"),
        *(
            (["a" + suffix], f"import {first}pycolmap")
            for suffix in (".png", ".tif")
            for first in ("", "colmap_ihe, ")
        ),
    ],
)
def test_photographs_are_converted_to_png_in_either_order(
    tmp_path: Path, names: list[str], first: str
) -> None:
    for name in names:
        write(tmp_path, name)
    done = fresh(f"{first}\n{CONVERT}", tmp_path)
    assert done.returncode == 0, done.stderr
    for name in names:
        with Image.open((tmp_path / "OUT" / name).with_suffix(".png")) as image:
            image.load()
            assert (image.size, image.mode) == ((120, 90), "L")


@pytest.mark.parametrize("code", [WRITERS, PAGE])
def test_other_png_writers_are_safe_beside_pycolmap(tmp_path: Path, code: str) -> None:
    done = fresh(code, tmp_path)
    assert done.returncode == 0, done.stderr
