"""project.yaml and --set: what is taken, and that everything else is refused in one line that says why."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from colmap_ihe.errors import OptionError
from colmap_ihe.project.options import Options
from colmap_ihe.project.options_file import load_options


def written(folder: Path, text: str) -> Path:
    (folder / "project.yaml").write_text(text, encoding="utf-8")
    return folder / "project.yaml"


def refused(path: Path | None, *assignments: str) -> str:
    with pytest.raises(OptionError) as caught:
        load_options(path, assignments)
    assert "\n" not in str(caught.value)
    return f"{caught.value} ({caught.value.hint})"


def test_the_defaults_need_no_file(tmp_path: Path) -> None:
    assert load_options(None) == load_options(tmp_path / "project.yaml") == Options()
    assert load_options(written(tmp_path, "")) == Options()
    assert load_options(written(tmp_path, "# nothing\nfit:\n")) == Options()


def test_the_names_that_are_contracts() -> None:
    contracts: dict[str, dict[str, Any]] = {
        "fit": {"method": "ihe", "guard": "noise", "step": 0.01, "sample": 1.0, "weighting": "pixel"},
        "convert": {"tone": "sqrt", "wallis": False, "format": "png"},
        "features": {"max_image_size": None, "colmap": {}},
        "matches": {"strategy": "auto", "colmap": {}},
        "sparse": {"colmap": {}},
        "dense": {"enabled": True, "backend": "auto", "max_image_size": 1600, "colmap": {}},
    }
    defaults = Options().as_yaml()
    for section, expected in contracts.items():
        assert {name: defaults[section][name] for name in expected} == expected


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    text = "fit:\n  step: 0.1\n  method: rec709\ncamera: {model: PINHOLE, params: [500, 501, 320, 240]}\n"
    options = load_options(written(tmp_path, text))
    assert (options.fit.step, options.fit.method) == (0.1, "rec709")
    assert options.camera.params == (500, 501, 320, 240)
    assert options.model_copy(update={"fit": Options().fit, "camera": Options().camera}) == Options()


@pytest.mark.parametrize(
    ("assignment", "value"),
    [
        ("fit.method=green", "green"),
        ("fit.step=0.05", 0.05),
        ("fit.step=1", 1.0),
        ("dense.enabled=false", False),
        ("dense.enabled=no", False),
        ("dense.max_image_size=2400", 2400),
        ("features.max_image_size=null", None),
        (" sparse.seed=7", 7),
        ("features.colmap={use_gpu: false}", {"use_gpu": False}),
        ("features.colmap.sift.max_num_features=99", {"sift": {"max_num_features": 99}}),
        ("matches.pairing.overlap=5", {"overlap": 5}),
    ],
)
def test_set_takes_yaml_values(assignment: str, value: Any) -> None:
    section, option = assignment.strip().partition("=")[0].split(".")[:2]
    found = getattr(getattr(load_options(None, [assignment]), section), option)
    assert found == value
    assert type(found) is type(value)


def test_set_goes_over_the_file_and_the_last_one_wins(tmp_path: Path) -> None:
    file = written(tmp_path, "features:\n  colmap:\n    use_gpu: false\n    sift: {max_num_features: 5}\n")
    options = load_options(file, [f"features.colmap.sift.max_num_features={n}" for n in (6, 7)])
    assert options.features.colmap == {"use_gpu": False, "sift": {"max_num_features": 7}}


CAMERAS = """
cameras:
  "drone/*.JPG": {make: DJI, model: FC6310, focal_length: 8.8, sensor_width: 13.2}
  "*": {focal_length: 24, focal_length_35mm: 36}
"""


def test_cameras_are_known_by_pattern_in_the_order_of_the_file(tmp_path: Path) -> None:
    known = load_options(written(tmp_path, CAMERAS)).cameras.root
    assert list(known) == ["drone/*.JPG", "*"]
    drone, other = known.values()
    assert (drone.make, drone.model, drone.focal_length, drone.sensor_width) == ("DJI", "FC6310", 8.8, 13.2)
    assert (other.focal_length, other.focal_length_35mm, other.override) == (24, 36, False)


def test_the_order_of_patterns_is_part_of_what_is_noted(tmp_path: Path) -> None:
    forth = load_options(written(tmp_path, CAMERAS)).cameras
    back = type(forth).model_validate(dict(reversed(forth.root.items())))
    assert forth.root == back.root
    assert forth.model_dump(mode="json") != back.model_dump(mode="json")


@pytest.mark.parametrize(
    ("pattern", "assigned", "known"),
    [
        ("*", [".focal_length=24"], {"focal_length": 24}),
        ("*", [".focal_length=24", ".sensor_width=36"], {"focal_length": 24, "sensor_width": 36}),
        ("drone/*.JPG", [".focal_length=8.8"], {"focal_length": 8.8}),
        ("a.b/*.JPG", ["={model: x, override: true}"], {"model": "x", "override": True}),
    ],
)
def test_set_knows_cameras(pattern: str, assigned: list[str], known: dict[str, Any]) -> None:
    found = load_options(None, [f"cameras.{pattern}{text}" for text in assigned]).cameras.root
    assert {p: k.model_dump(exclude_unset=True) for p, k in found.items()} == {pattern: known}


def test_set_changes_a_pattern_of_the_file_in_its_place(tmp_path: Path) -> None:
    assigned = ["cameras.drone/*.JPG.focal_length=9", "cameras.x.model=y"]
    known = load_options(written(tmp_path, CAMERAS), assigned).cameras.root
    assert list(known) == ["drone/*.JPG", "*", "x"]
    assert (known["drone/*.JPG"].focal_length, known["drone/*.JPG"].sensor_width) == (9, 13.2)


def test_camera_parameters_become_numbers() -> None:
    camera = load_options(None, ["camera.model=SIMPLE_PINHOLE", "camera.params=[1, 2.5, 3]"]).camera
    assert [repr(p) for p in camera.params or ()] == ["1.0", "2.5", "3.0"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("dance:\n  enabled: true\n", ["unknown option 'dance'", "dense"]),
        ("fit:\n  stepp: 0.1\n", ["unknown option 'fit.stepp'", "step, sample"]),
        ("fit:\n  step: fine\n", ["fit.step is 'fine'"]),
        ("fit:\n  step: 0.03\n", ["fit.step is 0.03"]),
        ("fit:\n  sample: 0\n", ["fit.sample is 0", "greater than 0"]),
        ("fit:\n  method: best\n", ["fit.method is 'best'", "ihe, "]),
        ("dense:\n  enabled: 1\n", ["dense.enabled is 1"]),
        ("dense:\n  enabled: 'yes'\n", ["dense.enabled is 'yes'"]),
        ("dense:\n  max_image_size: 1600.5\n", ["dense.max_image_size is 1600.5"]),
        ("dense:\n  max_image_size: 10\n", ["dense.max_image_size is 10", "64"]),
        ("dense:\n  max_image_size: true\n", ["dense.max_image_size is True"]),
        ("features:\n  colmap: [1]\n", ["features.colmap is [1]"]),
        ("camera:\n  params: 500\n", ["camera.params is 500"]),
        ("camera:\n  params: [1, 2, 3]\n", ["camera.params needs camera.model"]),
        (
            "camera: {calibration: c.yaml, model: OPENCV}\n",
            ["camera is", "camera.calibration, or camera.model"],
        ),
        (
            "camera: {calibration: c.yaml, model: PINHOLE, params: [9, 9, 9, 9]}\n",
            ["camera.calibration, or camera.model with camera.params"],
        ),
        ("camera: {calibration: 5}\n", ["camera.calibration is 5"]),
        ("camera: {fixed: maybe}\n", ["camera.fixed is 'maybe'"]),
        *(
            (f"camera: {{model: OPENCV, params: [{p}, 2]}}", ["camera.params"])
            for p in ("null", "9" * 400, "[1]", "{}")
        ),
        ("cameras:\n  '*': {focal: 24}\n", ["cameras.*.focal'", "focal_length, sensor_width"]),
        ("cameras:\n  'a.b/*': {focal_length: -1}\n", ["cameras.a.b/*.focal_length is -1", "greater than 0"]),
        ("cameras:\n  '*': {focal_length: .inf}\n", ["focal_length is inf"]),
        ("cameras:\n  '*': {sensor_width: .nan}\n", ["sensor_width is nan"]),
        ("cameras:\n  '*': {sensor_width: '36'}\n", ["sensor_width is '36'"]),
        ("cameras:\n  '*': {focal_length: true}\n", ["focal_length is True"]),
        ("cameras:\n  '*': {focal_length_35mm: 36.5}\n", ["is 36.5", "whole number", "sensor_width"]),
        ("cameras:\n  '*': {model: 300}\n", ["cameras.*.model is 300"]),
        ("cameras:\n  '*': {make: ''}\n", ["cameras.*.make is ''"]),
        ("cameras:\n  '*': {override: true}\n", ["expected some of make, model"]),
        ("cameras:\n  '*': {}\n", ["expected some of make, model"]),
        ("cameras:\n  '*':\n", ["cameras.* is None"]),
        ("cameras:\n  focal_length: 24\n", ["cameras.focal_length is 24"]),
        ("cameras:\n  *: {focal_length: 24}\n", ["not readable as YAML", "quotes"]),
        ("cameras:\n  2016: {focal_length: 24}\n", ["cameras.2016"]),
        ("fit: [step, 0.1]\n", ["expected sections"]),
        ("- fit\n- dense\n", ["holds list", "expected sections"]),
        ("just words", ["holds str"]),
        ("fit: {step: 0.1\n", ["not readable as YAML"]),
        ("fit:\n\tstep: 0.1\n", ["not readable as YAML"]),
        ("!!python/object/apply:os.getcwd []\n", ["not readable as YAML"]),
    ],
)
def test_anything_else_in_the_file_is_refused(tmp_path: Path, text: str, words: list[str]) -> None:
    message = refused(written(tmp_path, text))
    assert str(tmp_path / "project.yaml") in message
    for word in words:
        assert word in message


def test_a_file_that_is_no_text_and_a_folder_are_refused(tmp_path: Path) -> None:
    (tmp_path / "project.yaml").write_bytes(b"\xff\xfe\x00fit")
    assert "not readable as YAML" in refused(tmp_path / "project.yaml")
    refused(tmp_path)


REFUSED = """
fit.step  step=0.1  =1  fit.=1  .step=0.1  fit.step=[  fit.step=  fit.stepp=0.1  fit.step.more=1
dense.enabled=1  dance.on=true  features.colmap=3  nowhere.deep.er=1
cameras={}  cameras.*={}  cameras.*=24  cameras.*.focal=24  cameras.*.focal_length=wide
"""


@pytest.mark.parametrize("assignment", REFUSED.split())
def test_any_other_assignment_is_refused_and_named(assignment: str) -> None:
    assert f"--set {assignment}" in refused(None, assignment)


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
        max_leaves=6,
    ),
    st.sampled_from(["fit", "dense", "features", "matches"]),
)
def test_no_value_at_all_gives_anything_but_options_or_an_option_error(value: Any, section: str) -> None:
    import yaml

    for name in Options.model_fields[section].default.model_dump():
        text = yaml.safe_dump(value, default_flow_style=True).strip().removesuffix("...").strip()
        try:
            assert isinstance(load_options(None, [f"{section}.{name}={text}"]), Options)
        except OptionError as error:
            assert section in str(error)


def test_a_cluster_may_be_just_its_address(tmp_path: Path) -> None:
    cluster = load_options(written(tmp_path, "cluster: local:4\n"), ["cluster.patience=5"]).cluster
    assert (cluster.address, cluster.patience) == ("local:4", 5)
    assert load_options(None).cluster.address is None


def test_lines_of_a_title_may_be_dates_and_numbers(tmp_path: Path) -> None:
    (tmp_path / "project.yaml").write_text("drawings: {title: {date: 2026-05-12, sheet: 3, object: St Mary}}")
    title = load_options(tmp_path / "project.yaml").drawings.title
    assert title == {"date": "2026-05-12", "sheet": "3", "object": "St Mary"}


@pytest.mark.parametrize("name", ["../x", "a/b", ".x", "", "a\\nb", "x" * 65])
def test_a_drawing_is_called_like_a_folder(name: str) -> None:
    with pytest.raises(OptionError, match="is no name of a drawing"):
        load_options(None, [f"drawings.views={json.dumps({name: {'height': 1}})}"])
