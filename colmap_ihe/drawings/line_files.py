"""Write lines of drawings as SVG and DXF."""

from __future__ import annotations

from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from colmap_ihe.drawings.lines import Layer, bounds_of
from colmap_ihe.errors import CapabilityError
from colmap_ihe.machine.files import write_bytes

_METRES, _NO_UNIT = 6, 0  # of $INSUNITS
_MARGIN = 0.02  # of the larger side, about the lines of an SVG


def write_svg(
    path: Path, layers: Sequence[Layer], shift: tuple[float, float], scale: int | None, title: str
) -> None:
    """Write layers as groups. Coordinates are those of the drawing plus `shift`, in metres; y is minus up, since it
    goes down in SVG. It prints at 1:`scale`; with None, of a model that is not metric, at 200 mm."""
    left, bottom, right, top = bounds_of([line for layer in layers for line in layer.lines])
    margin = _MARGIN * max(right - left, top - bottom, 1e-9)
    width, height = right - left + 2 * margin, top - bottom + 2 * margin
    a_unit = 1000 / scale if scale else 200 / max(width, height)
    x, y = left + shift[0] - margin, -(top + shift[1]) - margin
    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width * a_unit:.3f}mm" height="{height * a_unit:.3f}mm"'
        f' viewBox="{x:.5f} {y:.5f} {width:.5f} {height:.5f}">',
        f"<title>{escape(title)}</title>",
    ]
    for layer in layers:
        red, green, blue = layer.colour
        parts.append(
            f'<g id={quoteattr(layer.name)} fill="none" stroke="rgb({red},{green},{blue})"'
            f' stroke-width="{layer.width_mm / a_unit:.6f}" stroke-linejoin="round">'
        )
        for line in layer.lines:
            points = " ".join(f"{u + shift[0]:.4f},{-(v + shift[1]):.4f}" for u, v in line.points.tolist())
            name = "polygon" if line.closed else "polyline"
            parts.append(f'<{name} points="{points}"/>')
        parts.append("</g>")
    parts.append("</svg>\n")
    write_bytes(path, "\n".join(parts).encode())


def write_dxf(path: Path, layers: Sequence[Layer], shift: tuple[float, float], *, metric: bool) -> None:
    """Write layers as polylines on layers of the same names, in metres if the model is `metric`. Raises
    `CapabilityError` without ezdxf."""
    try:
        import ezdxf
    except ImportError as error:
        raise CapabilityError(
            "DXF files need the package ezdxf, which is not installed",
            hint="pip install 'colmap-ihe[survey]'",
        ) from error
    document = ezdxf.new("R2010", units=_METRES if metric else _NO_UNIT)  # type: ignore[attr-defined]
    space = document.modelspace()
    for layer in layers:
        added = document.layers.add(layer.name)
        added.rgb = layer.colour
        for line in layer.lines:
            points = (line.points + np.array(shift)).tolist()
            space.add_lwpolyline(points, close=line.closed, dxfattribs={"layer": layer.name})
    text = StringIO()
    document.write(text)
    write_bytes(path, text.getvalue().encode(document.output_encoding, "dxfreplace"))
