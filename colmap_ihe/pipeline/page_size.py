"""Keep the page of a project within the size that it may have, by what costs least to look at."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

from colmap_ihe.pipeline.surface_view import lighter
from colmap_ihe.report.contents import Cloud, Contents
from colmap_ihe.report.page import render_page

_MB = 1_000_000
_POINTS = 20_000  # the thinnest cloud


def page_within(contents: Contents, max_mb: float, warn: Callable[[str], None]) -> bytes:
    """Return the page as UTF-8, with as much of its contents as `max_mb` has room for: in the end without larger
    photographs, with a tenth of the points, and without the mesh. Warns where it is larger all the same."""
    page = b""
    for version in _versions(contents):
        page = render_page(version).encode()
        if len(page) <= max_mb * _MB:
            return page
    warn(
        f"the page has {len(page) / _MB:.1f} MB without its mesh too, more than report.max_mb, {max_mb:g}: "
        "its other pictures take that much"
    )
    return page


def _versions(contents: Contents) -> Iterator[Contents]:
    """Yield the contents, and then less and less of them."""
    yield contents
    cameras = [dataclasses.replace(camera, picture=None) for camera in contents.cameras]
    contents = dataclasses.replace(contents, cameras=cameras)
    yield contents
    surface, cloud = contents.surface, contents.cloud
    for share in (0.5, 0.25, 0.1):
        contents = dataclasses.replace(
            contents,
            surface=lighter(surface, share) if surface else None,
            cloud=_thinner(cloud, share) if cloud else None,
        )
        yield contents
    if surface:
        yield dataclasses.replace(contents, surface=None)


def _thinner(cloud: Cloud, share: float) -> Cloud:
    """Return the first points of a cloud, which are as good as any."""
    most = max(_POINTS, round(share * len(cloud.positions)))
    return dataclasses.replace(
        cloud, positions=cloud.positions[:most], colours=cloud.colours[:most], grey=cloud.grey[:most]
    )
