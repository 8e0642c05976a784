"""A run that is run again from what it noted."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import QUICK

from colmap_ihe.again import read_run, unlike
from colmap_ihe.cli import main
from colmap_ihe.errors import OptionError

Make = Callable[..., Path]


def test_the_same_again_elsewhere(
    new_project: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    project = new_project(3)
    settings = [part for assignment in QUICK for part in ("--set", assignment)]
    arguments = ["--until", "convert", "--set", "fit.method=green", *settings]
    assert main(["reconstruct", str(project), *arguments]) == 0
    capsys.readouterr()
    again = [
        "reconstruct",
        str(tmp_path / "again"),
        "--images",
        str(project / "images"),
        "--until",
        "convert",
    ]
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
    said = unlike(noted, {names[0]: [1, 2, "another"], "new.jpg": [1, 2, "x"]})
    assert [text.split(":")[0] for text in said] == [
        "1 photographs of the record are not here",
        "1 photographs are not in the record",
        "1 photographs have another content than in the record",
    ]


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
