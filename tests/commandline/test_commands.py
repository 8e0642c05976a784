"""The commands: one line for each failure, and JSON that holds what it promises."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from command_line import Captured, failure_of, json_of, output_of
from PIL import Image
from small_demo import SETTINGS, Make

from colmap_ihe.cli import main
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline import commands
from colmap_ihe.machine.libraries import __version__
from colmap_ihe.pipeline.reconstruct import Reconstruction
from colmap_ihe.pipeline.stages import STAGE_NAMES
from colmap_ihe.project.folder import Project


@pytest.mark.parametrize("method", ["ihe", "rec709"])
def test_fit_prints_what_it_promises(capsys: Captured, photos: Path, method: str) -> None:
    result = json_of(capsys, "fit", photos, "--step", "0.1", "--method", method)
    assert result.keys() >= {"method", "weights", "score", "tones", "images"}
    assert result["method"] == method
    assert result["images"] == 3
    assert sum(result["weights"]) == pytest.approx(1)
    if method == "ihe":
        assert 0 < result["score"] < 0.1
        assert 200 < result["tones"] <= 256
        assert all(abs(w * 10 - round(w * 10)) < 1e-9 for w in result["weights"])


def test_fit_of_files_and_folders_is_the_same_set(capsys: Captured, photos: Path) -> None:
    whole = json_of(capsys, "fit", photos, "--step", "0.1")
    parts = json_of(capsys, "fit", photos / "côté nord", photos / "b.jpg", photos / "a.jpg", "--step", "0.1")
    assert parts == whole


def test_fit_by_trial_says_what_was_tried(capsys: Captured, small_demo: Path, tmp_path: Path) -> None:
    tmp_path = tmp_path / "photos"
    tmp_path.mkdir()
    for name in ("portico_04.jpg", "portico_05.jpg"):
        shutil.copy(small_demo / "images" / name, tmp_path)
    result = json_of(capsys, "fit", tmp_path, "--step", "0.1", "--method", "auto")
    tried = result["tried"]
    assert tried["pairs"] == [["portico_04.jpg", "portico_05.jpg"]]
    assert {"rec709", "ihe", "ihe of the paper", "snr", "mean", "green"} <= set(tried["candidates"])
    assert tried["chosen"] in tried["candidates"] and "verified matches" in tried["in_words"]
    assert tried["in_words"][:30] in output_of(capsys, "fit", tmp_path, "--step", "0.1", "--method", "auto")
    assert json_of(capsys, "fit", tmp_path, "--step", "0.1")["tried"] is None
    convert = ("convert", tmp_path, tmp_path.parent / "out", "--method", "auto")
    first, again = json_of(capsys, *convert), json_of(capsys, *convert)
    assert first["tried"] == again["tried"]
    assert first["tried"]["pairs"] == tried["pairs"]
    assert f"measured  {first['tried']['chosen']}: " in output_of(capsys, *convert)
    assert (
        json_of(capsys, "convert", tmp_path, tmp_path.parent / "other", "--method", "green")["tried"] is None
    )


def test_the_curve_of_raw_is_in_the_file_alone(capsys: Captured, small_demo: Path, tmp_path: Path) -> None:
    raw, file = small_demo / "images/portico_01.dng", tmp_path / "weights.yaml"
    assert "curve" not in output_of(capsys, "fit", raw, "--method", "mean", "-o", file)
    assert len(file.read_text().splitlines()) < 40
    assert len(json_of(capsys, "fit", raw, "--method", "mean")["curve"]) == 255
    (tmp_path / "photos").mkdir()
    shutil.copy(raw, tmp_path / "photos")
    options = ("--weights", file, "--tone", "equalise", "--wallis")
    result = json_of(capsys, "convert", tmp_path / "photos", tmp_path / "grey", *options)
    assert result["grey"] == {"portico_01.dng": "portico_01.png"}


def test_a_photograph_that_is_left_out_is_named(capsys: Captured, photos: Path) -> None:
    (photos / "broken.jpg").write_text("no photograph")
    result = json_of(capsys, "fit", photos, "--step", "0.1")
    assert list(result["left_out"]) == ["broken.jpg"]
    assert result["images"] == 3
    assert "broken.jpg" in failure_of(capsys, "fit", photos, "--step", "0.1", "--strict")


def test_fit_failures(capsys: Captured, photos: Path, tmp_path: Path) -> None:
    assert "no such photograph" in failure_of(capsys, "fit", tmp_path / "missing")
    (photos / "notes.txt").touch()
    assert "notes.txt" in failure_of(capsys, "fit", photos / "notes.txt")
    assert ".yaml" in failure_of(capsys, "fit", photos, "-o", tmp_path / "weights.txt")
    assert "0.03" in failure_of(capsys, "fit", photos, "--step", "0.03")
    assert "fit.sample" in failure_of(capsys, "fit", photos, "--sample", "2")
    (tmp_path / "empty").mkdir()
    assert "it is empty" in failure_of(capsys, "fit", tmp_path / "empty")


def test_reconstruct_prints_its_summary(capsys: Captured, finished: Path) -> None:
    result = json_of(capsys, "reconstruct", finished, *SETTINGS)
    assert result["registered_images"] == 8
    text = output_of(capsys, "reconstruct", finished, *SETTINGS)
    assert "8 of 8" in text
    assert str(finished / "workspace/sparse/0") in text
    assert str(finished / "workspace/dense/0/fused.ply") in text
    assert str(finished / "workspace/dense/0/mesh.glb") in text
    assert str(finished / "report/index.html") in text
    assert f"cameras   {finished / 'report/calibration.yaml'}" in text
    assert re.search(r"camera  .*focal length (39|40|41)\d\.\d ± \d", text)
    assert re.search(r"dense \d+ s, mesh \d+ s, drawings \d+ s, page \d+ s: ", text)


def test_the_page_of_an_earlier_run_is_not_named(capsys: Captured, finished: Path) -> None:
    text = output_of(capsys, "reconstruct", finished, *SETTINGS, "--from", "fit", "--until", "convert")
    assert "index.html" not in text and "calibration.yaml" not in text
    assert str(finished / "report/summary.json") in text


def test_the_folder_of_photographs_is_not_taken_for_the_project(capsys: Captured, photos: Path) -> None:
    images = photos.parent / "images"
    photos.rename(images)
    line = failure_of(capsys, "reconstruct", images)
    assert f"{images}: is the folder of the photographs" in line and f"(name {images.parent})" in line
    assert "images/images" not in line


def test_targets_writes_sheets_and_says_what_is_on_them(capsys: Captured, tmp_path: Path) -> None:
    sheet = tmp_path / "a.pdf"
    said = output_of(capsys, "targets", "--sheet", sheet, "--size", "50", "--count", "7", "--first", "4")
    assert said.startswith(f"T4 to T10 on 2 sheets of A4 in {sheet}; print at 100 %")
    result = json_of(capsys, "targets", "--sheet", tmp_path / "b.pdf", "--count", "1")
    assert (result["targets"], result["pages"], result["size_mm"]) == (["T0"], 1, 60)
    assert f"{sheet}: is there already" in failure_of(capsys, "targets", "--sheet", sheet)


def test_status_as_table_and_json(capsys: Captured, finished: Path) -> None:
    states = json_of(capsys, "status", finished, *SETTINGS)
    assert [(s["name"], s["state"]) for s in states] == [(name, "done") for name in STAGE_NAMES]
    states = json_of(capsys, "status", finished, *SETTINGS, "--set", "sparse.seed=3")
    assert [s["state"] for s in states] == ["done"] * 5 + ["stale"] * 5
    text = output_of(capsys, "status", finished, *SETTINGS, "--set", "sparse.seed=3")
    assert "its options changed" in text
    assert "no such folder of photographs" in failure_of(capsys, "status", finished / "missing")


def test_options_in_the_project_file_count(capsys: Captured, new_project: Make) -> None:
    project = new_project(2)
    (project / "project.yaml").write_text("fit: {method: blue}\n")
    assert json_of(capsys, "reconstruct", project, "--until", "fit")["weights"] == [0, 0, 1]
    (project / "project.yaml").write_text("fit: {methods: blue}\n")
    assert "unknown option 'fit.methods'" in failure_of(capsys, "reconstruct", project)
    assert "unknown option 'fit.methods'" in failure_of(capsys, "status", project)


def test_strict_and_no_dense_are_options(capsys: Captured, new_project: Make) -> None:
    project = new_project(2)
    (project / "images/broken.jpg").write_text("no photograph")
    assert "broken.jpg" in failure_of(capsys, "reconstruct", project, "--strict")
    result = json_of(capsys, "reconstruct", project, "--until", "captures", "--no-dense")
    assert list(result["left_out"]) == ["broken.jpg"]


def without_exif(project: Path) -> None:
    for file in (project / "images").iterdir():
        with Image.open(file) as image:
            image.convert("RGB").save(file)


def test_a_focal_length_on_the_command_line_reaches_colmap(capsys: Captured, new_project: Make) -> None:
    """The demo's lens is 30 mm on 36 mm: 400 pixels of 480. Without --focal-length the same run is stale."""
    project = new_project(3)
    without_exif(project)
    lens = ("--focal-length", "30", "--sensor-width", "36")
    assert main(["reconstruct", str(project), "--until", "features", "-q", *lens, *SETTINGS]) == 0
    assert "focal length" not in capsys.readouterr().err
    record = json.loads((project / "records/features.json").read_text())
    assert (record["cameras"], record["with_focal_prior"]) == (1, 3)
    camera = pycolmap.infer_camera_from_image(project / "workspace/images/portico_01.png")
    assert camera.params[0] == pytest.approx(400, rel=1e-5)
    states = {s["name"]: s["state"] for s in json_of(capsys, "status", project, *lens, *SETTINGS)}
    assert states["features"] == "done"
    states = {s["name"]: s["state"] for s in json_of(capsys, "status", project, *SETTINGS)}
    assert states["captures"] == states["features"] == "stale"


def test_half_of_what_a_focal_length_needs(capsys: Captured, new_project: Make, tmp_path: Path) -> None:
    project = new_project(3)
    without_exif(project)
    for command in (("reconstruct", project), ("convert", project / "images", tmp_path / "out")):
        line = failure_of(capsys, *command, "--focal-length", "30")
        assert "the width of the sensor of portico_01.jpg is neither given nor in EXIF" in line
        assert "sensor_width" in line
    assert "greater than 0" in failure_of(capsys, "reconstruct", project, "--focal-length", "-3")
    assert "nan" in failure_of(capsys, "reconstruct", project, "--sensor-width", "nan")


def test_doctor_says_what_is_there(capsys: Captured) -> None:
    result = json_of(capsys, "doctor")
    assert result["colmap-ihe"] == __version__
    assert result["dense_backend"] == ("patchmatch" if result["cuda"] else "sgm")
    assert result["cores"] >= 1
    assert result["memory_gb"] > 0.1
    assert {"python", "pycolmap", "numpy", "rawpy", "free_disk_gb"} <= result.keys()
    assert "dense_backend" in output_of(capsys, "doctor")
    assert re.match(r"enough for photographs, at the most: [\d,]+ of 12 megapixels, ", result["verdict"])


def test_doctor_says_what_dense_stereo_of_a_project_will_take(photos: Path, capsys: Captured) -> None:
    project = ("doctor", photos.parent, "--images", photos)
    result = json_of(capsys, *project, "--set", "dense.backend=sgm")
    assert result["dense_images"] == len(list(photos.iterdir()))
    assert result["dense_megapixels"] > 0
    assert result["dense_maps_at_once"] >= 1
    assert {"dense_memory_gb", "dense_disk_gb", "dense_minutes"} <= result.keys()
    assert result["verdict"].startswith("enough: up to ")
    assert re.search(r"of memory, .* on disk, about \d+ min$", result["dense_will_take"])
    smaller = json_of(capsys, *project, "--set", "dense.backend=sgm", "--set", "dense.max_image_size=64")
    assert smaller["dense_megapixels"] <= result["dense_megapixels"]
    assert main(["doctor", str(photos / "missing")]) == 1
    assert "missing" in capsys.readouterr().err


def test_the_demo_names_the_files_that_it_made_and_no_others(
    capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "images").mkdir()
    project = Project.at(tmp_path)
    (project.sparse / "0").mkdir(parents=True)
    summary: dict[str, Any] = {
        "metric": False,
        "mesh_texture": None,
        "cameras": [],
        "stages": {"sparse": 1.0, "dense": None},
    }
    monkeypatch.setattr(commands, "demo", lambda *_: Reconstruction(project, summary, ("sparse",)))
    monkeypatch.setattr(commands, "print_summary", lambda *_, **__: None)
    lines = output_of(capsys, "demo", tmp_path).splitlines()
    assert [line.split()[0] for line in lines] == ["report", "sparse"]


def test_a_disk_that_fills_up_while_images_are_written(
    capsys: Captured, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a mount: the system says so at the second file that is flushed."""
    calls = [0]

    def full(_: int) -> None:
        calls[0] += 1
        if calls[0] > 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    line = failure_of(capsys, "convert", photos, tmp_path / "grey", "--method", "red")
    assert "no room left on this disk" in line
    assert not list((tmp_path / "grey").rglob("*.tmp"))
