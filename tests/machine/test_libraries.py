"""What only COLMAP needs is imported when COLMAP is; without pycolmap `fit`, `convert` and `develop` work."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dngs import shoot
from exif_samples import full_photograph
from small_demo import ROOT

from colmap_ihe.colmap.lower_thresholds import COLMAPS_THRESHOLD
from colmap_ihe.colmap.native import pycolmap

WITHOUT = """
import sys
sys.modules["pycolmap"] = None  # as it is where there is no wheel of it
from colmap_ihe.cli import main
sys.exit(main(sys.argv[1:]))
"""


def without_pycolmap(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def images(tmp_path: Path) -> Path:
    (tmp_path / "project/images").mkdir(parents=True)
    full_photograph(tmp_path / "project/images/a.jpg")
    shoot(tmp_path / "project/images/b.dng", np.full((64, 96), 5000, np.uint16))
    return tmp_path / "project/images"


def test_grey_is_made_without_pycolmap(images: Path, tmp_path: Path) -> None:
    for arguments in (
        ("fit", images, "--out", tmp_path / "weights.yaml"),
        ("convert", images, tmp_path / "grey", "-v"),
        ("develop", images, tmp_path / "linear"),
    ):
        done = without_pycolmap(*arguments)
        assert done.returncode == 0, done.stderr
    assert {file.name for file in (tmp_path / "grey").glob("*.png")} == {"a.png", "b.png"}
    assert (tmp_path / "linear/b.tif").is_file() and (tmp_path / "weights.yaml").is_file()


@pytest.mark.parametrize("command", ["reconstruct", "doctor", "demo"])
def test_what_is_missing_is_said_at_once_where_more_is_asked(
    images: Path, tmp_path: Path, command: str
) -> None:
    done = without_pycolmap(command, tmp_path / "new" if command == "demo" else images.parent)
    assert done.returncode == 1
    assert (
        "pycolmap is not installed: without it `fit`, `convert` and `develop` work, and nothing else"
        in done.stderr
    )
    assert "docs/systems.md" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        ("import colmap_ihe", {"pycolmap", "cv2", "numpy", "rawpy", "PIL", "pydantic", "psutil"}),
        (
            "import colmap_ihe; colmap_ihe.__version__",
            {"pycolmap", "cv2", "numpy", "rawpy", "PIL", "pydantic"},
        ),
        ("from colmap_ihe import Weights, fit_weights, to_grey", {"pycolmap", "rawpy", "rich", "trimesh"}),
        ("from colmap_ihe import convert_folder", {"pycolmap"}),
    ],
)
def test_what_an_import_takes_along(code: str, absent: set[str]) -> None:
    command = [sys.executable, "-c", f"import sys; {code}; print(*sys.modules)"]
    modules = subprocess.check_output(command, cwd=ROOT, text=True, timeout=60).split()
    assert "colmap_ihe" in modules
    assert not absent & set(modules)


def test_the_stand_in_is_pycolmap(monkeypatch: pytest.MonkeyPatch) -> None:
    import pycolmap as real

    assert pycolmap.Reconstruction is real.Reconstruction
    monkeypatch.setattr(real, "has_cuda", not real.has_cuda)
    assert pycolmap.has_cuda is real.has_cuda
    assert dir(pycolmap) == dir(real)
    assert not hasattr(pycolmap, "no_such_thing") and not hasattr(pycolmap, "__test__")


def test_the_threshold_is_still_colmaps() -> None:
    assert pycolmap.SiftExtractionOptions().peak_threshold == COLMAPS_THRESHOLD


def test_a_handler_of_sigterm_outlives_the_import_of_pycolmap() -> None:
    code = (
        "import os, signal\n"
        "from colmap_ihe.machine.libraries import pycolmap\n"
        "signal.signal(signal.SIGTERM, lambda *_: print('heard', flush=True))\n"
        "pycolmap.Camera\n"
        "os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout) == (0, "heard\n"), ran.stderr
