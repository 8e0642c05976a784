"""A painting that the grey does not see: found in the project, shown to COLMAP and stereo, and told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from painted import PAINTED, painted_wall
from PIL import Image

from colmap_ihe.dense.second_grey import add_second_grey
from colmap_ihe.dense.undistort import read_grey
from colmap_ihe.errors import OptionError
from colmap_ihe.grey.second import SecondGrey
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.second_grey import pictures_of
from colmap_ihe.pipeline.status import status
from colmap_ihe.pipeline.summary import report
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import load_options
from colmap_ihe.report.tables import summary_rows

UNTIL_FEATURES = ("fit.method=rec709", "fit.measure=false")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    (tmp_path / "images").mkdir()
    for number in range(3):
        Image.fromarray(painted_wall(shift=6 * number)).save(tmp_path / "images" / f"{number}.png")
    return tmp_path


def run(project: Path, *assignments: str) -> tuple[dict[str, object], dict[str, object]]:
    """Reconstruct up to features; return the records of `convert` and `features`."""
    options = load_options(None, [*UNTIL_FEATURES, *assignments])
    reconstruct(project, options, until="features")
    records = [json.loads((project / "records" / f"{s}.json").read_text()) for s in ("convert", "features")]
    return records[0], records[1]


def test_a_painting_gets_a_second_grey_and_features_of_it(project: Path) -> None:
    converted, features = run(project)
    second = converted["second"]
    assert isinstance(second, dict)
    assert 0.05 < second["lost"] < 0.5
    assert second["second"]["name"] == "fitted"
    assert isinstance(features["of_second"], int)
    assert features["of_second"] > 300
    alone = run(project, "fit.second=none")[1]
    assert alone["of_second"] == 0
    assert features["features"] == alone["features"] + features["of_second"]  # type: ignore[operator]


def test_a_mask_hides_the_painting_from_the_second_too(project: Path) -> None:
    (project / "masks").mkdir()
    mask = np.full((400, 600), 255, np.uint8)
    mask[:, 260:] = 0
    for number in range(3):
        Image.fromarray(mask).save(project / "masks" / f"{number}.png.png")
    assert run(project)[1]["of_second"] == 0


def test_a_named_direction_is_the_second(project: Path) -> None:
    converted, _ = run(project, "fit.second=blue")
    second = converted["second"]
    assert isinstance(second, dict)
    assert (second["second"]["name"], second["second"]["red"]) == ("blue", 0)


def test_another_second_fits_no_weights_anew(project: Path) -> None:
    run(project)
    other = load_options(None, [*UNTIL_FEATURES, "fit.second=none"])
    states = {state.name: (state.state, state.why) for state in status(project, other)}
    assert states["fit"] == ("done", "")
    assert states["convert"] == ("stale", "its options changed: convert.second from auto to the default")


def test_a_name_that_is_none_is_refused() -> None:
    with pytest.raises(OptionError, match="expected one of auto, none, rec709"):
        load_options(None, ["fit.second=violet"])


def test_the_summary_tells_it(project: Path) -> None:
    reconstruct(project, load_options(None, list(UNTIL_FEATURES)), until="features")
    summary = json.loads((project / "report" / "summary.json").read_text())
    assert len(summary["second_grey"]["weights"]) == 3
    assert summary["second_grey"]["features"] > 300
    lost = summary["colour_detail_lost_percent"]
    assert lost["grey"] == pytest.approx(lost["rec709"], rel=0.1)
    assert 5 < lost["grey"] < 50
    rows = dict(summary_rows(summary))
    assert rows["colour detail lost"].startswith(f"{lost['grey']:.2f} %; by Rec.709 ")
    assert "of the places that the grey loses" in rows["second grey"]
    page = report(project, UNTIL_FEATURES).read_text()
    assert "What the grey does not show" in page
    assert "as features and stereo see it" in page
    assert "with a second grey of the set" in page


def test_stereo_sees_the_painting_and_the_workspace_keeps_its_grey(project: Path) -> None:
    run(project)
    folder = Project.at(project)
    dense, second = project / "dense", SecondGrey(1.5, -1.5, 0.0, 1.0, 1.0)
    for source, target in ((folder.grey, dense / "grey" / "images"), (folder.colour, dense / "images")):
        target.mkdir(parents=True)
        for file in source.iterdir():
            (target / file.name).write_bytes(file.read_bytes())
    before = read_grey(folder.grey / "0.png")
    assert add_second_grey(dense, second, SILENT) == 3
    shown = read_grey(dense / "grey" / "images" / "0.png")
    assert before[PAINTED].std() < 1.5 < 20 < shown[PAINTED].std()
    assert np.array_equal(read_grey(folder.grey / "0.png"), before)
    picture, shares = pictures_of(folder, second, None)("0.png")
    assert np.array_equal(picture, shown)
    assert shares[PAINTED].mean() > 0.9


def test_stone_gets_no_second_grey(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    for number in range(2):
        wall = painted_wall(painting=False, shift=6 * number)
        Image.fromarray(wall).save(tmp_path / "images" / f"{number}.png")
    converted, features = run(tmp_path)
    assert converted["second"]["second"] is None  # type: ignore[index]
    assert features["of_second"] == 0
    page = report(tmp_path, UNTIL_FEATURES).read_text()
    assert "What the grey does not show" in page
    assert "features and stereo see it" not in page
