"""The methods sentence claims what was done, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest

from colmap_ihe.project.options import Options
from colmap_ihe.report.methods_sentence import citation, is_default, methods_sentence

SUMMARY: dict[str, Any] = {
    "weights_by_encoding": {"coded": [0.61, 0.34, 0.05]}, "tried": None, "second_grey": None, "registered_images": 8,
    "dense_points": None, "dense_backend": None, "cameras": None,
}  # fmt: skip
DEFAULT = {"weights_by_encoding": {"coded": [0.21, 0.72, 0.07]}}


def sentence(fit: dict[str, Any], **summary: Any) -> str:
    return methods_sentence(SUMMARY | summary, Options.model_validate({"fit": fit}), "4.2.1")


def test_the_whole_sentence() -> None:
    assert sentence({}) == (
        "The photographs were converted to grey by one conversion for the whole set, intensity histogram equalisation"
        " (IHE) with a guard against noise (61 % red, 34 % green, 5 % blue), and reconstructed with COLMAP"
        " (pycolmap 4.2.1) driven by colmap-ihe."
    )


def test_cameras_that_were_calibrated() -> None:
    cameras = [{"model": model, "by": by} for model, by in (("RADIAL", "calibration"), ("OPENCV", "given"))]
    said = sentence({}, cameras=cameras)
    assert said.endswith(
        "driven by colmap-ihe, with cameras calibrated by the photographs themselves (camera model RADIAL)."
    )


def test_a_guard_that_kept_the_default_is_said_and_ihe_not_claimed() -> None:
    assert (
        "one conversion for the whole set, COLMAP's default grey, Rec.709, which of the weights that a guard against"
        " noise admits came out best by intensity histogram equalisation (IHE) (21 % red, 72 % green, 7 % blue)"
    ) in sentence({}, **DEFAULT)


@pytest.mark.parametrize(
    ("fit", "summary", "words"),
    [
        ({"guard": "none"}, DEFAULT, "for the whole set, intensity histogram equalisation (IHE) (21 %"),
        ({"method": "rec709"}, DEFAULT, "for the whole set, COLMAP's default grey, Rec.709 (21 %"),
        ({"method": "green"}, {}, "for the whole set, the method green (61 %"),
        ({"weights": "other.yaml"}, {}, "weights that were given and not fitted to these photographs (61 %"),
        ({"method": "decolorize"}, {"weights_by_encoding": {"coded": None}}, "fitted to each photograph by itself,"
         " the method decolorize, and reconstructed"),
        ({}, {"tried": {"chosen": "rec709", "fitted": [0.2, 0.4, 0.4], "in_words": "", "pairs": [1, 2],
                        "held_out": {"pairs": [3, 4, 5, 6]}}, **DEFAULT},
         "COLMAP's default grey, Rec.709, since the weights of intensity histogram equalisation (IHE)"
         " with a guard against noise were not clearly better on 4 pairs of the photographs (21 %"),
        ({}, {"tried": {"chosen": "rec709", "fitted": [0.2, 0.4, 0.4], "in_words": "Rec.709 after white balance",
                        "pairs": [1, 2], "held_out": {"pairs": [3, 4, 5, 6]}}},
         "Rec.709 after white balance, since the weights of intensity histogram equalisation (IHE) with a guard against"
         " noise were clearly worse on 4 pairs"),
        ({}, {"tried": {"chosen": "rec709", "fitted": [0.2, 0.4, 0.4], "in_words": "", "pairs": [], "reason": "few"},
              **DEFAULT}, "since there were too few pairs of photographs to try the weights of intensity"),
        ({"method": "auto"}, {"tried": {"chosen": "0.25 0.5 0.25", "pairs": [1, 2, 3]}},
         "the candidate 0.25 0.5 0.25, of all candidates that with most verified matches on 3 pairs"),
        ({"method": "auto"}, {"tried": {"chosen": "rec709", "pairs": [1]}, **DEFAULT},
         "COLMAP's default grey, Rec.709: no other candidate was clearly better on 1 pair of the photographs (21 %"),
        ({"method": "auto"}, {"tried": {"chosen": "ihe", "pairs": []}}, "since no pair of photographs was there"),
        ({}, {"weights_by_encoding": {"coded": [0.2, 0.3, 0.5], "linear": [0.4, 0.2, 0.4]}},
         "(gamma-coded: 20 % red, 30 % green, 50 % blue; raw: 40 % red, 20 % green, 40 % blue), and"),
        ({}, {"second_grey": {"weights": [1.7, -1.9, 0.3]}},
         "5 % blue), with a second grey of the set (+1.70 R -1.90 G +0.30 B) for features and stereo"),
        ({}, {"registered_images": None}, "5 % blue) by colmap-ihe."),
        ({}, {"dense_points": 9, "dense_backend": "sgm"}, "; depth maps are by semi-global matching on the CPU"),
        ({}, {"dense_points": 9, "dense_backend": "patchmatch"}, "driven by colmap-ihe."),
    ],
)  # fmt: skip
def test_what_was_done(fit: dict[str, Any], summary: dict[str, Any], words: str) -> None:
    assert words in sentence(fit, **summary)


def test_the_paper_is_cited_where_its_method_had_a_say() -> None:
    def cited(tried: dict[str, Any] | None = None, **fit: Any) -> bool:
        return bool(citation(SUMMARY | {"tried": tried}, Options.model_validate({"fit": fit})))

    assert cited() and cited({"chosen": "ihe of the paper"}, method="auto")
    assert not cited(method="green") and not cited(weights="other.yaml")
    assert not cited({"chosen": "rec709"}, method="auto")


def test_a_grey_is_the_default_only_for_all_kinds_of_photographs() -> None:
    assert is_default(DEFAULT)
    assert not is_default({"weights_by_encoding": {"coded": [0.21, 0.72, 0.07], "linear": [0.3, 0.4, 0.3]}})
    assert not is_default({"weights_by_encoding": {"coded": None}}) and not is_default(
        {"weights_by_encoding": {}}
    )
