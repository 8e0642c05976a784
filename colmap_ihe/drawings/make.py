"""Make the files of a drawing in a folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import simplejpeg

from colmap_ihe.dense.camera import UInt8
from colmap_ihe.dense.texture.mesh import Mesh
from colmap_ihe.drawings.colours import PaintedSurface, paint
from colmap_ihe.drawings.frames import PlaneFrame
from colmap_ihe.drawings.line_files import write_dxf, write_svg
from colmap_ihe.drawings.lines import Layer, bounds_of, length_of, lines_drawn, section
from colmap_ihe.drawings.overview import Overview, overview_of
from colmap_ihe.drawings.raster_files import Georeference, colour_file, files_of, relief_file
from colmap_ihe.drawings.relief import (
    contour_levels,
    contour_lines,
    deviation_colours,
    deviation_range,
    hillshade,
    legend_stops,
    outline,
    with_legend,
)
from colmap_ihe.drawings.sheet import SheetContent, SheetText, write_sheets
from colmap_ihe.drawings.surface import seen_surface
from colmap_ihe.drawings.view import Layout, Setting, View, layout_of
from colmap_ihe.errors import OptionError
from colmap_ihe.machine.files import write_bytes, write_json
from colmap_ihe.machine.progress import SILENT, Progress

ABOUT = "drawing.json"
"""The file of a drawing's folder that describes it, written last."""

_QUALITY, _PREVIEW_QUALITY = 92, 80
_PREVIEW, _PREVIEW_RELIEF, _PICTURE = (
    2000,
    1200,
    6000,
)  # pixels, the longer side of pictures of the page and others
_LIGHT = np.rint(np.linspace(0.35, 1, 256) * 255).astype(np.uint8)  # by the hillshade, over colours
_SMALLEST_PART = 100  # pixels: parts and holes with less area have no outline
_RED, _BLUE, _BLACK, _BROWN = (190, 30, 45), (40, 70, 150), (0, 0, 0), (140, 90, 40)


def draw_surface(
    folder: Path,
    view: View,
    mesh: Mesh,
    surface: PaintedSurface,
    setting: Setting,
    progress: Progress = SILENT,
) -> dict[str, Any]:
    """Write orthophoto, relief, maps, lines and sheets of a view, and return what drawing.json says of them. Raises
    `OptionError` for what cannot be drawn, `CapabilityError` where a library is missing, `Cancelled`."""
    layout = layout_of(view, mesh, setting, surface)
    overview = _draw_bands(folder, view, surface, layout, setting, progress)
    progress.start(1, "pictures and sheets")
    most = None if view.kind == "plan" else deviation_range(overview.out, _extent(layout))
    maps = _write_maps(folder, overview, most, setting)
    layers = _lines_of(overview, most, setting)
    files = [*files_of("orthophoto"), *files_of("relief"), *maps]
    if any(layer.lines for layer in layers):
        files += _write_lines(folder, view, [layer for layer in layers if layer.lines], setting)
    else:
        layers = []
    grid, counts = layout.grid, overview.counts
    pixels = grid.width * grid.height
    about: dict[str, Any] = {
        **_about(view, setting),
        "width": grid.width,
        "height": grid.height,
        "pixel_mm": 1000 * grid.pixel if setting.metric else None,
        "pixel": grid.pixel,
        "left": grid.left,
        "top": grid.top,
        "holes_percent": 100 * (1 - counts["seen"] / pixels),
        "without_photograph_percent": 100 * (counts["seen"] - counts["by_photograph"]) / pixels,
        "deviation_range": most,
    }
    papers = write_sheets(
        folder / "sheets.pdf",
        _pages(overview, layers, about, setting),
        (grid.left, grid.bottom, grid.right, grid.top),
        _sheet_text(view, setting, _notes(about, setting)),
    )
    about |= {"papers": papers, "files": [*files, "sheets.pdf"]}
    write_json(folder / ABOUT, about)
    progress.advance()
    return about


def _draw_bands(
    folder: Path,
    view: View,
    surface: PaintedSurface,
    layout: Layout,
    setting: Setting,
    progress: Progress,
) -> Overview:
    """Write orthophoto.tif and relief.tif band by band, and return the overview."""
    place = Georeference(layout.grid, setting.shift(view), setting.plan_crs if view.kind == "plan" else "")
    overview = overview_of(layout.grid)
    bands = list(layout.grid.bands())
    progress.start(len(bands), f"parts of {view.name}")
    with (
        colour_file(folder, "orthophoto", place) as write_colour,
        relief_file(folder, "relief", place) as write_relief,
    ):
        for row, part in bands:
            seen = seen_surface(layout.faces, part, layout.behind, layout.before)
            band = paint(surface, layout.faces, seen, view.frame, part)
            alpha = np.where(np.isnan(band.out), 0, 255).astype(np.uint8)
            write_colour(row, np.dstack((band.rgb, alpha)))
            write_relief(row, np.asarray(1000 * band.out, np.float32))
            overview.add(row, band)
            progress.advance()
    return overview


def _extent(layout: Layout) -> float:
    return max(layout.grid.width, layout.grid.height) * layout.grid.pixel


def _write_maps(folder: Path, overview: Overview, most: float | None, setting: Setting) -> list[str]:
    shade = hillshade(overview.out, overview.grid.pixel)
    _write_jpeg(folder / "hillshade.jpg", np.repeat(shade[..., None], 3, axis=2), _PICTURE)
    _write_jpeg(folder / "preview.jpg", overview.rgb, _PREVIEW, _PREVIEW_QUALITY)
    _write_jpeg(
        folder / "preview-relief.jpg",
        _relief_picture(overview, shade, most),
        _PREVIEW_RELIEF,
        _PREVIEW_QUALITY,
    )
    names = ["hillshade.jpg", "preview.jpg", "preview-relief.jpg"]
    if most is None:
        return names
    picture = _shrunk(deviation_colours(overview.out, most), _PICTURE)
    _write_jpeg(folder / "deviation.jpg", with_legend(picture, 1000 * most, setting.unit), 2 * _PICTURE)
    return [*names, "deviation.jpg"]


def _relief_picture(overview: Overview, shade: UInt8, most: float | None) -> UInt8:
    """Return deviations in colours, darker where the hillshade is."""
    light = np.repeat(_LIGHT[shade][..., None], 3, axis=2)
    if most is None:
        return light
    return np.asarray(cv2.multiply(deviation_colours(overview.out, most), light, scale=1 / 255), np.uint8)


def _write_jpeg(path: Path, rgb: UInt8, longest: int, quality: int = _QUALITY) -> None:
    write_bytes(path, _jpeg(_shrunk(rgb, longest), quality))


def _jpeg(rgb: UInt8, quality: int = _QUALITY) -> bytes:
    return bytes(
        simplejpeg.encode_jpeg(
            np.ascontiguousarray(rgb), quality=quality, colorspace="RGB", colorsubsampling="420"
        )
    )


def _shrunk(rgb: UInt8, longest: int) -> UInt8:
    scale = longest / max(rgb.shape[:2])
    if scale >= 1:
        return rgb
    size = max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)


def _lines_of(overview: Overview, most: float | None, setting: Setting) -> list[Layer]:
    smallest = _SMALLEST_PART * overview.grid.pixel**2
    levels = contour_levels(overview.out, most)
    contours = contour_lines(overview.out, overview.grid, levels)
    layers = [Layer("OUTLINE", outline(overview.covered, overview.grid, smallest), _BLACK, 0.35)]
    for level, lines in contours.items():
        colour = _BROWN if most is None else _RED if level > 0 else _BLUE
        name = f"CONTOUR_{1000 * level:+.4g}" + ("_MM" if setting.metric else "")
        layers.append(Layer(name.replace("+", "P").replace("-", "M"), lines, colour, 0.1))
    return layers


def _write_lines(folder: Path, view: View, layers: Sequence[Layer], setting: Setting) -> list[str]:
    shift = setting.shift(view)
    write_svg(folder / "lines.svg", layers, shift, view.scale if setting.metric else None, view.name)
    write_dxf(folder / "lines.dxf", layers, shift, metric=setting.metric)
    return ["lines.svg", "lines.dxf"]


def _pages(
    overview: Overview, layers: Sequence[Layer], about: Mapping[str, Any], setting: Setting
) -> list[SheetContent]:
    most = about["deviation_range"]
    pages = [SheetContent("orthophoto", jpeg=_jpeg(overview.rgb), grid=overview.grid)]
    if most is None:
        shade = np.repeat(hillshade(overview.out, overview.grid.pixel)[..., None], 3, axis=2)
        pages.append(SheetContent("relief and contour lines", layers, _jpeg(shade), overview.grid))
        return pages
    surface = "cylinder" if about["kind"] == "cylinder" else "plane"
    legend = [(1000 * value, colour) for value, colour in legend_stops(most)]
    picture = _jpeg(_relief_picture(overview, hillshade(overview.out, overview.grid.pixel), most))
    pages.append(
        SheetContent(f"deviation from the {surface}", layers, picture, overview.grid, legend, setting.unit)
    )
    return pages


def _about(view: View, setting: Setting) -> dict[str, Any]:
    frame = view.frame
    values = {name: np.asarray(value).tolist() for name, value in vars(frame).items()}
    return {
        "name": view.name,
        "kind": view.kind,
        "made_by": setting.made_by,
        "metric": setting.metric,
        "unit": "metre" if setting.metric else None,
        "scale": view.scale if setting.metric else None,
        "frame": values,
        "shift": list(setting.shift(view)),
        "crs": setting.plan_crs if view.kind == "plan" else "",
    }


def _notes(about: Mapping[str, Any], setting: Setting) -> list[str]:
    notes = [f"pixels of {about['pixel_mm']:g} mm"] if about["pixel_mm"] else []
    share = f"{about['holes_percent']:.1f} % of the rectangle shows no surface"
    if about["without_photograph_percent"] >= 0.05:
        share += f", {about['without_photograph_percent']:.1f} % has colours of the cloud"
    return [*notes, share, *_accuracy(setting)]


def _accuracy(setting: Setting) -> list[str]:
    return setting.accuracy.split("; ") if setting.accuracy and setting.metric else []


def _sheet_text(view: View, setting: Setting, notes: Sequence[str]) -> SheetText:
    scale = view.scale if setting.metric else None
    return SheetText(setting.title, view.name, notes, scale, setting.shift(view), setting.upwards(view))


def draw_section(
    folder: Path, view: View, mesh: Mesh, setting: Setting, progress: Progress = SILENT
) -> dict[str, Any]:
    """Write where a mesh meets a plane, as lines and sheets, and return what drawing.json says of it. Raises
    `OptionError` where it meets it nowhere, and as `draw_surface`."""
    assert isinstance(view.frame, PlaneFrame)
    progress.start(1, f"section {view.name}")
    lines = section(mesh, view.frame)
    if not lines:
        low, high = (mesh.vertices.min(axis=0) + setting.offset, mesh.vertices.max(axis=0) + setting.offset)
        reach = ", ".join(f"{n} {a:.2f} to {b:.2f}" for n, a, b in zip("xyz", low, high, strict=True))
        raise OptionError(
            f"section {view.name}: there is nothing on it, the mesh does not reach it",
            hint=f"the model reaches {reach}",
        )
    layers = [Layer("SECTION", lines, _BLACK, 0.35)]
    files = [*_write_lines(folder, view, layers, setting), "preview.jpg"]
    _write_jpeg(folder / "preview.jpg", lines_drawn(lines, _PREVIEW), _PREVIEW, _PREVIEW_QUALITY)
    left, bottom, right, top = bounds_of(lines)
    margin = 0.03 * max(right - left, top - bottom)
    bounds = (left - margin, bottom - margin, right + margin, top + margin)
    length = length_of(lines)
    notes = _accuracy(setting)
    text = _sheet_text(view, setting, notes)
    papers = write_sheets(folder / "sheets.pdf", [SheetContent("section", layers)], bounds, text)
    about = {
        **_about(view, setting),
        "left": left,
        "bottom": bottom,
        "right": right,
        "top": top,
        "length": length,
        "papers": papers,
        "files": [*files, "sheets.pdf"],
    }
    write_json(folder / ABOUT, about)
    progress.advance()
    return about
