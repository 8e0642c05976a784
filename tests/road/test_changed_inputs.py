"""Something changed: exactly the stages that depend on it run again, and `status` says which and why beforehand.

The photographs are real, and so is what decides; what the stages themselves would do is put in their place.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import colmap_ihe.machine.libraries as versions
from colmap_ihe.photographs.png import encode_png
from colmap_ihe.pipeline import reconstruct as pipeline
from colmap_ihe.pipeline import records, run_stages
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.records import read_record
from colmap_ihe.pipeline.stage import RunContext, Stage, StageRecord
from colmap_ihe.pipeline.stages import STAGE_NAMES, STAGES
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import load_options

ALL = STAGE_NAMES


def since(stage: str) -> tuple[str, ...]:
    return STAGE_NAMES[STAGE_NAMES.index(stage) :]


@pytest.fixture
def quick_stages(_finished: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each stage leaves what it left in the finished project, at once."""
    _quicken(Project.at(_finished[0]), monkeypatch)


@pytest.fixture(scope="module")
def _settled(_finished: tuple[Path, dict[str, Any]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The finished project as if it had been run with the defaults."""
    project = tmp_path_factory.mktemp("settled") / "project"
    shutil.copytree(_finished[0], project)
    with pytest.MonkeyPatch.context() as patch:
        _quicken(Project.at(_finished[0]), patch)
        reconstruct(project)
    return project


@pytest.fixture
def settled(_settled: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(_settled, tmp_path / "project"))


def _quicken(whole: Project, monkeypatch: pytest.MonkeyPatch) -> None:

    def as_before(stage: Stage) -> Callable[[RunContext, Any], StageRecord]:
        def run_stage(run: RunContext, _progress: object) -> StageRecord:
            record = read_record(whole, stage.name)
            assert record is not None
            for file in stage.files(whole, record):
                copy = run.project.root / file.relative_to(whole.root)
                copy.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(file, copy)
            ours = {"fingerprint", "inputs", "options", "versions", "made"}
            return StageRecord(**{key: value for key, value in record.items() if key not in ours})

        return run_stage

    stages = tuple(replace(stage, run=as_before(stage)) for stage in STAGES)
    for module in (pipeline, run_stages):
        monkeypatch.setattr(module, "STAGES", stages)
    monkeypatch.setattr(pipeline, "page_of", lambda *_: None)


def first(project: Path) -> Path:
    return project / "images/portico_03.jpg"


def added(project: Path) -> None:
    with Image.open(first(project)) as picture:
        picture.point(lambda v: v // 2).save(project / "images/portico_09.jpg")


def removed(project: Path) -> None:
    first(project).unlink()


def renamed(project: Path) -> None:
    first(project).rename(project / "images/south side.jpg")


def exif_edited(project: Path) -> None:
    with Image.open(first(project)) as picture:
        exif = picture.getexif()
        exif[0x0110] = "Another camera"
        picture.save(first(project), exif=exif, quality="keep")


def mask(project: Path, rows: int = 40) -> None:
    (project / "masks").mkdir(exist_ok=True)
    pixels = np.full((320, 480), 255, np.uint8)
    pixels[:rows] = 0
    (project / "masks/portico_03.jpg.png").write_bytes(encode_png(pixels))


def no_mask(project: Path) -> None:
    (project / "masks").mkdir()
    (project / "masks/.DS_Store").write_bytes(b"Finder was here")
    (project / "masks/notes.txt").write_text("to be drawn")


def frame(project: Path, value: int = 1) -> None:
    (project / "calibration/darks").mkdir(parents=True, exist_ok=True)
    (project / "calibration/darks/d1.dng").write_bytes(bytes([value]))


def option(line: str) -> Callable[[Path], None]:
    def change(project: Path) -> None:
        section, rest = line.split(".", 1)
        name, value = rest.split("=")
        yaml = (project / "project.yaml").read_text()
        (project / "project.yaml").write_text(f"{yaml}{section}:\n  {name}: {value}\n")

    return change


def written(name: str, text: str) -> Callable[[Path], object]:
    return lambda project: (project / name).write_text(text)


def gone(name: str) -> Callable[[Path], None]:
    return lambda project: (project / name).unlink()


def damaged(project: Path) -> None:
    database = project / "workspace/database.db"
    content = database.read_bytes()
    database.write_bytes(content[: len(content) // 2])


def looked_at(project: Path) -> None:
    """As by COLMAP's own GUI, which writes into a database that it opens."""
    os.utime(project / "workspace/database.db")


def edited(name: str) -> Callable[[Path], None]:
    def change(project: Path) -> None:
        with (project / name).open("r+b") as handle:
            handle.seek(-60, os.SEEK_END)
            handle.write(b"by hand")

    return change


def touched(project: Path) -> None:
    for file in project.rglob("*"):
        if file.is_file() and file.name != "digests.json":
            os.utime(file)


CAMERA = {"focal_length": 20.0, "override": False}
OPTIONS = {
    "develop": ("develop.green_equilibrium=false", "develop.green_equilibrium from true to false"),
    "cameras": ("cameras.x*={focal_length: 20}", f"cameras from [] to [['x*', {CAMERA}]]"),
    "fit": ("fit.method=rec709", "fit.method from ihe to rec709"),
    "convert": ("convert.format=jpeg", "convert.format from png to jpeg"),
    "features": (
        "features.colmap={max_image_size: 400}",
        "features.colmap.max_image_size from the default to 400",
    ),
    "matches": (
        "matches.colmap={max_num_matches: 9}",
        "matches.colmap.max_num_matches from the default to 9",
    ),
    "sparse": ("sparse.seed=1", "sparse.seed from 0 to 1"),
    "survey": ("survey.gps_accuracy_m=3", "survey.gps_accuracy_m from 5.0 to 3.0"),
    "dense": ("dense.colmap={min_num_pixels: 4}", "dense.colmap.min_num_pixels from the default to 4"),
    "mesh": ("mesh.texture_size=512", "mesh.texture_size from 4096 to 512"),
    "drawings": ("drawings.scale=20", "drawings.scale from 50 to 20"),
}
FIRST = {name: name for name in STAGE_NAMES} | {"features": "fit"}  # whose trial takes the features of COLMAP
LIBRARIES = {
    "rawpy": "captures", "libraw": "captures", "colmap-ihe": "captures", "simplejpeg": "fit", "numpy": "fit",
    "pycolmap": "features", "opencv": "survey",
}  # fmt: skip
CASES: dict[str, tuple[Callable[[Path], object], tuple[str, ...], str]] = {
    "added": (added, ALL, "the photographs changed: portico_09.jpg is new"),
    "removed": (removed, ALL, "the photographs changed: portico_03.jpg is gone"),
    "renamed": (renamed, ALL, "the photographs changed: portico_03.jpg is now called south side.jpg"),
    "EXIF edited": (exif_edited, ALL, "the photographs changed: portico_03.jpg has another content"),
    "mask added": (mask, since("features"), "the masks changed: portico_03.jpg.png is new"),
    "no mask": (no_mask, (), ""),
    "frame": (frame, ALL, "the calibration frames changed: darks/d1.dng is new"),
    **{
        name: (option(line), since(FIRST.get(name, "captures")), f"its options changed: {change}")
        for name, (line, change) in OPTIONS.items()
    },
    "camera": (
        option("camera.mode=single"),
        since("features"),
        "its options changed: camera.mode from auto to single",
    ),
    "strict": (option("captures.strict=true"), (), ""),
    "comment": (written("project.yaml", "# the north side, 12 May\n\n"), (), ""),
    "no photograph": (written("images/notes.txt", "north side"), (), ""),
    "touched": (touched, (), ""),
    "database gone": (gone("workspace/database.db"), since("features"), "database.db is gone"),
    "database damaged": (damaged, since("features"), "database.db is damaged"),
    "database looked at": (looked_at, (), ""),
    "record gone": (gone("records/sparse.json"), since("sparse"), ""),
    "record damaged": (written("records/convert.json", '{"fingerprint": '), since("convert"), ""),
    "record emptied": (written("records/convert.json", "{}"), since("convert"), ""),
    **{
        f"{file} {change.__name__}": (change(file), since(stage), f"{Path(file).name} is {words}")
        for stage, file, changes in (
            ("convert", "workspace/images/portico_03.png", (gone, edited)),
            ("convert", "colour/portico_03.png", (edited,)),
            ("sparse", "workspace/sparse/0/images.bin", (gone,)),
            ("sparse", "workspace/sparse/0/points3D.bin", (edited,)),
            ("dense", "workspace/dense/0/fused.ply", (gone, edited)),
            ("mesh", "workspace/dense/0/mesh.ply", (gone,)),
        )
        for change, words in ((gone, "gone"), (edited, "not as it was written"))
        if change in changes
    },
}


@pytest.mark.usefixtures("quick_stages")
@pytest.mark.parametrize("case", CASES)
def test_what_depends_on_a_change_runs_again_and_status_says_so(settled: Path, case: str) -> None:
    change, expected, why = CASES[case]
    yaml = settled / "project.yaml"
    yaml.write_text("")
    change(settled)
    options = load_options(yaml)
    states = status(settled, options)
    assert tuple(s.name for s in states if s.state != "done") == expected
    if expected and why:
        by_name = {s.name: s.why for s in states}
        assert by_name[expected[0]] == why
        assert {by_name[name] for name in expected[1:]} <= {f"{expected[0]} comes before it", why}
    assert reconstruct(settled, options).stages_run == expected
    assert {s.state for s in status(settled, options)} == {"done"}


@pytest.mark.usefixtures("quick_stages")
@pytest.mark.parametrize(("library", "stage"), LIBRARIES.items())
def test_a_library_that_was_upgraded(
    settled: Path, monkeypatch: pytest.MonkeyPatch, library: str, stage: str
) -> None:
    known = versions.library_versions

    def upgraded(*names: str) -> dict[str, str]:
        return {name: "99.1" if name == library else version for name, version in known(*names).items()}

    now = known(library)[library] if library != "colmap-ihe" else versions.__version__
    if library == "colmap-ihe":
        monkeypatch.setattr(records, "__version__", "99.1")
    else:
        monkeypatch.setattr(records, "library_versions", upgraded)
    options = load_options(settled / "project.yaml")
    states = {s.name: s for s in status(settled, options)}
    assert [name for name in STAGE_NAMES if states[name].state == "stale"] == list(since(stage))
    assert states[stage].why == f"a library changed: {library} from {now} to 99.1"
    assert reconstruct(settled, options).stages_run == since(stage)


@pytest.mark.usefixtures("quick_stages")
def test_several_changes_are_all_named(settled: Path) -> None:
    mask(settled)
    frame(settled)
    reconstruct(settled)
    mask(settled, rows=80)
    frame(settled, value=2)
    removed(settled)
    (settled / "images/portico_04.jpg").rename(settled / "images/a.jpg")
    (settled / "project.yaml").write_text("sparse: {seed: 3}\n")
    why = {s.name: s.why for s in status(settled, load_options(settled / "project.yaml"))}
    assert why["captures"] == (
        "the photographs changed: portico_04.jpg is now called a.jpg, portico_03.jpg is gone;"
        " the calibration frames changed: darks/d1.dng has another content"
    )
    assert why["features"] == "the masks changed: portico_03.jpg.png has another content"
    assert why["sparse"] == "its options changed: sparse.seed from 0 to 3"
    assert why["matches"] == "captures comes before it"


@pytest.mark.usefixtures("quick_stages")
def test_what_somebody_edited_is_kept(settled: Path) -> None:
    """It is made anew, and theirs lies aside, however often."""
    grey = settled / "workspace/images/portico_03.png"
    for number in range(2):
        ours = grey.read_bytes()
        theirs = ours[:-60] + bytes([65 + number]) * 60
        grey.write_bytes(theirs)
        done = reconstruct(settled, load_options(None))
        assert done.stages_run == since("convert")
        assert grey.read_bytes() == ours
        suffix = " (2)" if number else ""
        assert (settled / f"set-aside/workspace/images/portico_03{suffix}.png").read_bytes() == theirs


def test_stages_are_all_in_the_table() -> None:
    options = {name for stage in STAGES for name in stage.sections}
    assert options <= set(CASES)
