"""Sets of photographs that no model, or only a doubtful one, can be made of: what is said, and what is left."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import odd_sets
import pytest
from small_demo import MakeOptions

from colmap_ihe.colmap.checks.camera_motion import TURNED_DEGREES, parallax_of
from colmap_ihe.colmap.checks.plausibility import Shape, SolvedCamera, thickness
from colmap_ihe.colmap.checks.repeated_structure import Conflicts
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import MappingError
from colmap_ihe.pipeline.reconstruct import Reconstruction, reconstruct
from colmap_ihe.pipeline.stages import STAGE_NAMES
from colmap_ihe.pipeline.status import status
from colmap_ihe.pipeline.warnings.model import camera_warnings, few_found_again, flat_warnings, fold_warnings
from colmap_ihe.project.options_file import load_options

Run = Callable[..., Reconstruction]
TURNED = "none of the 6 photographs could be registered.*the camera only turned on the spot"
QUICK = ("fit.measure=false", "dense.enabled=false")


@pytest.fixture
def run(tmp_path: Path, quick_options: MakeOptions) -> Run:
    def run(name: str, *assignments: str) -> Reconstruction:
        odd_sets.SETS[name](tmp_path / "images")
        return reconstruct(tmp_path, quick_options(*QUICK, *assignments))

    return run


def warnings(done: Reconstruction) -> str:
    return "\n".join(done.summary["warnings"])


def steps_of(model: pycolmap.Reconstruction) -> Any:
    """How far the camera went from one photograph to the next, by their names."""
    ordered = sorted(model.reg_image_ids(), key=lambda i: str(model.images[i].name))
    return np.linalg.norm(np.diff([model.images[i].projection_center() for i in ordered], axis=0), axis=1)


# No model


@pytest.mark.parametrize(
    ("name", "words", "hint", "last"),
    [
        ("one", r"shot_01\.jpg is the only photograph that can be used", "add photographs", "convert"),
        (
            "two_identical",
            r"all 2 photographs are copies of one file: shot_01\.jpg",
            "two or more",
            "convert",
        ),
        ("all_black", "no features were found in any of the 3", "black", "convert"),
        ("one_colour", "no features were found in any of the 3 photographs", "one colour", "convert"),
        ("no_overlap", "no two of the 4 photographs match", "overlap by about two thirds", "features"),
        ("two_from_one_place", "show the same view from the same place", "step sideways", "matches"),
        ("pure_rotation", TURNED, "step sideways", "matches"),
    ],
)
def test_no_model_can_be_made_and_what_was_made_stays(
    run: Run, quick_options: MakeOptions, tmp_path: Path, name: str, words: str, hint: str, last: str
) -> None:
    with pytest.raises(MappingError, match=words) as caught:
        run(name)
    assert hint in caught.value.hint
    states = [s.state for s in status(tmp_path, quick_options(*QUICK))]
    finished = STAGE_NAMES.index(last) + 1
    assert states == [*["done"] * finished, *["to do"] * (7 - finished), "off", "off", "off"]
    assert not list((tmp_path / "workspace").glob(".sparse*"))
    greys = {p.stem for p in (tmp_path / "workspace/images").iterdir()}
    assert greys == {p.stem for p in (tmp_path / "images").iterdir()}
    assert not (tmp_path / "workspace/sparse").exists()


# A model, and what is to be known of it


def test_two_photographs_make_a_model(run: Run) -> None:
    done = run("two")
    assert (done.summary["registered_images"], done.summary["points3D"] > 100) == (2, True)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "models", "words"),
    [
        ("sound", [7], []),
        ("sound_with_copies", [9], ["shot_02.jpg of copies/copy_2.jpg"]),
        ("one_black", [7], ["hardly any features", "cap.jpg (0)", "1 of 8 photographs are not registered"]),
        ("lone_shot", [7], ["elsewhere.jpg: no verified matches with any that has one"]),
        ("two_halves", [4, 4], ["fell into 2 models", "workspace/sparse/1 has 4 images"]),
        ("partly_rotation", [10], []),
        ("flat_wall_set", [6], ["of one plane", "ba_refine_focal_length=false"]),
        ("flat_wall_oblique", [6], []),
        ("moving_crowd", [7], []),
        ("wrong_focal_lengths", [10], ["5 photographs (wrong_02.jpg,", "px, not 155)", "`cameras:`"]),
        ("double_focal_lengths", [8], ["came out 0.5", "with override"]),
    ],
)
def test_the_model_comes_with_what_is_doubtful_about_it(
    run: Run, name: str, models: list[int], words: list[str]
) -> None:
    done = run(name)
    assert done.summary["models"] == models
    for text in words:
        assert text in warnings(done)
    if not words:
        assert warnings(done) == ""
    page = (done.project.page_file).read_text(encoding="utf-8")
    assert all(text.partition("(")[0][:60].replace("'", "&#39;") in page for text in done.summary["warnings"])


@pytest.mark.slow
def test_a_straight_row_stretches_the_model_and_the_advice_mends_it(
    run: Run, tmp_path: Path, quick_options: MakeOptions
) -> None:
    done = run("straight_row")
    assert "came out 1.9" in warnings(done)
    held = reconstruct(tmp_path, quick_options(*QUICK, "sparse.colmap.ba_refine_focal_length=false"))
    assert held.stages_run == ("sparse", "survey")
    assert "came out" not in warnings(held)
    model = pycolmap.Reconstruction(held.sparse_model)
    (camera,) = model.cameras.values()
    assert camera.focal_length_x == camera.focal_length_y == pytest.approx(odd_sets.FOCAL_PX, rel=0.01)
    steps = steps_of(model)
    assert steps.max() < 1.05 * steps.min()


@pytest.mark.slow
def test_a_street_walked_forward_is_registered_by_a_second_try(run: Run) -> None:
    done = run("street", "features.colmap={sift: {first_octave: -1, peak_threshold: 0.0067}}")
    assert (done.summary["models"], done.summary["too_few_registered"]) == ([10], False)
    assert "registered only 2 of 10 photographs, and 10 in a second try" in warnings(done)
    steps = steps_of(pycolmap.Reconstruction(done.sparse_model))
    assert steps.max() < 1.2 * steps.min()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["repeated_facade", "two_wings"])
def test_like_parts_taken_for_one_are_told(run: Run, name: str) -> None:
    done = run(name)
    assert "like parts" in warnings(done)
    assert "matches.strategy=sequential" in warnings(done)


@pytest.mark.slow
def test_neighbours_only_unfolds_two_wings(run: Run) -> None:
    """What the warning advises, on the set that it is given for."""
    advice = (
        "matches.pairing={overlap: 2, quadratic_overlap: false}",
        "sparse.colmap.ba_refine_focal_length=false",
    )
    done = run("two_wings", "matches.strategy=sequential", *advice)
    model = pycolmap.Reconstruction(done.sparse_model)
    steps = steps_of(model)
    assert len(steps) == 18
    assert steps.max() < 1.5 * np.median(steps)
    assert "like parts" not in warnings(done)


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", ["fountain-p11", "sceaux", "sacre-coeur"])
def test_no_false_alarm_on_real_photographs(photographs: Path, tmp_path: Path, name: str) -> None:
    options = load_options(None, [*QUICK, "features.max_image_size=1400"])
    said = warnings(reconstruct(tmp_path, options, images=photographs / name))
    for words in ("like parts", "no camera has", "of one plane", "came out", "are not registered"):
        assert words not in said


# The parts


CAMERA = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 500, 640, 480)


def projected(points: Any, turn_degrees: float, step: float) -> Any:
    angle = np.radians(turn_degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    seen = (points - (step, 0, 0)) @ turn.T
    return seen[:, :2] / seen[:, 2:] * 500 + (320, 240)


@pytest.mark.parametrize(
    ("step", "deep", "only_turned"), [(0, 3, True), (0, 0, True), (0.8, 3, False), (1.2, 0, False)]
)
@pytest.mark.parametrize("guess", [1.0, 1.3])
def test_parallax_tells_turns_from_steps(step: float, deep: float, only_turned: bool, guess: float) -> None:
    draw = np.random.default_rng(2)
    points = draw.uniform((-2, -1.5, 5), (2, 1.5, 5 + deep), (300, 3))
    noise = draw.normal(0, 0.3, (2, 300, 2))
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 500 * guess, 640, 480)
    camera.has_prior_focal_length = guess == 1
    first, second = projected(points, 0, 0) + noise[0], projected(points, 6, step) + noise[1]
    parallax, turn = parallax_of(first, second, camera, camera)
    assert (parallax < TURNED_DEGREES) == only_turned
    if step == 0 and guess == 1:
        assert turn == pytest.approx(6, abs=0.5)


def test_thickness_of_a_plane_with_strays() -> None:
    draw = np.random.default_rng(3)
    flat = draw.uniform((-5, -3, 0), (5, 3, 0.02), (500, 3)) @ np.linalg.qr(draw.normal(size=(3, 3)))[0]
    boxed = draw.uniform((-5, -3, 0), (5, 3, 1), (500, 3))
    assert thickness(np.vstack([flat, draw.uniform(-5, 5, (10, 3))])) < 0.01 < 0.03 < thickness(boxed)
    assert thickness(flat[:10]) == 1


GREYS = {"a.png": "a.jpg", "b.png": "b.jpg"}


def test_the_sentences_about_a_model() -> None:
    def folded(blind: int, near: int, torn: int, matched: int) -> str:
        found = Conflicts(near, (("a.png", "b.png", 0.6),) * blind, matched, (("a.png", "b.png", 80),) * torn)
        return "".join(fold_warnings(found, GREYS))

    assert folded(1, 10, 1, 10) == folded(2, 60, 2, 60) == ""
    assert "a.jpg and b.jpg share only 40 %" in folded(2, 10, 0, 10)
    assert "(80 matches) show the same place" in folded(0, 10, 3, 10)

    def cameras(prior: float | None, focal: float, aspect: float) -> str:
        return "".join(camera_warnings([SolvedCamera(("a.png", "b.png"), prior, focal, aspect)], GREYS))

    assert cameras(1000, 1100, 1.02) == cameras(None, 3000, 0.99) == ""
    assert "1.20 times what they say (1200 px, not 1000)" in cameras(1000, 1200, 1)
    assert "by a factor of 1.25 across and down" in cameras(1000, 1000, 0.8)
    assert "give the focal length" in cameras(None, 1000, 1.3)

    known = [SolvedCamera(("a.png",), 1000, 1000, 1)]
    assert flat_warnings(Shape(0.02, 10), known) == flat_warnings(Shape(0.001, 60), known) == []
    assert "within 0.1 % of one plane" in flat_warnings(Shape(0.0001, 10), known)[0]
    assert few_found_again(0.09, []) == few_found_again(0.3, ["a.jpg"]) == []
    assert "only 12 %" in few_found_again(0.12, ["a.jpg"])[0]
