"""The command line: exit statuses, one line for each failure, and JSON that holds what it promises."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image
from small_demo import QUICK, ROOT

from colmap_ihe.cli import main
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.commandline import commands
from colmap_ihe.commandline.bars import Bars, left_in_words, print_table
from colmap_ihe.machine.libraries import __version__
from colmap_ihe.pipeline.stages import STAGE_NAMES

Make = Callable[..., Path]
Captured = pytest.CaptureFixture[str]
SETTINGS = [part for assignment in QUICK for part in ("--set", assignment)]


def output_of(capsys: Captured, *arguments: str | Path) -> str:
    """stdout of a command that ends well."""
    status = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    assert status == 0, captured.err
    return captured.out


def json_of(capsys: Captured, *arguments: str | Path) -> Any:
    return json.loads(output_of(capsys, *arguments, "--json"))


def failure_of(capsys: Captured, *arguments: str | Path) -> str:
    """The one line that a command which fails leaves on stderr besides its progress."""
    status = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    assert status == 1
    assert captured.out == ""
    assert "Traceback" not in captured.err
    last = captured.err.splitlines()[-1]
    assert last.startswith("colmap-ihe: ")
    assert sum(line.startswith("colmap-ihe: ") for line in captured.err.splitlines()) == 1
    return last


@pytest.fixture
def photos(small_demo: Path, tmp_path: Path) -> Path:
    """Three JPEGs, one in a subfolder with a name of its own kind."""
    folder = tmp_path / "photos"
    (folder / "côté nord").mkdir(parents=True)
    for number, name in enumerate(["a.jpg", "b.jpg", "côté nord/c d.jpg"], 1):
        shutil.copy2(small_demo / f"images/portico_{number:02}.jpg", folder / name)
    return folder


def run(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "colmap_ihe.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        timeout=120,
        check=False,
    )


# Usage


@pytest.mark.parametrize(
    "arguments",
    [
        *([], ["nonsense"], ["reconstruct"], ["fit"], ["convert", "a"]),
        *(["reconstruct", ".", "--until", "nowhere"], ["reconstruct", ".", "--from", "sparce"]),
        *(
            ["fit", ".", "--method", "best"],
            ["convert", "a", "b", "--format", "gif"],
            ["fit", ".", "--step", "fine"],
        ),
        ["convert", "a", "b", "--method", "red", "--weights", "w.yaml"],
    ],
    ids=" ".join,
)
def test_wrong_usage_exits_with_2(capsys: Captured, arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage: colmap-ihe" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["demo", "reconstruct", "batch", "fit", "convert", "status", "doctor"])
def test_every_command_has_help(capsys: Captured, command: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    assert f"usage: colmap-ihe {command}" in text
    assert "--json" in text
    assert len(text.splitlines()) > 7


def test_the_version_is_printed(capsys: Captured) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"colmap-ihe {__version__}\n"


# fit


@pytest.mark.parametrize("method", ["ihe", "rec709"])
def test_fit_prints_what_it_promises(capsys: Captured, photos: Path, method: str) -> None:
    found = json_of(capsys, "fit", photos, "--step", "0.1", "--method", method)
    assert found.keys() >= {"method", "weights", "score", "tones", "images"}
    assert found["method"] == method
    assert found["images"] == 3
    assert sum(found["weights"]) == pytest.approx(1)
    if method == "ihe":
        assert 0 < found["score"] < 0.1
        assert 200 < found["tones"] <= 256
        assert all(abs(w * 10 - round(w * 10)) < 1e-9 for w in found["weights"])


def test_fit_of_files_and_folders_is_the_same_set(capsys: Captured, photos: Path) -> None:
    whole = json_of(capsys, "fit", photos, "--step", "0.1")
    parts = json_of(capsys, "fit", photos / "côté nord", photos / "b.jpg", photos / "a.jpg", "--step", "0.1")
    assert parts == whole


def test_fit_without_json_prints_a_table(capsys: Captured, photos: Path) -> None:
    text = output_of(capsys, "fit", photos, "--step", "0.1")
    assert "weights" in text
    assert "images" in text


def test_the_curve_of_raw_is_in_the_file_and_not_in_the_table(
    capsys: Captured, small_demo: Path, tmp_path: Path
) -> None:
    raw, file = small_demo / "images/portico_01.dng", tmp_path / "weights.yaml"
    assert "curve" not in output_of(capsys, "fit", raw, "--method", "mean", "-o", file)
    assert len(file.read_text().splitlines()) < 40
    assert len(json_of(capsys, "fit", raw, "--method", "mean")["curve"]) == 255
    (tmp_path / "photos").mkdir()
    shutil.copy(raw, tmp_path / "photos")
    options = ("--weights", file, "--tone", "equalise", "--wallis")
    found = json_of(capsys, "convert", tmp_path / "photos", tmp_path / "grey", *options)
    assert found["grey"] == {"portico_01.dng": "portico_01.png"}


def test_a_photograph_that_is_left_out_is_named(capsys: Captured, photos: Path) -> None:
    (photos / "broken.jpg").write_text("no photograph")
    found = json_of(capsys, "fit", photos, "--step", "0.1")
    assert list(found["left_out"]) == ["broken.jpg"]
    assert found["images"] == 3
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


# convert


def test_convert_writes_grey_images_with_exif(capsys: Captured, photos: Path, tmp_path: Path) -> None:
    found = json_of(capsys, "convert", photos, tmp_path / "grey", "--method", "green")
    assert found["weights"] == [0, 1, 0]
    assert found["grey"] == {
        "a.jpg": "a.png",
        "b.jpg": "b.png",
        "côté nord/c d.jpg": "côté nord/c d.png",
    }
    for source, target in found["grey"].items():
        with Image.open(tmp_path / "grey" / target) as grey, Image.open(photos / source) as rgb:
            assert grey.mode == "L"
            np.testing.assert_array_equal(np.asarray(grey), np.asarray(rgb)[..., 1])
            assert grey.getexif().get_ifd(0x8769)[0x920A] == rgb.getexif().get_ifd(0x8769)[0x920A] == 30


@pytest.mark.parametrize(("file_format", "suffix"), [("tiff", ".tif"), ("jpeg", ".jpg")])
def test_convert_to_other_formats(
    capsys: Captured, photos: Path, tmp_path: Path, file_format: str, suffix: str
) -> None:
    found = json_of(capsys, "convert", photos, tmp_path / "grey", "--method", "mean", "--format", file_format)
    assert {Path(name).suffix for name in found["grey"].values()} == {suffix}
    with Image.open(tmp_path / f"grey/a{suffix}") as grey:
        assert (grey.mode, grey.size) == ("L", (480, 320))


def test_convert_twice_keeps_what_is_there_and_follows_a_change(
    capsys: Captured, photos: Path, tmp_path: Path
) -> None:
    out = tmp_path / "grey"
    arguments = ("convert", photos, out, "--method", "red")
    json_of(capsys, *arguments)
    times = {p: p.stat().st_mtime_ns for p in out.rglob("*.png")}
    assert len(times) == 3
    json_of(capsys, *arguments)
    assert {p: p.stat().st_mtime_ns for p in out.rglob("*.png")} == times
    red = (out / "a.png").read_bytes()
    json_of(capsys, "convert", photos, out, "--method", "blue")
    assert (out / "a.png").read_bytes() != red
    (photos / "b.jpg").unlink()
    json_of(capsys, "convert", photos, out, "--method", "blue")
    assert sorted(p.name for p in out.rglob("*.png")) == ["a.png", "c d.png"]


def test_convert_refuses_a_folder_with_somebodys_files(
    capsys: Captured, photos: Path, tmp_path: Path
) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis/chapter.txt").write_text("mine")
    line = failure_of(capsys, "convert", photos, tmp_path / "thesis", "--method", "red")
    assert "is not empty" in line
    assert [p.name for p in (tmp_path / "thesis").iterdir()] == ["chapter.txt"]


def test_convert_again_leaves_files_that_somebody_put_beside(
    capsys: Captured, photos: Path, tmp_path: Path
) -> None:
    json_of(capsys, "convert", photos, tmp_path / "grey", "--method", "red")
    (tmp_path / "grey/survey.psx").write_text("the project of another program")
    main(["convert", str(photos), str(tmp_path / "grey"), "--method", "blue", "-q"])
    assert (tmp_path / "grey/survey.psx").exists()


@pytest.mark.parametrize("place", ["photos", "photos/grey", "."])
def test_convert_refuses_the_folder_of_photographs(
    capsys: Captured, photos: Path, tmp_path: Path, place: str
) -> None:
    before = sorted(p.name for p in photos.rglob("*"))
    line = failure_of(capsys, "convert", photos, tmp_path / place, "--method", "red")
    assert "lies in the folder of photographs or holds it" in line
    assert sorted(p.name for p in photos.rglob("*")) == before


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
    with Image.open(photos / "côté nord/c d.jpg") as rgb, Image.open(tmp_path / "grey/c d.png") as grey:
        exact = np.asarray(rgb).astype(float) @ np.array(fitted["weights"])
        assert np.abs(np.asarray(grey) - exact).max() <= 0.5 + 1e-6


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("weights: [0.5, 0.5, 0.5]\n", "sum to 1.5"),
        ("weights: [.nan, 0.5, 0.5]\n", "sum to nan"),
        ("weights: [.inf, 0, 0]\n", "sum to inf"),
        ("weights: [-0.5, 1, 0.5]\n", "expected three numbers in 0..1"),
        ("weights: [0.5, 0.5]\n", "it holds [0.5, 0.5]"),
        ("weights: [0.2, 0.2, 0.2, 0.4]\n", "it holds [0.2, 0.2, 0.2, 0.4]"),
        ("weights: ['0.2', '0.3', '0.5']\n", "it holds ['0.2', '0.3', '0.5']"),
        ("weights: '100'\n", "it holds '100'"),
        ("weights: [true, 0, 0]\n", "it holds [True, 0, 0]"),
        ("weights: [1, 0, 0]\nscore: high\n", "not a weights file"),
        ("weights: [1, 0, 0]\nencoding: gamma\n", "encoding 'gamma'"),
        ("weights: [1, 0, 0]\nencoding: linear\nwhite: .nan\n", "with white nan"),
        ("[1, 0, 0]\n", "it holds [1, 0, 0]"),
        ("nothing: here\n", "not a weights file"),
        ("weights: [0.5\n", "cannot be read"),
        ("\x00", "cannot be read"),
        ("", "not a weights file"),
        (None, "No such file"),
    ],
)
def test_weights_files_that_are_none(
    capsys: Captured, photos: Path, tmp_path: Path, text: str | None, words: str
) -> None:
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


def test_weights_for_raw_are_not_for_jpeg(capsys: Captured, photos: Path, tmp_path: Path) -> None:
    (tmp_path / "w.yaml").write_text("weights: [0.3, 0.3, 0.4]\nencoding: linear\nwhite: 0.5\n")
    line = failure_of(capsys, "convert", photos, tmp_path / "grey", "--weights", tmp_path / "w.yaml")
    assert "a coded photograph, and the weights are for linear ones" in line


# reconstruct and status


def test_reconstruct_prints_its_summary(capsys: Captured, finished: Path) -> None:
    found = json_of(capsys, "reconstruct", finished, *SETTINGS)
    assert found["registered_images"] == 8
    text = output_of(capsys, "reconstruct", finished, *SETTINGS)
    assert "8 of 8" in text
    assert str(finished / "workspace/sparse/0") in text
    assert str(finished / "workspace/dense/0/fused.ply") in text
    assert str(finished / "workspace/dense/0/mesh.ply") in text


def test_progress_goes_to_stderr_and_can_be_left_out(capsys: Captured, new_project: Make) -> None:
    project = new_project(2)
    main(["reconstruct", str(project), "--until", "convert", "--json", *SETTINGS])
    captured = capsys.readouterr()
    json.loads(captured.out)
    for stage in STAGE_NAMES[:3]:
        assert f"{stage}  " in captured.err
    main(["reconstruct", str(project), "--until", "convert", "-q", "--from", "fit", *SETTINGS])
    assert capsys.readouterr().err == ""


def test_a_run_as_lines_of_json(capsys: Captured, new_project: Make) -> None:
    project = new_project(2)
    (project / "images/broken.jpg").write_bytes(b"no photograph")
    assert main(["reconstruct", str(project), "--until", "convert", "--json-lines", *SETTINGS]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    events = [json.loads(line) for line in captured.out.splitlines()]
    assert [e["stage"] for e in events if e["event"] == "done"] == ["content", *STAGE_NAMES[:3]]
    last = [e for e in events if e["event"] == "progress" and e["stage"] == "convert"][-1]
    assert (last["done"], last["total"], last["unit"]) == (2, 2, "images")
    assert last["run_seconds_left"] >= last["stage_seconds_left"] >= 0
    assert any("broken.jpg" in e["text"] for e in events if e["event"] == "warning")
    assert (events[-1]["event"], events[-1]["result"]["images"]) == ("result", 3)
    assert main(["reconstruct", str(project / "gone"), "--json-lines"]) == 1
    event = json.loads(capsys.readouterr().out)
    assert (event["event"], bool(event["message"]), bool(event["hint"])) == ("failed", True, True)


def test_what_is_said_aloud(new_project: Make) -> None:
    project = new_project(2)
    loud = run("reconstruct", project, "--until", "features", "-v", *SETTINGS)
    assert loud.returncode == 0
    assert "features  took" in loud.stderr
    assert "feature_extraction.cc" in loud.stderr  # COLMAP's own words
    plain = run("reconstruct", project, "--until", "features", "--from", "features", *SETTINGS)
    assert ".cc" not in plain.stderr
    assert "\x1b" not in loud.stdout + loud.stderr + plain.stdout + plain.stderr


@pytest.mark.parametrize(
    ("stage", "whole", "words"),
    [
        (None, None, ""),
        (None, 65.2, "1:05 left"),
        (20.0, 20.4, "0:20 left"),
        (20.0, 7321.0, "0:20 left, 2:02:01 in all"),
    ],
)
def test_what_remains_in_words(stage: float | None, whole: float | None, words: str) -> None:
    assert left_in_words(stage, whole) == words


def test_status_as_table_and_json(capsys: Captured, finished: Path) -> None:
    states = json_of(capsys, "status", finished, *SETTINGS)
    assert [(s["name"], s["state"]) for s in states] == [(name, "done") for name in STAGE_NAMES]
    states = json_of(capsys, "status", finished, *SETTINGS, "--set", "sparse.seed=3")
    assert [s["state"] for s in states] == ["done"] * 5 + ["stale"] * 3
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


@pytest.mark.parametrize(
    ("assignment", "words"),
    [("fit.stepp=0.1", "unknown option 'fit.stepp'"), ("step", "wanted stage.option=value")],
)
def test_a_bad_assignment_is_one_line(
    capsys: Captured, new_project: Make, assignment: str, words: str
) -> None:
    assert words in failure_of(capsys, "reconstruct", new_project(2), "--set", assignment)


def test_missing_and_empty_projects(capsys: Captured, tmp_path: Path) -> None:
    assert "no such folder of photographs" in failure_of(capsys, "reconstruct", tmp_path / "missing")
    (tmp_path / "images").mkdir()
    assert "it is empty" in failure_of(capsys, "reconstruct", tmp_path)


def test_strict_and_no_dense_are_options(capsys: Captured, new_project: Make) -> None:
    project = new_project(2)
    (project / "images/broken.jpg").write_text("no photograph")
    assert "broken.jpg" in failure_of(capsys, "reconstruct", project, "--strict")
    found = json_of(capsys, "reconstruct", project, "--until", "captures", "--no-dense")
    assert list(found["left_out"]) == ["broken.jpg"]


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


def test_half_of_what_a_focal_length_needs_is_one_line(
    capsys: Captured, new_project: Make, tmp_path: Path
) -> None:
    project = new_project(3)
    without_exif(project)
    for command in (("reconstruct", project), ("convert", project / "images", tmp_path / "out")):
        line = failure_of(capsys, *command, "--focal-length", "30")
        assert "the width of the sensor of portico_01.jpg is neither given nor in EXIF" in line
        assert "sensor_width" in line
    assert "greater than 0" in failure_of(capsys, "reconstruct", project, "--focal-length", "-3")
    assert "nan" in failure_of(capsys, "reconstruct", project, "--sensor-width", "nan")


def test_convert_fills_in_a_focal_length(capsys: Captured, new_project: Make, tmp_path: Path) -> None:
    project = new_project(3)
    without_exif(project)
    lens = ("--focal-length", "30", "--sensor-width", "36", "--method", "green")
    output_of(capsys, "convert", project / "images", tmp_path / "out", *lens)
    camera = pycolmap.infer_camera_from_image(tmp_path / "out/portico_02.png")
    assert (camera.has_prior_focal_length, camera.params[0]) == (True, pytest.approx(400, rel=1e-5))


def test_an_unforeseen_error_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    """A bug is a bug: hiding it in one line would help nobody."""

    def broken(*_: object) -> dict[str, Any]:
        raise RuntimeError("a bug")

    monkeypatch.setattr(commands, "doctor", broken)
    with pytest.raises(RuntimeError, match="a bug"):
        main(["doctor"])


def test_ctrl_c_exits_with_130(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> dict[str, Any]:
        raise KeyboardInterrupt

    monkeypatch.setattr(commands, "doctor", interrupted)
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "colmap-ihe: stopped; the same command goes on from here\n"


def test_doctor_says_what_is_there(capsys: Captured) -> None:
    found = json_of(capsys, "doctor")
    assert found["colmap-ihe"] == __version__
    assert found["dense_backend"] == ("patchmatch" if found["cuda"] else "sgm")
    assert found["cores"] >= 1
    assert found["memory_gb"] > 0.1
    assert {"python", "pycolmap", "numpy", "rawpy", "free_disk_gb"} <= found.keys()
    assert "dense_backend" in output_of(capsys, "doctor")


def test_doctor_says_what_dense_stereo_of_a_project_will_take(photos: Path, capsys: Captured) -> None:
    project = ("doctor", photos.parent, "--images", photos)
    found = json_of(capsys, *project, "--set", "dense.backend=sgm")
    assert found["dense_images"] == len(list(photos.iterdir()))
    assert found["dense_megapixels"] > 0
    assert found["dense_maps_at_once"] >= 1
    assert {"dense_memory_gb", "dense_disk_gb", "dense_minutes"} <= found.keys()
    smaller = json_of(capsys, *project, "--set", "dense.backend=sgm", "--set", "dense.max_image_size=64")
    assert smaller["dense_megapixels"] <= found["dense_megapixels"]
    assert main(["doctor", str(photos / "missing")]) == 1
    assert "missing" in capsys.readouterr().err


# In a process of its own


def test_the_command_as_a_process(photos: Path, tmp_path: Path) -> None:
    done = run("fit", photos, "--step", "0.1", "--json")
    assert done.returncode == 0
    assert len(json.loads(done.stdout)["weights"]) == 3
    failed = run("fit", tmp_path / "missing")
    assert failed.returncode == 1
    assert (failed.stdout, len(failed.stderr.splitlines())) == ("", 1)
    assert run("fit").returncode == 2


def test_a_broken_tiff_leaves_no_warnings_of_libraries(photos: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (80, 80, 3), np.uint8)
    Image.fromarray(noise).save(photos / "half.tif", compression="tiff_lzw")
    whole = (photos / "half.tif").read_bytes()
    (photos / "half.tif").write_bytes(whole[: len(whole) // 2])
    done = run("fit", photos, "--step", "0.1", "--json", "-q")
    assert done.returncode == 0
    assert list(json.loads(done.stdout)["left_out"]) == ["half.tif"]
    assert "Warning:" not in done.stderr
    assert "site-packages" not in done.stderr


@pytest.mark.parametrize("unbuffered", ["1", pytest.param("")])
def test_a_pipe_that_closes_early_is_no_error(unbuffered: str) -> None:
    """As `colmap-ihe doctor | head`. Python writes at once where it is told to, else as it ends."""
    reader = subprocess.Popen(["true"], stdin=subprocess.PIPE)
    assert reader.stdin is not None
    try:
        reader.wait(60)
        done = subprocess.run(
            [sys.executable, "-m", "colmap_ihe.cli", "doctor", "--json"],
            stdout=reader.stdin,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": unbuffered},
            timeout=60,
            check=False,
        )
    finally:
        reader.stdin.close()
    assert done.stderr == ""
    assert done.returncode == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full to write to")
def test_results_that_find_no_room_are_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "colmap_ihe.cli", "doctor", "--json"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            timeout=60,
            check=False,
        )
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1


# A disk without room


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """`small_disk("1m")`: a file system of that size; skips where one cannot be mounted."""
    places = []

    def make(size: str) -> Path:
        place = tmp_path / "disk"
        place.mkdir()
        try:
            mounted = subprocess.run(
                ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)],
                capture_output=True,
                text=True,
                check=False,
            )
        except FileNotFoundError:
            pytest.skip("there is no mount command to make a small disk with")
        if mounted.returncode:
            pytest.skip(f"a small disk cannot be mounted: {mounted.stderr.strip()}")
        places.append(place)
        return place

    yield make
    for place in places:
        subprocess.run(["umount", "-l", str(place)], check=True)


def test_convert_onto_a_full_disk(capsys: Captured, photos: Path, small_disk: Callable[[str], Path]) -> None:
    disk = small_disk("100k")
    line = failure_of(capsys, "convert", photos, disk / "grey", "--method", "red")
    assert "no room left on this disk" in line
    assert "make room" in line
    assert not list(disk.rglob("*.tmp"))


@pytest.mark.parametrize("size", [pytest.param("40k", marks=pytest.mark.slow), "1m"])
def test_reconstruct_on_a_full_disk(
    capsys: Captured, new_project: Make, small_disk: Callable[[str], Path], size: str
) -> None:
    images, disk = new_project() / "images", small_disk(size)
    line = failure_of(capsys, "reconstruct", disk / "project", "--images", images, *SETTINGS)
    assert "no room left" in line or "free on this disk" in line
    assert "the same command goes on from here" in line


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


def test_nothing_that_a_file_says_steers_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    bars = Bars(quiet=True)
    odd = "a\x1b]0;title\x07\x1b[2Jb\u202ec\nd\ud800 [red]x[/] é"
    bars.warn(odd)
    bars.failed(odd, odd)
    print_table("", [(odd, odd)])
    out, err = capsys.readouterr()
    for text in (out, err):
        assert "\\x1b]0;title\\x07" in text and "\\u202e" in text and "[red]x[/] é" in text
        assert not {"\x1b", "\x07", "\u202e"} & set(text)
