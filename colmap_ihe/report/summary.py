"""Summarise a run from its records: for machines as plain values, for people as rows of a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from colmap_ihe.project.options import Options

_NAMES = ("red", "green", "blue")


def summarise(records: Mapping[str, Mapping[str, Any]], options: Options) -> dict[str, Any]:
    """Return what report/summary.json holds; a value is None where its stage has not run.

    `weights` are those of the kind of photograph (gamma-coded or linear) that most are of;
    `weights_by_encoding` holds all. `tried` is what was measured against COLMAP's default grey.
    """
    by_encoding = records["fit"]["weights"] if "fit" in records else {}
    main = max(by_encoding.values(), key=lambda w: int(w["images"]), default=None)
    later = ("features", "matches", "sparse", "dense", "mesh")
    features, matches, sparse, dense, mesh = (records.get(stage, {}) for stage in later)
    models = sparse.get("models", [])
    model = models[0] if models else {}
    left_out = {name: why for r in records.values() for name, why in r.get("left_out", {}).items()}
    return {
        "images": records["captures"]["images"] + len(records["captures"]["left_out"]),
        "left_out": left_out,
        "registered_images": model.get("registered_images"),
        "unregistered": sparse.get("unregistered"),
        "models": [m["registered_images"] for m in models] or None,
        "method": options.fit.method,
        "weights": main["weights"] if main else None,
        "score": main["score"] if main else None,
        "tones": main["tones"] if main else None,
        "tried": records["fit"]["tried"].get(main["encoding"]) if main else None,
        "weights_by_encoding": {e: w["weights"] for e, w in by_encoding.items()},
        "cameras": features.get("cameras"),
        "with_focal_prior": features.get("with_focal_prior"),
        "features": features.get("features"),
        "matching": matches.get("strategy"),
        "pairs_verified": matches.get("pairs_verified"),
        "inlier_matches": matches.get("inliers"),
        "points3D": model.get("points3d"),
        "points_over_3_views": model.get("points_over_3_views"),
        "mean_track_length": model.get("mean_track_length"),
        "mean_reprojection_error_px": model.get("mean_reprojection_error_px"),
        "dense_points": dense.get("points"),
        "dense_backend": dense.get("backend"),
        "dense_pixels_with_depth_percent": _percent(dense.get("pixels_with_depth"), dense.get("pixels")),
        "mesh_faces": mesh.get("faces"),
        "mesh_texture": [mesh["texture"]["width"], mesh["texture"]["height"]] if "texture" in mesh else None,
        "stages": {name: record["seconds"] for name, record in records.items()},
        "page_seconds": None,
        "warnings": [text for record in records.values() for text in record["warnings"]],
    }


def summary_rows(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the summary as a person reads it: a name and a value a row, nothing for what has not run."""
    rows = [("photographs", _photographs(summary))]
    if summary["weights"] is not None:
        rows.append((f"grey ({summary['method']})", weights_in_words(summary["weights"])))
    if summary["tried"]:
        rows.append(("measured", summary["tried"]["in_words"]))
    if summary["registered_images"] is not None:
        over_3 = f"{summary['points_over_3_views']:,} seen in more than 3 images"
        rows += [
            ("registered images", f"{summary['registered_images']} of {summary['images']}"),
            ("points", f"{summary['points3D']:,}, {over_3}"),
            ("mean reprojection error", f"{summary['mean_reprojection_error_px']:.3f} px"),
            ("mean track length", f"{summary['mean_track_length']:.2f} observations a point"),
        ]
    if summary["dense_points"] is not None:
        coverage = summary["dense_pixels_with_depth_percent"]
        share = f", {coverage:.0f} % of the pixels have depth" if coverage is not None else ""
        cloud = f"{summary['dense_points']:,} points ({summary['dense_backend']}{share})"
        rows.append(("dense cloud", cloud))
    if summary["mesh_faces"] is not None:
        size = summary["mesh_texture"]
        look = f"a texture of {size[0]}x{size[1]}" if size else "vertex colours"
        rows.append(("mesh", f"{summary['mesh_faces']:,} triangles with {look}"))
    for name, value in summary.get("truth", {}).items():
        rows.append((f"truth: {name.replace('_', ' ')}", f"{value:.4g}"))
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


def _percent(part: int | None, whole: int | None) -> float | None:
    return 100 * part / whole if part is not None and whole else None
