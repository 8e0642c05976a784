"""Draw the pages as one HTML file each, which works offline and loads nothing."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from colmap_ihe.report import cameras, charts, overlap, survey
from colmap_ihe.report.contents import BatchContents, Comparison, Contents
from colmap_ihe.report.embed import cloud_data, data_uri, scene_data, surface_data

_PACKAGE = "colmap_ihe.report"


def render_page(contents: Contents) -> str:
    """Return the page of a project. Sections that `contents` has nothing for are left out.

    Raises ValueError if the arrays of the cloud are not of one length.
    """
    cloud = contents.cloud if contents.cloud is not None and len(contents.cloud.positions) else None
    return _render(
        "page.html.j2",
        contents,
        [_asset("page.js"), *([_asset("viewer.js")] if cloud is not None else [])],
        cloud=cloud,
        cloud_data=cloud_data(cloud) if cloud is not None else None,
        surface_data=surface_data(contents.surface) if cloud is not None and contents.surface else None,
        scene_data=scene_data(contents.frame, contents.cameras) if cloud is not None else None,
        numbers={photograph.name: n for n, photograph in enumerate(contents.photographs, start=1)},
        registered=[p for p in contents.photographs if not p.left_out],
        left_out=[p for p in contents.photographs if p.left_out],
        partners=charts.partners(contents),
        cameras=cameras.cameras_table(contents.lenses),
        survey_tables=survey.survey_tables(contents.survey) if contents.survey else [],
        survey_plan=survey.survey_plan(contents.survey) if contents.survey else None,
    )


def render_comparison(comparison: Comparison) -> str:
    """Return the page of a comparison."""
    return _render("comparison.html.j2", comparison, [])


def render_batch(batch: BatchContents) -> str:
    """Return the page of a batch."""
    failed = [row for row in batch.rows if row.kind == "failed"]
    others = [row for row in batch.rows if row.kind != "failed"]
    return _render("batch.html.j2", batch, [], failed=failed, others=others)


def _render(template: str, contents: object, scripts: Sequence[str], **parts: object) -> str:
    """Return a page as HTML, to be written as UTF-8.

    Names may hold anything: all text is escaped, and a policy in the page lets only its own scripts run.
    """
    page = _environment().get_template(template)
    html = page.render(
        c=contents,
        scripts=[Markup(script) for script in scripts],
        style=Markup(_asset("page.css")),
        policy=_policy(scripts),
        **parts,
    )
    # A file name that is not UTF-8 reaches Python as lone surrogates, which no file can hold.
    return html.encode("utf-8", "backslashreplace").decode("utf-8")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader(_PACKAGE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = data_uri
    environment.filters["duration"] = charts.duration
    environment.globals.update(
        tones_chart=charts.tones_chart,
        tracks_chart=charts.tracks_chart,
        residuals_chart=charts.residuals_chart,
        map_drawing=overlap.map_drawing,
        plan_drawing=overlap.plan_drawing,
        match_picture=charts.match_picture,
        lens_charts=cameras.lens_charts,
    )
    return environment


@cache
def _asset(name: str) -> str:
    """Return the text of a file of this package, with the line ends that a parser of HTML gives it."""
    text = resources.files(_PACKAGE).joinpath(name).read_text(encoding="utf-8")
    return text.replace("\r\n", "\n")


def _policy(scripts: Sequence[str]) -> str:
    """Return the policy: the page may show embedded pictures, use its own style, run these scripts; load nothing."""
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    hashes = " ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests) or "'none'"
    return (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {hashes}; "
        "base-uri 'none'; form-action 'none'"
    )
