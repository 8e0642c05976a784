"""Measure how well control, scale bars, positions and GPS make a model metric.

    python benchmarks/survey.py [--demo PROJECT] [--fountain PROJECT] [--json]

A simulated block of 40 photographs with 8 control and 8 check points surveyed to 5 mm, five seeds, straight and bent by
a lens that is not known: check-point RMS, beside what the covariance predicts and with a similarity alone. PROJECT of
`--demo`: a demo that is reconstructed; with its control, its two scale bars alone, and a similarity alone. PROJECT of
`--fountain`: fountain-p11 reconstructed at any size; with camera positions of 5 cm noise, and GPS of 5 m: scale, and
position errors after a similarity, in millimetres.
"""

from __future__ import annotations

import argparse
import json
import sys
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from calibration import truth_of
from guard_sets import DATA

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.machine.executor import local_executor
from colmap_ihe.survey import georeference as room
from colmap_ihe.survey.accuracy import point_rms, rms
from colmap_ihe.survey.alignment import Survey
from colmap_ihe.survey.control import CameraPosition, SurveyedPoint
from colmap_ihe.survey.control_files import read_control
from colmap_ihe.survey.georeference import Georeferenced, georeference
from colmap_ihe.survey.target_observations import targets_of_set

sys.path.insert(0, str(Path(__file__).parents[1] / "tests/scenes"))
from survey_block import survey_block

Rows = list[dict[str, Any]]
_ACCURACY = 0.005


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
    free = {1: [0, 3]}
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
        copy = pycolmap.Reconstruction(model)
        with nullcontext() if adjust else _without_adjustment():
            result = georeference(copy, survey, sights, "auto", free)
        check, expected = _check_mm(result)
        row: dict[str, Any] = {"set": f"demo, {name}"}
        if survey.points:
            row |= {"check_rms_mm": check, "predicted_mm": expected, "check_percent": check / extent / 10}
        else:
            row["scale_off_percent"] = 100 * (_scale(project, copy) - 1)
        rows.append(row)
    return rows


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
    parser.add_argument("--demo", type=Path)
    parser.add_argument("--fountain", type=Path)
    parser.add_argument("--json", action="store_true")
    parsed = parser.parse_args()
    rows = blocks()
    rows += demo(parsed.demo) if parsed.demo else []
    rows += fountain(parsed.fountain) if parsed.fountain else []
    for row in rows:
        values = "  ".join(f"{k} {v:.4g}" for k, v in row.items() if k != "set")
        print(json.dumps(row) if parsed.json else f"{row['set']:45} {values}")


if __name__ == "__main__":
    main()
