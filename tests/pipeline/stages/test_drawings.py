"""The stage that draws, on the small demo, and the command: what is drawn, what is refused, whose the folder is."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pypdfium2
import pytest
import tifffile

from colmap_ihe.errors import OptionError, ProjectError
from colmap_ihe.evaluation.truth import key_of, read_truth
from colmap_ihe.pipeline.draw_project import draw
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.option_sections import DrawingView
from colmap_ihe.project.options import Options

MakeOptions = Callable[..., Options]
VIEWS = "drawings.views={front: {mm_per_pixel: 40}, away: {plane: [0, -90, 0, 0, 1, 0]}, low: {height: 1.0}}"
SURVEYED = ("survey.align=positions",)


def with_positions(project: Path, small_demo: Path) -> None:
    """Tell where the cameras stood, so that the model is metric in the frame of the demo."""
    truth = read_truth(small_demo / "truth")
    rows = ["image,x,y,z,accuracy_m"]
    for file in sorted((project / "images").iterdir()):
        pose = truth.images[key_of(file.name)].cam_from_world
        x, y, z = (-pose[:, :3].T @ pose[:, 3]).tolist()
        rows.append(f"{file.name},{x:.4f},{y:.4f},{z:.4f},0.01")
    (project / "control").mkdir()
    (project / "control/positions.csv").write_text("\n".join(rows))


def test_a_metric_project_is_drawn_and_one_that_is_not_is_left(
    finished: Path, small_demo: Path, quick_options: MakeOptions
) -> None:
    assert json.loads((finished / "records/drawings.json").read_text())["files"] == []
    assert not (finished / "drawings").exists()
    with_positions(finished, small_demo)
    done = reconstruct(finished, quick_options(*SURVEYED, VIEWS))
    assert done.stages_run == ("survey", "dense", "mesh", "drawings")
    (warning,) = [text for text in done.summary["warnings"] if "not drawn" in text]
    assert "drawing away: misses the model" in warning and "the model reaches x -" in warning
    front = finished / "drawings/front"
    about = json.loads((front / "drawing.json").read_text())
    normal = np.array(about["frame"]["normal"])
    assert normal @ (0, -1, 0) > 0.999
    assert min(abs(about["frame"]["origin"][1] - wall) for wall in (-1.05, 0, 3.6)) < 0.15
    assert (about["pixel_mm"], about["scale"], about["metric"]) == (40, 50, True)
    relief, photo = tifffile.imread(front / "relief.tif"), tifffile.imread(front / "orthophoto.tif")
    assert relief.shape == photo.shape[:2] == (about["height"], about["width"])
    assert np.array_equal(photo[..., 3] == 0, np.isnan(relief))
    assert about["holes_percent"] == pytest.approx(100 * np.isnan(relief).mean())
    assert "1:50 on A" in pypdfium2.PdfDocument(front / "sheets.pdf")[0].get_textpage().get_text_range()
    assert (finished / "drawings/low/lines.dxf").is_file()
    page = (finished / "report/index.html").read_text()
    assert "Drawings</h2>" in page and 'href="../drawings/front/sheets.pdf"' in page
    kept_by_the_command(finished, quick_options)


def kept_by_the_command(project: Path, quick_options: MakeOptions) -> None:
    """What the command drew stays when the stage runs again; what the stage drew and is no more asked for goes."""
    assert reconstruct(project, quick_options(*SURVEYED, VIEWS)).stages_run == ()
    drawn = draw(project, [*SURVEYED], only="cut", asked=DrawingView(section=[0, -9, 0, 9]))
    assert drawn["cut"]["length"] > 3
    done = reconstruct(project, quick_options(*SURVEYED, "drawings.views={plan: {mm_per_pixel: 80}}"))
    assert done.stages_run == ("drawings",)
    assert {file.name for file in (project / "drawings").iterdir()} == {".made-by-colmap-ihe", "cut", "plan"}


def test_a_model_without_scale_is_drawn_if_asked_and_says_so(finished: Path) -> None:
    drawn = draw(finished, only="front")
    assert drawn["front"]["metric"] is False and drawn["front"]["scale"] is None
    words = pypdfium2.PdfDocument(finished / "drawings/front/sheets.pdf")[0].get_textpage().get_text_range()
    assert "NOT TO SCALE" in words and "1:50" not in words
    with pytest.raises(OptionError, match="not metric"):
        draw(finished, ["drawings.mm_per_pixel=5"], only="front")
    with pytest.raises(OptionError, match="no drawing is called 'south'"):
        draw(finished, only="south")
    with pytest.raises(OptionError, match="there is nothing on it"):
        draw(finished, only="high", asked=DrawingView(height=1e5))
    assert not (finished / "drawings/high").exists()


def test_what_is_the_users_is_not_written_into(finished: Path) -> None:
    (finished / "drawings/front").mkdir(parents=True)
    (finished / "drawings/front/mine.dwg").write_text("mine")
    with pytest.raises(ProjectError, match="was not made by colmap-ihe"):
        draw(finished, only="level")
    (finished / "drawings/.made-by-colmap-ihe").touch()
    with pytest.raises(ProjectError, match="is no drawing of colmap-ihe"):
        draw(finished, only="front", asked=DrawingView(height=0))
    assert (finished / "drawings/front/mine.dwg").read_text() == "mine"
