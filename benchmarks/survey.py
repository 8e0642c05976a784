"""Measure how well control, scale bars, positions and GPS make a model metric.

    python benchmarks/survey.py [--demo PROJECT ...] [--fountain PROJECT] [--json]

A simulated block of 40 photographs with 8 control and 8 check points surveyed to 5 mm, five seeds, straight and bent by
a lens that is not known: check-point RMS, beside what the covariance predicts and with a similarity alone. PROJECT of
`--demo`: a demo that is reconstructed, as it is and with `sparse.calibration: colmap`; with its control, its two scale
bars alone, and a similarity alone, then surveyed anew eight times: `survey_mm` is by how much the survey of the check
points themselves is off, `true_mm` how far the model is from where they truly are. PROJECT of
`--fountain`: fountain-p11 reconstructed at any size; with camera positions of 5 cm noise, and GPS of 5 m: scale, and
position errors after a similarity, in millimetres.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest import mock

import numpy as np
from calibration import truth_of
from guard_sets import DATA

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.evaluation.demo.targets import TARGETS, control_files
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.survey import georeference as room
from colmap_ihe.survey.accuracy import point_rms, rms
from colmap_ihe.survey.alignment import Survey
from colmap_ihe.survey.control import CameraPosition, SurveyedPoint
from colmap_ihe.survey.control_files import read_control
from colmap_ihe.survey.georeference import Georeferenced, georeference
from colmap_ihe.survey.observations import Observation
from colmap_ihe.survey.target_observations import targets_of_set
from colmap_ihe.survey.targets import target_name

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/scenes"))
from survey_block import survey_block

Rows = list[dict[str, Any]]
_ACCURACY = 0.005
_SURVEYS = 8


def _without_adjustment() -> AbstractContextManager[int]:
    return mock.patch.object(room, "MOST_IMAGES", 0)


def _check_mm(result: Georeferenced) -> tuple[float, float]:
    """Return the RMS of check points and what is expected of it, in millimetres."""
    expected = rms([p.deviation_m for p in result.points if p.role == "check" and p.deviation_m])
    return 1000 * (point_rms(result.points, "check") or np.nan), 1000 * (expected or np.nan)


def blocks() -> Rows:
    rows = []
    for bent in (False, True):
        for seed in range(5):
            block = survey_block(40, 16, 3000, seed=seed, bent=bent)
            draw = np.random.default_rng(seed)
            points = {}
            for number, (name, place) in enumerate(block.named.items()):
                x, y, z = (place + draw.normal(0, _ACCURACY, 3)).tolist()
                role = "check" if number % 4 in (1, 2) else "control"
                points[name] = SurveyedPoint(name, (x, y, z), _ACCURACY, role)  # type: ignore[arg-type]
            survey, free = Survey(points=points), {1: [0, 1, 2, 3]}
            copy = pycolmap.Reconstruction(block.model)
            with _without_adjustment():
                moved = georeference(copy, survey, block.sights, "auto", free)
            check, expected = _check_mm(georeference(block.model, survey, block.sights, "auto", free))
            rows.append(
                {
                    "set": f"block of 40{', bent' if bent else ''}, seed {seed}",
                    "check_rms_mm": check,
                    "predicted_mm": expected,
                    "ratio": check / expected,
                    "similarity_alone_mm": _check_mm(moved)[0],
                }
            )
    return rows


def demo(project: Path) -> Rows:
    control = read_control(project / "control")
    model = pycolmap.Reconstruction(project / "workspace/sparse/0")
    with local_executor() as executor:
        sights = targets_of_set(model, project / "workspace/images", executor).observations
    whole = Survey(points=control.points, bars=control.scale_bars)
    extent = float(np.linalg.norm(np.ptp([p.xyz for p in control.points.values()], axis=0)))
    rows = []
    for name, survey, adjust in (
        ("control and bars", whole, True),
        ("similarity alone", whole, False),
        ("two scale bars alone", Survey(bars=control.scale_bars), True),
    ):
        result, copy = _georeferenced(model, survey, sights, adjust)
        row: dict[str, Any] = {"set": f"{project.name}, {name}"}
        if survey.points:
            check, expected = _check_mm(result)
            row |= {"check_rms_mm": check, "predicted_mm": expected, "check_percent": check / extent / 10}
            row |= _against_the_truth(result)
        else:
            row["scale_off_percent"] = 100 * (_scale(project, copy) - 1)
        rows.append(row)
    for name, adjust in (("control and bars", True), ("similarity alone", False)):
        rows.append(
            {"set": f"{project.name}, {name}, {_SURVEYS} surveys"} | _surveyed_anew(model, sights, adjust)
        )
    return rows


def _georeferenced(
    model: pycolmap.Reconstruction, survey: Survey, sights: Sequence[Observation], adjust: bool
) -> tuple[Georeferenced, pycolmap.Reconstruction]:
    copy = pycolmap.Reconstruction(model)
    with nullcontext() if adjust else _without_adjustment():
        return georeference(copy, survey, sights, "auto", {1: [0, 3]}), copy


def _against_the_truth(result: Georeferenced) -> dict[str, float]:
    true = {target_name(target.number): target.centre for target in TARGETS}
    checks = [p for p in result.points if p.role == "check" and p.delta_m and p.surveyed]
    off = np.array([np.subtract(p.surveyed or 0, true[p.name]) for p in checks])
    there = np.array([p.delta_m for p in checks]) + off
    survey, model = (1000 * float(np.sqrt((one**2).sum(axis=1).mean())) for one in (off, there))
    return {"survey_mm": survey, "true_mm": model}


def _surveyed_anew(
    model: pycolmap.Reconstruction, sights: Sequence[Observation], adjust: bool
) -> dict[str, float]:
    """Quadratic means over several surveys of the same targets, and how many good points were left out."""
    figures, left_out = [], 0
    for seed in range(_SURVEYS):
        with TemporaryDirectory() as folder:
            for name, text in control_files(seed).items():
                Path(folder, name).write_text(text, encoding="utf-8")
            control = read_control(Path(folder))
        result, _ = _georeferenced(
            model, Survey(points=control.points, bars=control.scale_bars), sights, adjust
        )
        check, expected = _check_mm(result)
        figures.append({"check_rms_mm": check, "predicted_mm": expected, **_against_the_truth(result)})
        left_out += sum(p.role == "control" and not p.used for p in result.points)
    means = {key: float(np.sqrt(np.mean([one[key] ** 2 for one in figures]))) for key in figures[0]}
    return means | {"left_out": left_out}


def _scale(project: Path, model: pycolmap.Reconstruction) -> float:
    """Return how many units of a model a true metre is, by the demo's camera positions."""
    from colmap_ihe.evaluation.truth import key_of, read_truth

    truth = read_truth(project / "truth")
    centres = {str(model.images[i].name): model.images[i].projection_center() for i in model.reg_image_ids()}
    poses = {name: truth.images[key_of(name)].cam_from_world for name in centres}
    return _spread(list(centres.values())) / _spread([-p[:, :3].T @ p[:, 3] for p in poses.values()])


def _spread(points: list[Any]) -> float:
    places = np.array(points)
    return float(np.sqrt(np.mean(np.sum((places - places.mean(axis=0)) ** 2, axis=1))))


def fountain(project: Path) -> Rows:
    poses = truth_of(DATA / "fountain-p11")
    true = {Path(name).stem: -p[:, :3].T @ p[:, 3] for name, p in poses.items()}
    model = pycolmap.Reconstruction(project / "workspace/sparse/0")
    names = {str(model.images[i].name): Path(str(model.images[i].name)).stem for i in model.reg_image_ids()}
    free = {i: list(range(len(c.params))) for i, c in model.cameras.items()}
    rows = [{"set": "fountain-p11, as mapped", "position_mm": _position_mm(model, names, true)}]
    for seed in range(3):
        draw = np.random.default_rng(seed)
        positions = []
        for name, stem in names.items():
            x, y, z = (true[stem] + draw.normal(0, 0.05, 3)).tolist()
            positions.append(CameraPosition(name, (x, y, z), 0.05))
        copy = pycolmap.Reconstruction(model)
        georeference(copy, Survey(positions=positions), [], "auto", free)
        scale = _spread([copy.images[i].projection_center() for i in copy.reg_image_ids()]) / _spread(
            [true[stem] for stem in names.values()]
        )
        rows.append(
            {
                "set": f"fountain-p11, positions of 5 cm, seed {seed}",
                "scale_off_percent": 100 * (scale - 1),
                "position_mm": _position_mm(copy, names, true),
            }
        )
    return rows


def _position_mm(model: pycolmap.Reconstruction, names: dict[str, str], true: dict[str, Any]) -> float:
    images = {str(model.images[i].name): model.images[i] for i in model.reg_image_ids()}
    found = np.array([images[name].projection_center() for name in names])
    wanted = np.array([true[stem] for stem in names.values()])
    similarity = pycolmap.estimate_sim3d(found, wanted)
    assert similarity is not None
    moved = similarity.scale * found @ similarity.rotation.matrix().T + similarity.translation
    return float(1000 * np.mean(np.linalg.norm(moved - wanted, axis=1)))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--demo", type=Path, nargs="+", default=[])
    parser.add_argument("--fountain", type=Path)
    parser.add_argument("--json", action="store_true")
    parsed = parser.parse_args()
    rows = blocks()
    for project in parsed.demo:
        rows += demo(project)
    rows += fountain(parsed.fountain) if parsed.fountain else []
    for row in rows:
        values = "  ".join(f"{k} {v:.4g}" for k, v in row.items() if k != "set")
        print(json.dumps(row) if parsed.json else f"{row['set']:45} {values}")


if __name__ == "__main__":
    main()
