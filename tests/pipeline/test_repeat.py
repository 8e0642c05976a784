"""A run that is run again from what it noted."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from calibrations import calibrated
from small_demo import QUICK, Make

from colmap_ihe.cli import main
from colmap_ihe.colmap.calibration_file import write_calibration
from colmap_ihe.errors import OptionError
from colmap_ihe.machine import system
from colmap_ihe.machine.threads import local_workers
from colmap_ihe.pipeline.repeat import differences_from, read_run
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import load_options

WEIGHTS = "method: given\nweights: [0.5, 0.25, 0.25]\n"


def repeat(project: Path, folder: Path, until: str) -> list[str]:
    """The arguments of a run on a project's photographs, in `folder`."""
    images = ["--images", str(project / "images")]
    return ["reconstruct", str(folder / "again"), *images, "--until", until]


def test_the_same_again_elsewhere(
    new_project: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = new_project(3)
    settings = [part for assignment in QUICK for part in ("--set", assignment)]
    arguments = ["--until", "convert", "--set", "fit.method=green", *settings]
    assert main(["reconstruct", str(project), *arguments]) == 0
    capsys.readouterr()
    again = repeat(project, tmp_path, "convert")
    assert main([*again, "--from-record", str(project)]) == 0
    assert "warning" not in capsys.readouterr().err
    for image in sorted((project / "workspace/images").iterdir()):
        assert (tmp_path / "again/workspace/images" / image.name).read_bytes() == image.read_bytes()
    assert (tmp_path / "again/records/run.json").read_bytes() == (project / "records/run.json").read_bytes()

    (project / "images/portico_02.jpg").unlink()
    record = json.loads((project / "records/run.json").read_text())
    record["versions"]["pycolmap"] = "3.0"
    (tmp_path / "old.json").write_text(json.dumps(record))
    assert main([*again, "--from-record", str(tmp_path / "old.json"), "--set", "fit.method=mean"]) == 0
    said = capsys.readouterr()
    assert "of pycolmap 3.0, this is" in said.err
    assert "1 photographs of the record are not here: portico_02.jpg" in said.err
    assert read_run(tmp_path / "again").options.fit.method == "mean"


def test_what_is_unlike_is_counted(new_project: Make) -> None:
    project = new_project(2)
    assert main(["reconstruct", str(project), "--until", "captures", "-q"]) == 0
    noted = read_run(project)
    names = sorted(noted.photographs)
    place = Project.at(project)
    (project / "masks").mkdir()
    (project / "masks/new.jpg.png").write_bytes(b"a mask")
    (project / "weights.yaml").write_text("of another campaign")
    given = load_options(None, ["fit.weights=weights.yaml"])
    said = differences_from(noted, place, given, {names[0]: [1, 2, "another"], "new.jpg": [1, 2, "x"]})
    assert [text.split(":")[0] for text in said] == [
        "1 photographs of the record are not here",
        "1 photographs are not in the record",
        "1 photographs have another content than in the record",
        "1 masks are not in the record",
        "the weights file has another content than in the record",
    ]


def test_a_record_holds_what_a_result_depends_on_and_not_whose_it_is(
    new_project: Make, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    project = new_project(2)
    monkeypatch.setenv("OPENBLAS_VERBOSE", "2")
    monkeypatch.setenv("OPENCV_LOG_FILE", "/home/somebody/opencv.log")
    settings = ["--set", "sparse.seed=7", "--threads", "1", "--until", "captures", "-q"]
    assert main(["reconstruct", str(project), *settings, "--set", "cluster.patience=5"]) == 0
    text = (project / "records/run.json").read_text()
    record = json.loads(text)
    assert (record["seed"], record["threads"], record["options"]["machine"]) == (7, 1, {"threads": 1})
    assert record["environment"]["OPENBLAS_VERBOSE"] == "2"
    assert record["environment"]["OPENCV_LOG_FILE"] == "(not told)"
    assert {"python", "pycolmap", "COLMAP", "numpy", "pillow", "code of colmap-ihe"} <= set(
        record["versions"]
    )
    assert record["machine"]["cores"] >= 1
    assert record["machine"]["instructions"] or system.fcntl is None  # as only Linux tells them
    assert "cluster" not in record["options"]
    assert [word for word in (str(project), "somebody", "login1") if word in text] == []

    record["machine"]["instructions"] = ["sse4_2"]
    record["versions"]["numpy"] = "1.0"
    del record["environment"]["OPENBLAS_VERBOSE"]
    (project / "old.json").write_text(json.dumps(record))
    again = ["reconstruct", str(project), "--until", "captures", "--from-record", str(project / "old.json")]
    capsys.readouterr()
    assert main([*again, "--set", "machine.threads=null"]) == 0
    said = " ".join(capsys.readouterr().err.split())
    for words in (
        "of instructions sse4_2, this is",
        "of numpy 1.0, this is",
        "of OPENBLAS_VERBOSE none, this is 2",
    ):
        assert words in said
    assert ("of 1 threads, this is of" in said) == (local_workers() > 1)


def test_weights_of_a_record_are_those_of_its_project(new_project: Make, tmp_path: Path) -> None:
    project = new_project(2)
    (project / "given.yaml").write_text(WEIGHTS, encoding="utf-8")
    settings = ["--set", "fit.weights=given.yaml", "--set", "fit.measure=false", "--until", "fit", "-q"]
    assert main(["reconstruct", str(project), *settings]) == 0
    again = [*repeat(project, tmp_path, "fit"), "-q"]
    assert main([*again, "--from-record", str(project)]) == 0
    assert (tmp_path / "again/report/weights.yaml").read_bytes() == (
        project / "report/weights.yaml"
    ).read_bytes()


def test_a_calibration_of_a_record_is_that_of_its_project(new_project: Make, tmp_path: Path) -> None:
    project = new_project(2)
    write_calibration(project / "given.yaml", [calibrated()])
    settings = ["--set", "camera.calibration=given.yaml", "--until", "captures", "-q"]
    assert main(["reconstruct", str(project), *settings]) == 0
    noted = read_run(project)
    assert noted.options.camera.calibration == str(project / "given.yaml")
    assert read_run(project, ["camera.calibration=other.yaml"]).options.camera.calibration == "other.yaml"
    assert main([*repeat(project, tmp_path, "captures"), "-q", "--from-record", str(project)]) == 0
    elsewhere = f"camera.calibration={tmp_path}/elsewhere.yaml"
    write_calibration(tmp_path / "elsewhere.yaml", [calibrated()])
    assert main(["reconstruct", str(project), "--set", elsewhere, "--until", "captures", "-q"]) == 0
    assert read_run(project, ["camera.calibration=given.yaml"]).options.camera.calibration == "given.yaml"
    write_calibration(project / "given.yaml", [calibrated(focal=50)])
    digests = {name: [digest] for name, digest in noted.photographs.items()}
    differences = differences_from(noted, Project.at(project), noted.options, digests)
    assert differences == ["the calibration file has another content than in the record"]


@pytest.mark.parametrize(
    "content", [None, "", "[]", "{}", '{"options": {}, "versions": 1, "photographs": {}}']
)
def test_what_is_no_record_is_refused(tmp_path: Path, content: str | None) -> None:
    if content is not None:
        (tmp_path / "run.json").write_text(content)
    with pytest.raises(OptionError, match="not the record of a run"):
        read_run(tmp_path / "run.json")


def test_options_of_a_record_are_checked_as_any(tmp_path: Path) -> None:
    record = {"options": {"fit": {"method": "gone"}}, "versions": {}, "photographs": {}}
    (tmp_path / "run.json").write_text(json.dumps(record))
    with pytest.raises(OptionError, match=r"run.json: fit.method is 'gone'"):
        read_run(tmp_path / "run.json")
