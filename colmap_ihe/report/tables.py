"""Write tables: the summary of a project as rows for a person, and any table as CSV and as LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from colmap_ihe.report.camera_words import camera_rows
from colmap_ihe.report.survey_words import survey_in_words
from colmap_ihe.report.truth_words import truth_rows

_NAMES = ("red", "green", "blue")
_LATEX = {
    "\\": r"\textbackslash{}",
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


@dataclass(frozen=True)
class Table:
    """Hold rows of as many texts as there are columns; the first column names the row. `name` is short, for a file."""

    name: str
    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    def as_csv(self) -> str:
        """Return the columns and rows as CSV."""
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([self.columns, *self.rows])
        return text.getvalue()

    def as_latex(self) -> str:
        """Return a tabular in the style of booktabs, with its caption."""
        head, *body = [" & ".join(map(_escaped, row)) + r" \\" for row in (self.columns, *self.rows)]
        caption = rf"\caption{{{_escaped(self.title)}}}"
        begin = [r"\begin{table}", caption, rf"\begin{{tabular}}{{l{'r' * (len(self.columns) - 1)}}}"]
        end = [r"\bottomrule", r"\end{tabular}", r"\end{table}", ""]
        return "\n".join([*begin, r"\toprule", head, r"\midrule", *body, *end])


def _escaped(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)


def summary_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the summary as a person reads it: a name and a value a row, nothing for what has not run."""
    rows = [("photographs", _photographs(summary))]
    if summary["weights"] is not None:
        rows.append((f"grey ({summary['method']})", weights_in_words(summary["weights"])))
    if summary["tried"]:
        rows.append(("measured", summary["tried"]["in_words"]))
    if summary["colour_detail_lost_percent"]:
        lost = summary["colour_detail_lost_percent"]
        rows.append(("colour detail lost", f"{lost['grey']:.2f} %; by Rec.709 {lost['rec709']:.2f} %"))
    if summary["second_grey"]:
        rows.append(("second grey", second_in_words(summary["second_grey"])))
    if summary["registered_images"] is not None:
        over_3 = f"{summary['points_over_3_views']:,} seen in more than 3 images"
        rows += [
            ("registered images", f"{summary['registered_images']} of {summary['images']}"),
            ("points", f"{summary['points3D']:,}, {over_3}"),
            ("mean reprojection error", f"{summary['mean_reprojection_error_px']:.3f} px"),
            ("mean track length", f"{summary['mean_track_length']:.2f} observations a point"),
            *camera_rows(summary),
        ]
    if line := survey_in_words(summary):
        rows.append(("survey", line))
    if summary["dense_points"] is not None:
        coverage = summary["dense_pixels_with_depth_percent"]
        share = f", {coverage:.0f} % of the pixels have depth" if coverage is not None else ""
        cloud = f"{summary['dense_points']:,} points ({summary['dense_backend']}{share})"
        rows.append(("dense cloud", cloud))
    if summary["mesh_faces"] is not None:
        size = summary["mesh_texture"]
        look = f"a texture of {size[0]}x{size[1]}" if size else "vertex colours"
        rows.append(("mesh", f"{summary['mesh_faces']:,} triangles with {look}"))
    rows += truth_rows(summary.get("truth", {}))
    page = summary.get("page_seconds")
    times = {**summary["stages"], **({} if page is None else {"page": page})}
    stages = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in times.items())
    return [*rows, ("time", f"{stages}: {sum(times.values()):.0f} s")]


def weights_in_words(weights: Sequence[float]) -> str:
    """Write R, G, B in 0..1 as percentages."""
    return ", ".join(f"{100 * w:.0f} % {name}" for w, name in zip(weights, _NAMES, strict=True))


def _photographs(summary: Mapping[str, Any]) -> str:
    left_out = len(summary["left_out"])
    return f"{summary['images']}" + (f", {left_out} left out" if left_out else "")


def lost_in_words(summary: Mapping[str, Any], compared: bool = True) -> str:
    """Return a sentence on the detail that shows in colour and not in grey, and if `compared`, in COLMAP's default;
    `summary` holds `colour_detail_lost_percent`."""
    lost = summary["colour_detail_lost_percent"]
    said = (
        f"In {lost['grey']:.2f} % of the places with detail the grey keeps less than 0.3 of what colour shows"
    )
    if not compared:
        return f"{said}."
    default = "COLMAP's default grey" if summary["method"] != "rec709" else "Rec.709 of the colours"
    return f"{said}; {default} in {lost['rec709']:.2f} %."


def second_in_words(second: Mapping[str, Any]) -> str:
    """Return the second grey, and what it brings, in a sentence; `second` is that of the summary."""
    weights = " ".join(f"{weight:+.2f} {name}" for weight, name in zip(second["weights"], "RGB", strict=True))
    added = "" if second["features"] is None else f"; {second['features']:,} features are from it"
    return f"{weights}, and shows {second['shown_percent']:.0f} % of the places that the grey loses{added}"
