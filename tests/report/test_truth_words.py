from __future__ import annotations

from colmap_ihe.report.truth_words import truth_rows


def test_the_figures_of_a_demo_are_said_in_words() -> None:
    rows = truth_rows(
        {
            "rotation_error_deg": 0.00639,
            "position_error_percent": 0.00128,
            "dense_median_error_percent": 0.0294,
            "depth_right_percent": 91.03,
            "depth_wrong_percent": 0.849,
            "painted_depth_percent": {"rosette": 99.9, "lattice": 71.93},
            "painted_depth_in_portico_05_by_two_greys_percent": {"rosette": 100.0},
            "painted_depth_in_portico_05_by_one_grey_percent": {"rosette": 59.72},
        }
    )
    assert rows == [
        (
            "cameras against the truth",
            "rotations 0.0064 degrees off, positions 0.0013 % of the model's extent",
        ),
        (
            "depth against the truth",
            "0.029 % off in the median, right within 2 % in 91.0 % of the pixels, wrong in 0.85 % of the depths",
        ),
        ("depth on painted panels", "rosette 99.9, lattice 71.9 %"),
        ("the same in portico_05", "rosette 100.0 %; with the first grey alone rosette 59.7 %"),
    ]


def test_what_is_not_known_has_no_row() -> None:
    assert truth_rows({}) == []
    assert [name for name, _ in truth_rows({"rotation_error_deg": 0.1})] == ["cameras against the truth"]
