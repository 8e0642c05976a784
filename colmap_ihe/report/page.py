"""One HTML file from the contents of a page: it works offline, and loads nothing."""

from __future__ import annotations

import base64
import hashlib
from functools import cache
from importlib import resources

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from colmap_ihe.report import charts
from colmap_ihe.report.contents import BatchContents, Comparison, Contents
from colmap_ihe.report.embed import cloud_data, data_uri

_ROOM = "colmap_ihe.report"


def render_page(contents: Contents) -> str:
    """The page as HTML, to be written as UTF-8. Sections that `contents` has nothing for are left out.

    Names may hold anything: all text is escaped, and a policy in the page lets only its own scripts run.
    Raises ValueError if the arrays of the cloud are not of one length.
    """
    cloud = contents.cloud if contents.cloud is not None and len(contents.cloud.positions) else None
    scripts = [_asset("page.js"), *([_asset("viewer.js")] if cloud is not None else [])]
    page = _environment().get_template("page.html.j2")
    html = page.render(
        c=contents,
        cloud=cloud,
        cloud_data=cloud_data(cloud, contents.cameras) if cloud is not None else None,
        numbers={photograph.name: n for n, photograph in enumerate(contents.photographs, start=1)},
        registered=[p for p in contents.photographs if not p.left_out],
        left_out=[p for p in contents.photographs if p.left_out],
        partners=charts.partners(contents),
        scripts=[Markup(script) for script in scripts],
        style=Markup(_asset("page.css")),
        policy=_policy(scripts),
    )
    # A file name that is not UTF-8 reaches Python as lone surrogates, which no file can hold.
    return html.encode("utf-8", "backslashreplace").decode("utf-8")


def render_comparison(comparison: Comparison) -> str:
    """The page of a comparison as HTML, to be written as UTF-8; likewise escaped. It needs no script."""
    page = _environment().get_template("comparison.html.j2")
    html = page.render(c=comparison, style=Markup(_asset("page.css")), policy=_policy([]))
    return html.encode("utf-8", "backslashreplace").decode("utf-8")


def render_batch(batch: BatchContents) -> str:
    """The page of a batch as HTML, to be written as UTF-8; likewise escaped. It needs no script."""
    page = _environment().get_template("batch.html.j2")
    html = page.render(
        c=batch,
        failed=[row for row in batch.rows if row.kind == "failed"],
        others=[row for row in batch.rows if row.kind != "failed"],
        style=Markup(_asset("page.css")),
        policy=_policy([]),
    )
    return html.encode("utf-8", "backslashreplace").decode("utf-8")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader(_ROOM),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = data_uri
    environment.filters["duration"] = charts.duration
    environment.globals.update(
        tones_chart=charts.tones_chart, tracks_chart=charts.tracks_chart, match_picture=charts.match_picture
    )
    return environment


@cache
def _asset(name: str) -> str:
    """The text of a file of this room, with the line ends that a parser of HTML gives it."""
    text = resources.files(_ROOM).joinpath(name).read_text(encoding="utf-8")
    return text.replace("\r\n", "\n")


def _policy(scripts: list[str]) -> str:
    """What the page may do: show embedded pictures, use its own style, run these scripts; load nothing."""
    digests = (hashlib.sha256(script.encode()).digest() for script in scripts)
    hashes = " ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in digests) or "'none'"
    return (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src {hashes}; "
        "base-uri 'none'; form-action 'none'"
    )
