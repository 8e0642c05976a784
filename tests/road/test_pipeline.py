"""The road on a small scene: what runs, what is kept, what the records say, and what stops it."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from calibrations import PARAMS, calibrated
from PIL import Image
from same_results import contents, pixels_of
from small_demo import Make, MakeOptions
from told import Told

from colmap_ihe.colmap.calibration_file import read_calibration, write_calibration
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import Cancelled, OptionError, PhotographError, ProjectError
from colmap_ihe.grey.weights import Weights, grey_from_dict
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.machine.progress import Progress, Silent
from colmap_ihe.photographs.camera_identity import read_identities
from colmap_ihe.pipeline.reconstruct import reconstruct
from colmap_ihe.pipeline.stages import STAGE_NAMES
from colmap_ihe.pipeline.status import status
from colmap_ihe.project.options import Options

# design.md, "Contracts"
SUMMARY_KEYS = {
    *("images", "registered_images", "weights", "method", "points3D", "points_over_3_views"),
    *("mean_reprojection_error_px", "dense_points", "dense_backend", "stages", "warnings"),
}


def record(project: Path, stage: str) -> dict[str, Any]:
    values: dict[str, Any] = json.loads((project / "records" / f"{stage}.json").read_text())
    return values


def interrupt(project: Path, stage: str) -> None:
    """Leave the record of a stage that was begun and not finished."""
    begun = json.dumps({"fingerprint": record(project, stage)["fingerprint"]})
    (project / f"records/{stage}.json").rename(project / f"records/{stage}.begun.json").write_text(begun)


# The whole road


def test_every_view_registers_and_the_cloud_is_there(
    finished: Path, finished_summary: dict[str, Any]
) -> None:
    assert finished_summary.keys() >= SUMMARY_KEYS
    assert finished_summary["images"] == finished_summary["registered_images"] == 8
    assert finished_summary["method"] == "ihe"
    assert sum(finished_summary["weights"]) == pytest.approx(1)
    assert finished_summary["points3D"] > finished_summary["points_over_3_views"] > 100
    assert 0.05 < finished_summary["mean_reprojection_error_px"] < 1
    assert finished_summary["dense_backend"] in ("sgm", "patchmatch")
    assert finished_summary["dense_points"] > 15_000
    assert list(finished_summary["stages"]) == list(STAGE_NAMES)
    assert all(seconds >= 0 for seconds in finished_summary["stages"].values())
    assert finished_summary["warnings"] == []
    assert json.loads((finished / "report/summary.json").read_text()) == finished_summary
    weights = grey_from_dict(yaml.safe_load((finished / "report/weights.yaml").read_text()))
    assert isinstance(weights, Weights)
    assert list(weights.triplet) == finished_summary["weights"]
    assert (weights.images, weights.pixels) == (8, 8 * 480 * 320)
    tried = finished_summary["tried"]
    assert tried["chosen"] in ("ihe", "rec709")
    assert "COLMAP's default" in tried["in_words"]
    if tried["candidates"]:
        assert tried["candidates"]["rec709"]["gain"] == 0
        assert len(tried["pairs"]) <= 6


def test_what_is_left_is_a_plain_colmap_workspace(finished: Path, finished_summary: dict[str, Any]) -> None:
    model = pycolmap.Reconstruction(finished / "workspace/sparse/0")
    assert model.num_reg_images() == 8
    assert model.num_points3D() == finished_summary["points3D"]
    names = {image.name for image in model.images.values()}
    assert names == {f"portico_{n:02}.png" for n in range(1, 9)}
    for folder, mode in (("workspace/images", "L"), ("colour", "RGB")):
        assert {p.name for p in (finished / folder).iterdir()} == names
        with Image.open(finished / folder / "portico_01.png") as image:
            assert (image.mode, image.size) == (mode, (480, 320))
    with pycolmap.Database.open(finished / "workspace/database.db") as database:
        assert database.num_images() == 8
        assert database.num_cameras() == 1
        pairs, found = database.read_two_view_geometries()
    assert len(pairs) == finished_summary["pairs_verified"]
    assert 15 <= len(pairs) <= 28
    assert sum(len(geometry.inlier_matches) for geometry in found) == finished_summary["inlier_matches"]
    header = (finished / "workspace/dense/0/fused.ply").read_bytes()[:600].decode("ascii", "replace")
    assert f"element vertex {finished_summary['dense_points']}" in header
    assert "red" in header


def test_records_say_how_each_stage_came_about(finished: Path) -> None:
    for stage in STAGE_NAMES:
        found = record(finished, stage)
        assert [found[key] for key in ("stage", "seed", "resumed", "warnings")] == [stage, 0, False, []]
        assert len(found["fingerprint"]) == 24
        assert found["versions"]["colmap-ihe"]
        assert found["seconds"] >= 0
        assert not (finished / "records" / f"{stage}.begun.json").exists()
    assert record(finished, "features")["versions"]["pycolmap"] == pycolmap.__version__
    assert record(finished, "features")["options"]["features"]["colmap"] == {"sift": {"first_octave": 0}}
    assert record(finished, "fit")["options"]["fit"]["step"] == 0.1
    assert record(finished, "captures")["images"] == 8
    assert record(finished, "features")["extracted_again"] == 8  # small ones, all below the cap
    assert len({record(finished, stage)["fingerprint"] for stage in STAGE_NAMES}) == len(STAGE_NAMES)


def test_colmaps_log_is_a_file_of_the_project(finished: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert [p for p in (finished / "records").glob("colmap.log.*") if p.stat().st_size > 0]
    reconstruct(finished, Options(), until="convert")
    assert capfd.readouterr().err == ""


# What is kept and what runs again


def test_a_second_call_runs_nothing_and_changes_no_file(finished: Path, quick_options: MakeOptions) -> None:
    before = {p: p.stat().st_mtime_ns for p in (finished / "workspace").rglob("*") if p.is_file()}
    summary = (finished / "report/summary.json").read_text()
    listener = Told()
    done = reconstruct(finished, quick_options(), progress=listener)
    assert done.stages_run == ()
    assert listener.up_to_date == list(STAGE_NAMES)
    assert {p: p.stat().st_mtime_ns for p in (finished / "workspace").rglob("*") if p.is_file()} == before
    assert (finished / "report/summary.json").read_text() == summary


def test_until_ends_after_a_stage_and_the_next_call_goes_on(
    new_project: Make, quick_options: MakeOptions
) -> None:
    project = new_project()
    done = reconstruct(project, quick_options(), until="fit")
    assert done.stages_run == ("captures", "fit")
    assert done.summary["registered_images"] is None
    assert not (project / "workspace/images").exists()
    assert not (project / "colour").exists()
    done = reconstruct(project, quick_options(), until="convert")
    assert done.stages_run == ("convert",)
    assert (done.summary.keys()) >= SUMMARY_KEYS
    assert not (project / "workspace/database.db").exists()


def test_another_grey_gives_another_database_and_other_features(
    finished: Path, quick_options: MakeOptions
) -> None:
    before = record(finished, "features")["features"]
    old_grey = contents(finished / "workspace/images")
    done = reconstruct(finished, quick_options("fit.method=blue"), until="features")
    assert done.summary["weights"] == [0, 0, 1]
    assert contents(finished / "workspace/images") != old_grey
    assert record(finished, "features")["features"] != before
    grey, rgb = (
        pixels_of(finished / "workspace/images/portico_01.png"),
        pixels_of(finished / "images/portico_01.jpg"),
    )
    np.testing.assert_array_equal(grey, rgb[..., 2])


def test_dense_can_be_left_out(finished: Path, quick_options: MakeOptions) -> None:
    done = reconstruct(finished, quick_options("dense.enabled=false"))
    assert done.stages_run == ()
    assert done.summary["dense_points"] is None
    assert (done.summary["registered_images"], "dense" in done.summary["stages"]) == (8, False)
    assert reconstruct(finished, quick_options()).stages_run == ()  # what was there is still true


def test_start_runs_a_stage_and_all_after_it_again(finished: Path, quick_options: MakeOptions) -> None:
    done = reconstruct(finished, quick_options(), start="convert", until="features")
    assert done.stages_run == ("convert", "features")
    assert [s.state for s in status(finished, quick_options())] == ["done"] * 4 + ["to do"] * 6


def test_a_renamed_photograph_runs_everything_again(finished: Path, quick_options: MakeOptions) -> None:
    (finished / "images/portico_03.jpg").rename(finished / "images/another.jpg")
    done = reconstruct(finished, quick_options(), until="convert")
    assert done.stages_run == ("captures", "fit", "convert")
    assert done.summary["images"] == 8
    stems = {p.stem for p in (finished / "images").iterdir()}
    for folder in ("workspace/images", "colour"):
        assert {p.stem for p in (finished / folder).iterdir()} == stems


def test_status_changes_nothing(finished: Path, new_project: Make, quick_options: MakeOptions) -> None:
    before = contents(finished)
    states = status(finished, quick_options("features.max_image_size=200"))
    assert [s.state for s in states] == ["done"] + ["stale"] * 9
    assert contents(finished) == before
    project = new_project()
    assert [(s.state, s.why, s.seconds) for s in status(project)] == [("to do", "", None)] * len(STAGE_NAMES)
    assert sorted(p.name for p in project.iterdir()) == ["images"]


def test_photographs_may_lie_elsewhere(new_project: Make, tmp_path: Path, quick_options: MakeOptions) -> None:
    images = new_project(3) / "images"
    done = reconstruct(tmp_path / "elsewhere", quick_options(), images=images, until="convert")
    assert done.summary["images"] == 3
    assert sorted(p.name for p in images.parent.iterdir()) == ["images"]
    assert len(list((tmp_path / "elsewhere/workspace/images").iterdir())) == 3


def test_an_executor_that_is_given_is_used_and_not_shut_down(
    new_project: Make, quick_options: MakeOptions
) -> None:
    with ThreadPoolExecutor(1) as executor:
        done = reconstruct(new_project(3), quick_options(), until="convert", executor=executor)
        assert executor.submit(int, "3").result() == done.summary["images"]


# Cancelling


@pytest.mark.parametrize("stage", ["fit", "convert", "features", "matches", "sparse"])
def test_cancelled_in_a_stage_the_same_call_goes_on_from_there(
    finished: Path, quick_options: MakeOptions, stage: str
) -> None:
    class Impatient(Told):
        @contextmanager
        def stage(self, name: str) -> Iterator[Silent]:
            with super().stage(name):
                self.cancelled = name == stage
                yield self

    number = STAGE_NAMES.index(stage)
    options = quick_options("dense.enabled=false")
    with pytest.raises(Cancelled):
        reconstruct(finished, options, start=stage, progress=Impatient())
    states = {s.name: s for s in status(finished, options)}
    expected = [*["done"] * number, *["to do"] * (len(STAGE_NAMES) - number - 3), *["off"] * 3]
    assert [states[n].state for n in STAGE_NAMES] == expected
    assert states[stage].why == "begun, not finished"
    done = reconstruct(finished, options, until=stage)
    assert done.stages_run == (stage,)
    assert record(finished, stage)["resumed"] is True


def test_a_resumed_stage_keeps_what_is_whole_and_gives_the_same(
    finished: Path, quick_options: MakeOptions
) -> None:
    before = contents(finished / "workspace/images")
    interrupt(finished, "convert")
    grey = finished / "workspace/images"
    (grey / "portico_02.png").unlink()
    (finished / "colour/portico_05.png").unlink()
    (grey / ".portico_02.png.77.tmp").write_bytes(b"half")
    kept = (grey / "portico_01.png").stat().st_mtime_ns
    assert reconstruct(finished, quick_options(), until="convert").stages_run == ("convert",)
    assert (grey / "portico_01.png").stat().st_mtime_ns == kept
    (grey / ".portico_02.png.77.tmp").unlink(missing_ok=True)
    assert contents(grey) == before


def test_half_a_database_is_begun_anew(finished: Path, quick_options: MakeOptions) -> None:
    interrupt(finished, "features")
    database = finished / "workspace/database.db"
    database.write_bytes(database.read_bytes()[:50_000])
    done = reconstruct(finished, quick_options(), until="features")
    assert done.stages_run == ("features",)
    assert record(finished, "features")["images"] == 8


# What bad input gets


def test_a_broken_photograph_is_left_out_and_named(new_project: Make, quick_options: MakeOptions) -> None:
    project = new_project(4)
    images = project / "images"
    whole = (images / "portico_02.jpg").read_bytes()
    (images / "truncated.jpg").write_bytes(whole[: len(whole) // 2])
    (images / "text.jpg").write_text("no photograph")
    (images / "broken.dng").write_bytes(b"no RAW" * 900)
    Image.new("RGB", (30, 30)).save(images / "small.png")
    listener = Told()
    done = reconstruct(project, quick_options(), until="features", progress=listener)
    assert set(done.summary["left_out"]) == {"truncated.jpg", "text.jpg", "broken.dng", "small.png"}
    assert done.summary["images"] == 8
    for name, reason in done.summary["left_out"].items():
        assert name in reason
        assert [text for text in listener.warnings if name in text]
    assert set(record(project, "captures")["left_out"]) == {"text.jpg", "broken.dng", "small.png"}
    assert set(record(project, "fit")["left_out"]) == {"truncated.jpg"}
    assert record(project, "features")["images"] == 4
    greys = sorted(p.name for p in (project / "workspace/images").iterdir())
    assert greys == [f"portico_{n:02}.png" for n in range(1, 5)]
    assert reconstruct(project, quick_options(), until="features").stages_run == ()


def test_strict_stops_at_a_photograph_found_broken_as_it_is_fitted(
    new_project: Make, quick_options: MakeOptions
) -> None:
    project = new_project(3)
    whole = (project / "images/portico_02.jpg").read_bytes()
    (project / "images/portico_02.jpg").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(PhotographError, match=r"portico_02\.jpg"):
        reconstruct(project, quick_options("captures.strict=true"))
    assert not (project / "records/fit.json").exists()


def test_only_broken_photographs(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    for name in ("a.jpg", "b.jpg"):
        (tmp_path / "images" / name).write_text("no photograph")
    with pytest.raises(ProjectError, match=r"none of the 2 photographs can be used: a\.jpg"):
        reconstruct(tmp_path)


@pytest.mark.parametrize("argument", ["start", "until"])
def test_a_stage_that_is_none_is_refused_with_those_there_are(new_project: Make, argument: str) -> None:
    project = new_project(2)
    with pytest.raises(OptionError, match="no stage is called 'sparce'") as caught:
        reconstruct(project, **{argument: "sparce"})  # type: ignore[arg-type]
    assert "captures, fit, convert, features, matches, sparse, survey, dense" in caught.value.hint
    assert sorted(p.name for p in project.iterdir()) == ["images"]


def test_an_option_that_pycolmap_does_not_know_is_refused_by_name_before_anything_is_run(
    finished: Path, quick_options: MakeOptions
) -> None:
    listener = Told()
    unknown = {
        "features.colmap": "features.colmap.sift.max_features=10",
        "matches.colmap": "matches.colmap.ratio=0.8",
        "matches.verification": "matches.verification.min_inliers=3",
        "matches.pairing": "matches.pairing.overlaps=3",
        "sparse.colmap": "sparse.colmap.min_images=3",
        "camera.model": "camera.model=FISHEYES",
        "dense.colmap": "dense.colmap.min_pixels=3",
        "mesh.colmap": "mesh.colmap.deep=3",
    }
    for name, assignment in unknown.items():
        with pytest.raises(OptionError, match=re.escape(name)):
            reconstruct(finished, quick_options(assignment), progress=listener)
    with pytest.raises(OptionError, match=r"features\.colmap"):
        reconstruct(finished, quick_options("features.colmap.num_threads=many"), progress=listener)
    with pytest.raises(OptionError, match=r"camera\.params: 2 numbers, PINHOLE has 4"):
        reconstruct(
            finished, quick_options("camera.model=PINHOLE", "camera.params=[1, 2]"), progress=listener
        )
    assert {s.state for s in status(finished, quick_options())} == {"done"}
    assert set(listener.begun) <= {"content"}


def test_options_of_every_kind_reach_pycolmap(finished: Path, quick_options: MakeOptions) -> None:
    few = quick_options("features.colmap.sift.max_num_features=300", "dense.enabled=false")
    done = reconstruct(finished, few, until="features")
    assert done.summary["features"] <= 8 * 600
    options = quick_options(
        *("features.colmap.sift.max_num_features=300", "dense.enabled=false", "matches.strategy=sequential"),
        "matches.colmap={max_num_matches: 1000, guided_matching: false}",
        "matches.pairing={overlap: 2, quadratic_overlap: false}",
        "matches.verification={min_num_inliers: 20, ransac: {max_error: 3.0}}",
        "sparse.colmap={min_model_size: 3, mapper: {init_min_num_inliers: 30}}",
    )
    done = reconstruct(finished, options)
    assert done.stages_run == ("matches", "sparse", "survey")
    assert done.summary["matching"] == "sequential"
    # Every image with the next two of eight: 7 + 6 pairs at most.
    assert 6 <= done.summary["pairs_verified"] <= 13


def test_a_vocabulary_tree_of_the_sets_own_features(finished: Path, quick_options: MakeOptions) -> None:
    done = reconstruct(finished, quick_options("matches.strategy=vocabtree"), until="matches")
    assert done.summary["matching"] == "vocabtree"
    assert 15 <= done.summary["pairs_verified"] <= 28


@pytest.mark.parametrize("mapper", [pytest.param("global", marks=pytest.mark.slow), "hierarchical"])
def test_other_mappers(finished: Path, quick_options: MakeOptions, mapper: str) -> None:
    done = reconstruct(finished, quick_options(f"sparse.mapper={mapper}"), until="sparse")
    assert done.stages_run == ("sparse",)
    assert done.summary["registered_images"] >= 6


def test_masks_hide_what_they_cover(finished: Path, quick_options: MakeOptions) -> None:
    """COLMAP's own naming: NAME.EXT.png of the grey image; black is left out."""
    before = record(finished, "features")["features"]
    (finished / "masks").mkdir()
    mask = np.zeros((320, 480), np.uint8)
    mask[:, 150:] = 255
    for number in range(1, 9):
        Image.fromarray(mask).save(finished / f"masks/portico_{number:02}.png.png")
    done = reconstruct(finished, quick_options("dense.enabled=true"), until="dense")
    assert done.stages_run == ("features", "matches", "sparse", "survey", "dense")
    assert 0.2 * before < done.summary["features"] < 0.9 * before
    assert done.summary["dense_points"] > 1000
    for file in (finished / "workspace/dense/0/masks").iterdir():
        hidden = np.asarray(Image.open(file)) == 0
        assert 0.25 < hidden.mean() < 0.4
        depth = pycolmap.DepthMap()
        depth.read(finished / f"workspace/dense/0/stereo/depth_maps/{file.stem}.geometric.bin")
        assert not depth.to_array()[hidden].any()
    with pycolmap.Database.open(finished / "workspace/database.db") as database:
        points = np.vstack([database.read_keypoints(i.image_id)[:, :2] for i in database.read_all_images()])
    assert points[:, 0].min() >= 149
    shutil.rmtree(finished / "masks")
    reconstruct(finished, quick_options(), until="features")
    assert not (finished / "workspace/masks").exists()


# Sets as people have them


def test_raw_and_jpeg_of_one_shot_are_one_image(new_project: Make, quick_options: MakeOptions) -> None:
    project = new_project(3, (".dng", ".jpg"))
    done = reconstruct(project, quick_options(), until="convert")
    assert done.summary["images"] == 3
    assert (record(project, "captures")["raw"], len(record(project, "captures")["paired"])) == (3, 3)
    assert record(project, "captures")["paired"]["portico_01.dng"] == ["portico_01.jpg"]
    assert list(done.summary["weights_by_encoding"]) == ["linear"]
    grey = pixels_of(project / "workspace/images/portico_02.png")
    assert np.percentile(grey, 5) < 90
    assert np.percentile(grey, 99) > 180
    twin, jpeg = pixels_of(project / "colour/portico_02.png"), pixels_of(project / "images/portico_02.jpg")
    assert np.corrcoef(twin.ravel(), jpeg.ravel())[0, 1] > 0.9


def test_raw_only_registers_every_view(new_project: Make, quick_options: MakeOptions) -> None:
    done = reconstruct(new_project(8, (".dng",)), quick_options("dense.enabled=false"))
    assert done.summary["registered_images"] == 8
    assert done.summary["with_focal_prior"] == 8
    assert done.summary["warnings"] == []


@pytest.mark.slow
def test_a_set_mixing_raw_and_jpeg_runs_with_a_warning(new_project: Make, quick_options: MakeOptions) -> None:
    project, jpeg = new_project(8, (".dng",)), new_project(8, (".jpg",), name="jpeg")
    for number in (2, 4, 6):
        (project / f"images/portico_{number:02}.dng").unlink()
        shutil.copy(jpeg / f"images/portico_{number:02}.jpg", project / "images")
    done = reconstruct(project, quick_options("dense.enabled=false"))
    assert done.summary["registered_images"] == 8
    assert set(done.summary["weights_by_encoding"]) == {"coded", "linear"}
    (warning,) = done.summary["warnings"]
    assert "the set mixes" in warning
    assert "5 linear" in warning
    assert "3 coded" in warning


def test_subfolders_spaces_and_non_ascii_names_run_through(
    new_project: Make, quick_options: MakeOptions
) -> None:
    project = new_project(name="projet façade 日本")
    images = project / "images"
    places = ["côté nord/été 01.jpg", "côté nord/a b.jpg", "côté nord/c d/портик.jpg", "ünten/x.JPG"]
    for number, place in enumerate(places, 1):
        (images / place).parent.mkdir(parents=True, exist_ok=True)
        (images / f"portico_{number:02}.jpg").rename(images / place)
    done = reconstruct(project, quick_options())
    assert done.summary["registered_images"] == 8
    assert done.summary["dense_points"] > 15_000
    names = {image.name for image in pycolmap.Reconstruction(project / "workspace/sparse/0").images.values()}
    assert {f"{place.rpartition('.')[0]}.png" for place in places} < names


def test_a_photograph_of_another_size_gets_a_camera_of_its_own_and_a_warning(
    new_project: Make, quick_options: MakeOptions
) -> None:
    """Where there is one camera for all, it does not fit and is left out."""
    project = new_project(5)
    with Image.open(project / "images/portico_02.jpg") as picture:
        picture.crop((0, 0, 400, 300)).save(project / "images/portico_02.jpg", exif=picture.getexif())
    done = reconstruct(project, quick_options(), until="features")
    assert record(project, "features")["cameras"] == 2
    (warning,) = done.summary["warnings"]
    assert "portico_02.jpg is 400x300, the others of this camera 480x320" in warning
    done = reconstruct(project, quick_options("camera.mode=single"), until="features")
    assert "same size" in done.summary["left_out"]["portico_02.jpg"]


def test_photographs_without_a_focal_length_are_warned_of(
    new_project: Make, quick_options: MakeOptions
) -> None:
    project = new_project(3)
    for file in (project / "images").iterdir():
        with Image.open(file) as picture:
            picture.load()
        picture.save(file, quality=95)
    done = reconstruct(project, quick_options(), until="features")
    assert (done.summary["with_focal_prior"], record(project, "features")["cameras"]) == (0, 1)
    guessed, shared = done.summary["warnings"]
    assert "3 of 3 photographs do not say their focal length" in guessed
    assert "3 photographs whose EXIF lacks make, model or focal length were taken as by one camera" in shared
    assert "--set camera.mode=per_image" in shared
    (project / "workspace/database.db").unlink()
    done = reconstruct(project, quick_options("camera.mode=per_image"), until="features")
    assert (record(project, "features")["cameras"], len(done.summary["warnings"])) == (3, 1)
    known = quick_options(
        "camera.mode=single", "camera.model=SIMPLE_PINHOLE", "camera.params=[400, 240, 160]"
    )
    done = reconstruct(project, known, until="features")
    assert record(project, "features")["cameras"] == 1
    assert (done.summary["with_focal_prior"], done.summary["warnings"]) == (3, [])
    with pycolmap.Database.open(project / "workspace/database.db") as database:
        assert database.read_all_cameras()[0].params.tolist() == [400, 240, 160]


def test_cameras_start_from_a_calibration_file(new_project: Make, quick_options: MakeOptions) -> None:
    """What is held matters to the mapping only, and the content of the file to the features and all after them."""
    project = new_project(3)
    with Image.open(project / "images/portico_02.jpg") as picture:
        picture.transpose(Image.Transpose.ROTATE_90).save(
            project / "images/turned.jpg", exif=picture.getexif()
        )
    (project / "images/portico_02.jpg").unlink()
    (said,) = read_identities(project / "images", ["portico_01.jpg"]).values()
    own = calibrated(said.make, said.model, said.focal_mm, said.size)
    own = own.model_copy(update={"focal_length_35mm": said.focal_35mm})
    write_calibration(project / "given.yaml", [own, calibrated()])
    given = "camera.calibration=given.yaml"
    with pytest.raises(OptionError, match=r"camera\.fixed holds a calibration that was given, and none is"):
        reconstruct(project, quick_options("camera.fixed=true"))
    assert not (project / "records").exists()
    done = reconstruct(project, quick_options(given), until="features")
    with pycolmap.Database.open(project / "workspace/database.db") as database:
        cameras = {c.width: c for c in database.read_all_cameras()}
    assert cameras[480].params.tolist() == PARAMS
    assert cameras[320].model_name == "SIMPLE_RADIAL"
    without, unused = done.summary["warnings"]
    assert "for 1 photograph, which start as without it: turned.jpg" in without
    assert unused.endswith("took none of the photographs: Foo Bar at 35 mm, 90x66")

    def state(*assignments: str) -> list[str]:
        return [s.state for s in status(project, quick_options(*assignments))[3:4]]

    assert state(given) == state(given, "camera.fixed=true") == ["done"]
    assert state() == ["stale"]
    write_calibration(project / "given.yaml", [own])
    assert state(given) == ["stale"]


def test_a_calibration_found_by_one_campaign_is_held_in_the_next(
    finished: Path, new_project: Make, quick_options: MakeOptions
) -> None:
    """Written, read and held through the mapping to the last bit; the next campaign passes the same file on."""
    (found,) = read_calibration(finished / "report/calibration.yaml")
    (camera,) = pycolmap.Reconstruction(finished / "workspace/sparse/0").cameras.values()
    assert (found.camera_model, found.params) == (camera.model_name, camera.params.tolist())
    (told,) = json.loads((finished / "report/summary.json").read_text())["cameras"]
    assert [*told["parameters"].values()] == found.params
    assert [*told["standard_deviations"].values()] == found.standard_deviations
    assert (told["exif"]["model"], told["exif"]["focal_length_mm"]) == (found.model, found.focal_length_mm)
    project = new_project(4)
    shutil.copy(finished / "report/calibration.yaml", project / "calibration.yaml")
    given = quick_options("camera.calibration=calibration.yaml", "camera.fixed=true")
    done = reconstruct(project, given, until="sparse")
    (held,) = pycolmap.Reconstruction(project / "workspace/sparse/0").cameras.values()
    assert (held.model_name, held.params.tolist()) == (found.camera_model, found.params)
    (told,) = done.summary["cameras"]
    assert (told["by"], told["standard_deviations"], told["photographs"]) == ("given", None, 4)
    assert done.summary["held_out_error_px"] is None
    (passed_on,) = read_calibration(project / "report/calibration.yaml")
    assert passed_on == found.model_copy(update={"standard_deviations": None, "photographs": 4})


def test_the_calibration_file_goes_with_its_model(finished: Path, quick_options: MakeOptions) -> None:
    file = finished / "report/calibration.yaml"
    first = file.read_bytes()
    file.unlink()
    assert reconstruct(finished, quick_options()).stages_run == ()
    assert file.read_bytes() == first
    there = {}

    class Looks(Silent):
        def stage(self, name: str) -> AbstractContextManager[Progress]:
            there[name] = file.exists()
            return super().stage(name)

    reconstruct(finished, quick_options(), start="mesh", progress=Looks())
    assert there["mesh"]
    reconstruct(finished, quick_options(), start="matches", until="matches")
    assert not file.exists()
    reconstruct(finished, quick_options("sparse.seed=3"), until="sparse")
    (camera,) = pycolmap.Reconstruction(finished / "workspace/sparse/0").cameras.values()
    (found,) = read_calibration(file)
    assert found.params == camera.params.tolist()


def test_holding_the_calibration_is_an_option_of_the_mapping(
    finished: Path, quick_options: MakeOptions
) -> None:
    fixed = ("camera.model=OPENCV", "camera.params=[1, 1, 1, 1, 0, 0, 0, 0]", "camera.fixed=true")
    assert [s.state for s in status(finished, quick_options())] == ["done"] * 10
    reasons = {s.name: s.why for s in status(finished, quick_options(*fixed))}
    assert "camera.fixed" not in reasons["features"]
    assert reasons["sparse"].startswith("its options changed: camera.fixed from the default to true")


def test_how_colmap_sees_the_photographs_is_an_input_of_the_fit_where_a_trial_decides(
    finished: Path, quick_options: MakeOptions
) -> None:
    def why(*assignments: str) -> str:
        return status(finished, quick_options(*assignments))[1].why

    assert why("convert.tone=linear").startswith(
        "its options changed: convert.tone from the default to linear"
    )
    assert "convert.tone" not in why("convert.tone=linear", "fit.guard=none")
    assert why("fit.method=auto").startswith("its options changed: fit.method from ihe to auto")


def test_wallis_is_warned_of(new_project: Make, quick_options: MakeOptions) -> None:
    done = reconstruct(new_project(2), quick_options("convert.wallis=true"), until="convert")
    assert any("Wallis" in text for text in done.summary["warnings"])


def test_what_a_killed_worker_left_goes_with_the_end_of_the_run(
    new_project: Make, quick_options: MakeOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = new_project(2)
    left = project / "workspace/images/.0123456789abcdef01234567.0a1b2c3d.tmp"

    killed = lambda _run: write_bytes(left, b"half a picture")  # noqa: E731
    monkeypatch.setattr("colmap_ihe.pipeline.reconstruct.write_weights_file", killed)
    reconstruct(project, quick_options(), until="convert")
    assert len(list(left.parent.glob("*.png"))) == 2
    assert not left.exists()
