"""Keep what an earlier version made: a project and a folder of grey images, of whose files only the records are stored.

`earlier_version/` holds the records of eight views of the small demo, three of them RAW. Files are stood for by empty
ones of the size and time in the records; digests and versions of libraries are those of the records.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from told import Told

import colmap_ihe
from colmap_ihe.colmap.lower_thresholds import COLMAPS_THRESHOLD
from colmap_ihe.pipeline.stages import STAGE_NAMES
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.options import FitOptions, Options

pytestmark = pytest.mark.slow

EARLIER = Path(__file__).parent / "earlier_version"
LATER = STAGE_NAMES.index("survey")  # a stage that the earlier version had not
RECORDS = {
    name: json.loads((EARLIER / f"records/{name}.json").read_text())
    for name in STAGE_NAMES
    if name not in ("survey", "drawings")
}
DIGESTS = RECORDS["captures"]["inputs"]["photographs"]
VERSIONS = {name: version for record in RECORDS.values() for name, version in record["versions"].items()}


@pytest.fixture
def earlier(small_demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand for the project, with the libraries that made it."""
    project = tmp_path / "project"
    shutil.copytree(EARLIER / "records", project / "records")
    (project / "images").mkdir()
    for name in DIGESTS:
        shutil.copy2(small_demo / "images" / name, project / "images" / name)
    for record in RECORDS.values():
        for name, (size, modified_ns, _) in record["made"].items():
            stand_in(project / name, bytes(size), modified_ns)
    head = b"SQLite format 3\0" + (4096).to_bytes(2, "big") + bytes(10) + (1).to_bytes(4, "big")
    stand_in(project / "workspace/database.db", head.ljust(4096, b"\0"))
    versions: Callable[..., dict[str, str]] = lambda *names: {name: VERSIONS[name] for name in names}  # noqa: E731
    for module in ("records", "convert_folder"):
        monkeypatch.setattr(f"colmap_ihe.pipeline.{module}.__version__", VERSIONS["colmap-ihe"])
    monkeypatch.setattr("colmap_ihe.pipeline.records.library_versions", versions)
    monkeypatch.setattr("colmap_ihe.pipeline.convert_folder.library_versions", versions)
    trial_decided: Callable[..., bool] = lambda _options: False  # noqa: E731
    monkeypatch.setattr("colmap_ihe.pipeline.stages.fit._trial_decides", trial_decided)
    monkeypatch.setattr("colmap_ihe.pipeline.input_digests.digest_file", lambda path: DIGESTS[path.name])
    return project


def stand_in(file: Path, content: bytes, modified_ns: int = 0) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    os.utime(file, ns=(modified_ns, modified_ns))


def options_of_then() -> Options:
    sections: dict[str, Any] = {}
    for record in RECORDS.values():
        sections |= {n: v for n, v in record["options"].items() if n not in ("cameras", "trial")}
    sections["fit"] |= {"weights": None, "second": "none"}
    sections["sparse"]["calibration"] = "colmap"
    sift = sections["features"]["colmap"].get("sift", {}) | {"peak_threshold": COLMAPS_THRESHOLD}
    sections["features"] = sections["features"] | {"colmap": {"sift": sift}, "octaves": "colmap"}
    return Options.model_validate(sections | {"dense": {**sections["dense"], "enabled": True}})


def test_every_stage_of_a_project_before_the_survey_is_done(earlier: Path) -> None:
    """But for the number of the version: what it stands for is what this one would ask for. The survey may move the
    model, so what stands on it is made again."""
    states = [s.state for s in status(earlier, options_of_then())]
    assert states == ["done"] * LATER + ["to do", "stale", "stale", "to do"]


def test_the_version_is_why_they_are_made_anew(earlier: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("colmap_ihe.pipeline.records.__version__", "0.2.0")
    first = status(earlier, options_of_then())[0]
    assert (first.state, "colmap-ihe" in first.why) == ("stale", True)


def test_a_changed_option_is_still_seen(earlier: Path) -> None:
    options = options_of_then()
    blue = options.model_copy(update={"fit": FitOptions(method="blue", step=0.1)})
    states = {state.name: state.state for state in status(earlier, blue)}
    assert (states["captures"], states["fit"], states["mesh"]) == ("done", "stale", "stale")


def test_of_a_folder_of_grey_images_only_twins_of_raw_are_written_again(
    earlier: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All RAW photographs of a camera have one white balance now."""
    digests = {earlier / "images" / name: digest for name, digest in DIGESTS.items()}
    for folder in ("grey", "colour"):
        record = json.loads((EARLIER / f"{folder}.json").read_text())
        for name, entry in record["files"].items():
            stand_in(tmp_path / folder / name, b"", 1)
            digests[tmp_path / folder / name] = entry["digest"]
        shutil.copy(EARLIER / f"{folder}.json", tmp_path / folder / ".colmap-ihe.json")
    monkeypatch.setattr("colmap_ihe.pipeline.output_folder.digest_file", digests.__getitem__)
    told = Told()
    fit = FitOptions(step=0.1)
    colmap_ihe.convert_folder(
        earlier / "images", tmp_path / "grey", colour=tmp_path / "colour", fit=fit, progress=told
    )
    assert told.up_to_date == ["fit"]
    written = {f.stem: f.stat().st_mtime_ns != 1 for f in (tmp_path / "colour").glob("*.png")}
    assert {name for name, anew in written.items() if anew} == {
        Path(n).stem for n in DIGESTS if n.endswith(".dng")
    }
    assert [file.stat().st_mtime_ns for file in (tmp_path / "grey").glob("*.png")] == [1] * 8
