"""`compare` on the small demo: side by side, resumable, told in tables."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from calibrations import calibrated
from command_line import Captured, output_of
from painted import PAINTED, painted_wall
from PIL import Image
from small_demo import SETTINGS, Make, MakeOptions
from told import Told

from colmap_ihe.colmap.mapping import map_images
from colmap_ihe.colmap.second_try import SecondTry
from colmap_ihe.dense.undistort import read_grey
from colmap_ihe.errors import CalibrationFileError, MappingError, OptionError
from colmap_ihe.evaluation import compare as driver
from colmap_ihe.evaluation import page
from colmap_ihe.evaluation.compare import compare
from colmap_ihe.evaluation.method_projects import options_of, project_of
from colmap_ihe.evaluation.tables import MethodResult, sentences, tables_of
from colmap_ihe.grey.second import SecondGrey
from colmap_ihe.machine import system
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.machine.progress import SILENT
from colmap_ihe.pipeline.given_calibration import given_calibration
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options_file import load_options, project_options
from colmap_ihe.report.tables import Table


def test_methods_side_by_side_and_resumed(
    new_project: Make,
    small_demo: Path,
    quick_options: MakeOptions,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Captured,
) -> None:
    project = new_project()
    shutil.copytree(small_demo / "truth", project / "truth")
    found = compare(project, quick_options(), methods=["ihe", "rec709"], seeds=2)
    assert [one.method for one in found] == ["ihe", "rec709"]
    for one in found:
        assert sorted(one.runs) == [0, 1, 2]
        assert all(run["registered"] == 8 for run in one.runs.values())
        assert all(0.05 < run["rms_px"] < 1.5 for run in one.runs.values())
        assert all(run["mean_error_px"] < run["rms_px"] for run in one.runs.values())
        assert all(run["position_m"] < 0.05 and run["auc_percent"] > 80 for run in one.runs.values())
        assert one.runs[1]["points"] < one.runs[0]["points"]
        counts = one.matching["all"]
        assert 0 < counts["inliers"] <= counts["putative"]
        kinds = [one.matching[k]["pairs"] for k in ("parallel", "rotated", "tilted")]
        assert 0 < sum(kinds) <= counts["pairs"] <= 28
        assert one.dense_points is not None
        assert one.dense_points > 5000
    assert found[1].weights == pytest.approx((0.2126, 0.7152, 0.0722))
    assert not list((project / "compare").rglob("*.db-wal"))
    assert not list((project / "compare").glob("*/workspace/seeds/*.db"))
    assert not (project / "workspace").exists()

    # A third method and a further run need nothing of what is there again.
    def fail(*_: object, **__: object) -> None:
        raise AssertionError("dense stereo ran again")

    with monkeypatch.context() as patched:
        patched.setattr(driver, "dense_cloud", fail)
        again = compare(project, quick_options(), methods=["ihe", "rec709"], seeds=2)
        chosen = project / "pairs.txt"
        chosen.write_text("portico_01.jpg portico_02.jpg\nportico_02.jpg portico_03.jpg\n")
        few = compare(project, quick_options(), methods=["ihe", "rec709"], seeds=2, pairs=chosen)
    assert again == found
    assert [one.matching["all"]["pairs"] for one in few] == [2, 2]
    assert few[0].matching["all"]["inliers"] < found[0].matching["all"]["inliers"]
    shared = {p.resolve() for p in (project / "compare").glob("*/records/calibration")}
    assert (
        shared == {(project / "compare/records/calibration").resolve()} or system.fcntl is None
    )  # no links there
    cameras = project / "truth/cameras.json"  # another truth, other errors
    said = json.loads(cameras.read_text())
    next(iter(said["cameras"].values()))["cam_from_world"][0][3] += 0.5
    whole = cameras.read_text()
    cameras.write_text(json.dumps(said))
    moved = compare(project, quick_options("dense.enabled=false"), methods=["ihe"], seeds=0)
    assert moved[0].runs[0]["position_m"] > 2 * found[0].runs[0]["position_m"]
    cameras.write_text(whole)
    said = output_of(capsys, "compare", project, "--methods", "ihe,rec709", "--seeds", "2", *SETTINGS)
    assert "ihe against rec709: " in said
    assert "Pairwise matching efficiency" in said

    folder = project / "compare"
    assert {file.suffix for file in folder.iterdir() if file.is_file()} == {".csv", ".tex", ".json", ".html"}
    shown = (folder / "index.html").read_text()
    assert "ihe against rec709: " in shown
    assert shown.count("<figure") == 8
    rows = list(csv.reader((folder / "reconstruction.csv").read_text().splitlines()))
    assert [row[0] for row in rows] == ["method", "ihe", "rec709"]
    assert len({len(row) for row in rows}) == 1
    assert json.loads((folder / "compare.json").read_text())[0]["runs"]["0"]["registered"] == 8


def test_an_unknown_method_is_refused_before_any_work(new_project: Make) -> None:
    project = new_project(2)
    with pytest.raises(OptionError, match="no method is called 'gray'"):
        compare(project, methods=["ihe", "gray"])
    assert not (project / "compare").exists()


def test_a_method_without_a_model_is_told_and_does_not_end_the_others(
    new_project: Make, quick_options: MakeOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails_in_green(database: Path, *rest: Any, **named: Any) -> Any:
        if "green" in database.parts:
            raise MappingError("none of the photographs could be registered")
        named["on_second_try"](SecondTry({"init_max_forward_motion": 1.0}, 8, 2, 8))
        return map_images(database, *rest, **named)

    monkeypatch.setattr("colmap_ihe.evaluation.compare.map_images", fails_in_green)
    project, options = new_project(), quick_options("dense.enabled=false")
    told = Told()
    rec709, green = compare(project, options, methods=["rec709", "green"], seeds=0, progress=told)
    assert any(
        text.startswith("rec709, run 0: COLMAP registered only 2 of 8 photographs") for text in told.warnings
    )
    assert (rec709.runs[0]["registered"], green.runs[0]["registered"]) == (8, 0)
    assert tables_of([rec709, green])[1].rows[1][1] == "0.0"
    with pytest.raises(MappingError, match=r"green: no photograph is registered"):
        compare(project, options, methods=["green", "rec709"], seeds=0)


def test_each_method_has_the_calibration_file_in_its_project(new_project: Make) -> None:
    root = new_project(2)
    own = options_of("ihe", load_options(None, ["camera.calibration=given.yaml"]))
    project = project_of(
        Project.at(root), Project.at(root / "compare", root / "images"), "ihe", own, [calibrated()]
    )
    assert given_calibration(project, project_options(project.root, [])) == [calibrated()]
    with pytest.raises(CalibrationFileError, match=r"given\.yaml: cannot be read"):
        compare(root, load_options(None, ["camera.calibration=given.yaml"]))


def painted_project(root: Path, *, painting: bool) -> Path:
    (root / "images").mkdir(parents=True)
    for number in range(2):
        wall = painted_wall(shift=6 * number, painting=painting)
        Image.fromarray(wall).save(root / "images" / f"{number}.png")
    return root


def test_one_method_alone_has_a_second_grey(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[SecondGrey | None] = []

    def cloud(*given: Any) -> dict[str, int]:
        seen.append(given[-1])
        given[4].mkdir(parents=True)
        (given[4] / "fused.ply").write_bytes(b"")
        return {"points": 7}

    monkeypatch.setattr(driver, "dense_cloud", cloud)
    for method in ("ihe", "ihe-second"):
        project = painted_project(tmp_path / method, painting=True)
        own = options_of(method, load_options(None, ["fit.step=0.2"]))
        done = reconstruct(project, own, until="convert")
        with local_executor() as executor:
            assert driver._dense_points(done, done, own, executor, SILENT) == 7
    assert seen[0] is None
    assert isinstance(seen[1], SecondGrey)
    first, shown = read_grey(done.project.grey / "0.png"), page._grey(done.project, "0.png", seen[1])
    assert first[PAINTED].std() < 0.5 * shown[PAINTED].std()


def test_photographs_that_need_no_second_grey_have_no_such_method(tmp_path: Path) -> None:
    project, options = (
        painted_project(tmp_path / "plain", painting=False),
        load_options(None, ["fit.step=0.2"]),
    )
    with pytest.raises(MappingError, match="ihe-second: the photographs need no second grey"):
        compare(project, options, methods=["ihe-second"], seeds=0)
    none = load_options(None, ["fit.second=none"])
    with pytest.raises(MappingError, match="and no other method was named"):
        compare(project, none, methods=["ihe-second"], seeds=0)


def compared(method: str, points: list[float], truth: bool = False) -> MethodResult:
    counts = {"pairs": 1, "putative": 100, "inliers": 50, "efficiency_percent": 50.0}
    none = dict.fromkeys(counts, 0)
    return MethodResult(
        method,
        (0.2, 0.7, 0.1),
        {"all": counts, "parallel": counts, "rotated": none, "tilted": none},
        {
            seed: {"registered": 5, "points": value, "points_over_3_views": value / 2, "rms_px": 0.5}
            | ({"rotation_deg": 0.1, "position_m": 0.01, "auc_percent": 90} if truth else {})
            for seed, value in enumerate(points)
        },
        None,
    )


def test_tables_hold_what_was_measured_and_no_more() -> None:
    found = [compared("ihe", [120, 119, 121, 120]), compared("rec709", [100, 100, 101, 99])]
    matching, reconstruction, differences = tables_of(found)
    assert "tilted" not in " ".join(matching.columns)
    assert "position" not in " ".join(reconstruction.columns)
    assert "position" in " ".join(tables_of([compared("ihe", [1], truth=True)])[1].columns)
    assert [row[0] for row in differences.rows] == ["ihe"]
    assert "+20 (better)" in differences.rows[0]
    alone = "Each grey is compared alone, without a second grey for what it loses."
    assert sentences(found) == [alone, "ihe against rec709: better in points, points in > 3 images."]
    alike = sentences([found[1], compared("green", [100, 100, 101, 99])])
    assert alike == [alone, "green against rec709: no difference that this test can see."]
    second = {"weights": [1.5, -1.5, 0.2], "shown_percent": 85.0, "features": 1234}
    assert sentences([*found, replace(compared("ihe-second", [130, 130, 131, 129]), second_grey=second)]) == [
        "ihe-second has a second grey for what the first loses, the others are alone: +1.50 R -1.50 G +0.20 B, and"
        " shows 85 % of the places that the grey loses; 1,234 features are from it.",
        "ihe against rec709: better in points, points in > 3 images.",
        "ihe-second against rec709: better in points, points in > 3 images.",
    ]


def test_models_in_metres_are_compared_by_their_check_and_control_points() -> None:
    found = [compared("ihe", [120, 119, 121]), compared("rec709", [100, 100, 101])]
    assert "mm" not in " ".join(tables_of(found)[1].columns)
    for number, result in enumerate(found):
        for run in result.runs.values():
            assert isinstance(run, dict)
            run |= {"check_rms_mm": 2.5 + number, "control_rms_mm": 1.25, "extent_m": 13.1}
    reconstruction = tables_of(found)[1]
    row = dict(zip(reconstruction.columns, reconstruction.rows[1], strict=True))
    expected = ("3.50 +- 0.00", "1.25 +- 0.00", "13.10 +- 0.00")
    assert (
        tuple(row[f"{name}"] for name in ("check points RMS mm", "control points RMS mm", "extent m"))
        == expected
    )
    assert any("check points RMS mm" in sentence for sentence in sentences(found))


def test_a_table_in_latex_and_csv_escapes_what_it_holds() -> None:
    table = Table("t", "50 % & more", ["method", "a_b"], [["x#1", 'say "so", 2']])
    latex = table.as_latex()
    assert r"50 \% \& more" in latex
    assert r"a\_b" in latex
    assert r"x\#1" in latex
    assert list(csv.reader(table.as_csv().splitlines())) == [["method", "a_b"], ["x#1", 'say "so", 2']]
