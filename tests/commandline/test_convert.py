"""The command `convert`: grey images, folders that are refused, and weights files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import Captured, failure_of, json_of
from PIL import Image
from same_results import pixels_of


def test_convert_writes_grey_images_with_exif(capsys: Captured, photos: Path, tmp_path: Path) -> None:
    result = json_of(capsys, "convert", photos, tmp_path / "grey", "--method", "green")
    assert result["weights"] == [0, 1, 0]
    assert result["grey"] == {"a.jpg": "a.png", "b.jpg": "b.png", "côté nord/c d.jpg": "côté nord/c d.png"}
    for source, target in result["grey"].items():
        with Image.open(tmp_path / "grey" / target) as grey, Image.open(photos / source) as rgb:
            assert grey.mode == "L"
            np.testing.assert_array_equal(np.asarray(grey), np.asarray(rgb)[..., 1])
            assert grey.getexif().get_ifd(0x8769)[0x920A] == rgb.getexif().get_ifd(0x8769)[0x920A] == 30


@pytest.mark.parametrize(("kind", "suffix"), [("tiff", ".tif"), ("jpeg", ".jpg")])
def test_other_formats(capsys: Captured, photos: Path, tmp_path: Path, kind: str, suffix: str) -> None:
    options = ("--method", "mean", "--format", kind)
    result = json_of(capsys, "convert", photos, tmp_path / "grey", *options)
    assert {Path(name).suffix for name in result["grey"].values()} == {suffix}
    with Image.open(tmp_path / f"grey/a{suffix}") as grey:
        assert (grey.mode, grey.size) == ("L", (480, 320))


def test_convert_refuses_somebodys_folder(capsys: Captured, photos: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis/chapter.txt").write_text("mine")
    line = failure_of(capsys, "convert", photos, tmp_path / "thesis", "--method", "red")
    assert "is not empty" in line
    assert [p.name for p in (tmp_path / "thesis").iterdir()] == ["chapter.txt"]


def test_convert_refuses_a_file_for_a_folder(capsys: Captured, photos: Path, tmp_path: Path) -> None:
    (tmp_path / "grey").write_text("a file")
    failure_of(capsys, "convert", photos, tmp_path / "grey", "--method", "red")
    assert (tmp_path / "grey").read_text() == "a file"


def test_weights_go_from_one_campaign_to_another(capsys: Captured, photos: Path, tmp_path: Path) -> None:
    weights = tmp_path / "weights.yaml"
    fitted = json_of(capsys, "fit", photos, "--step", "0.1", "-o", weights)
    assert yaml.safe_load(weights.read_text())["weights"] == fitted["weights"]
    one = json_of(capsys, "convert", photos / "côté nord", tmp_path / "grey", "--weights", weights)
    assert one["weights"] == fitted["weights"]
    exact = pixels_of(photos / "côté nord/c d.jpg").astype(float) @ np.array(fitted["weights"])
    assert np.abs(pixels_of(tmp_path / "grey/c d.png") - exact).max() <= 0.5 + 1e-6


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("weights: [0.5, 0.5, 0.5]\n", "sum to 1.5"), ("weights: [0.5, 0.5]\n", "it holds [0.5, 0.5]"),
        ("weights: '100'\n", "it holds '100'"), ("[1, 0, 0]\n", "it holds [1, 0, 0]"),
        ("weights: ['0.2', '0.3', '0.5']\n", "it holds ['0.2', '0.3', '0.5']"),
        ("weights: [true, 0, 0]\n", "it holds [True, 0, 0]"), ("", "it holds None"),
        ("weights: [1, 0, 0]\nscore: high\n", "not a weights file"),
        ("weights: [0.5\n", "cannot be read"), ("\x00", "cannot be read"), (None, "No such file"),
    ],
)  # fmt: skip
def test_wrong_weights(capsys: Captured, photos: Path, tmp_path: Path, text: str | None, words: str) -> None:
    file = tmp_path / "weights.yaml"
    if text is not None:
        file.write_text(text)
    line = failure_of(capsys, "convert", photos, tmp_path / "grey", "--weights", file)
    assert words in line
    assert str(file) in line
    assert not (tmp_path / "grey").exists()


def test_a_folder_is_no_weights_file(capsys: Captured, photos: Path, tmp_path: Path) -> None:
    line = failure_of(capsys, "convert", photos, tmp_path / "grey", "--weights", photos)
    assert "Is a directory" in line
