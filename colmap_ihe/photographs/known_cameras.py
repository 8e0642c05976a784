"""Known cameras, filled in where photographs do not say it, so that COLMAP finds it in their EXIF.

COLMAP 4.2 takes the focal length in pixels from the 35 mm equivalent, else from the focal length and the
focal-plane resolution, else from the focal length and a table of sensors by make and model; and one camera for
photographs of the same make, model, focal length and size (measured with pycolmap.infer_camera_from_image and
import_images, see tests/photographs/test_known_cameras.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from fnmatch import fnmatchcase

from colmap_ihe.photographs.exif import blocks
from colmap_ihe.photographs.exif.blocks import Tag, Tags
from colmap_ihe.photographs.exif.metadata import Metadata, describe
from colmap_ihe.project.options import CamerasOptions, KnownCamera

DIAGONAL_35MM = 43.27
"""Millimetres, COLMAP's number for 36 x 24 mm."""


def pattern_of(cameras: CamerasOptions, name: str) -> str | None:
    """Return the first pattern that a photograph's name fits, upper and lower case told apart; `*` also fits `/`, and
    a backslash stands for `/`."""
    fitting = (p for p in cameras.root if fnmatchcase(name, p) or fnmatchcase(name, p.replace("\\", "/")))
    return next(fitting, None)


def unused_patterns(cameras: CamerasOptions, names: Iterable[str]) -> list[str]:
    used = {pattern_of(cameras, name) for name in names}
    return [pattern for pattern in cameras.root if pattern not in used]


def focal_px(metadata: Metadata, width: int, height: int) -> float:
    """Return the focal length that EXIF gives for an image of this size, in pixels; 0 if only a table of sensors
    could."""
    if metadata.focal_35mm:
        return metadata.focal_35mm / DIAGONAL_35MM * math.hypot(width, height)
    return metadata.focal_mm * metadata.pixels_per_mm


def filled_in(metadata: Metadata, cameras: CamerasOptions, name: str, width: int, height: int) -> Metadata:
    """Return the metadata of a photograph of this size in pixels, with what is known of its camera; the same where no
    pattern fits its name. Make and model are named after the pattern where nothing says them, for without them COLMAP
    would give each photograph a camera of its own."""
    pattern = pattern_of(cameras, name)
    if pattern is None:
        return metadata
    known = cameras.root[pattern]
    filled = _without(metadata, known, width, height) if known.override else metadata
    filled = _with_focal_length(filled, known, width, height)
    make, model = filled.make or known.make or "", filled.model or known.model or ""
    if filled.focal_mm or filled.focal_35mm:
        make, model = make or "unknown", model or f"camera of {pattern}"
    filled = replace(filled, make=make, model=model)
    new_image, new_shot = _tags(filled, metadata)
    if not new_image and not new_shot:
        return metadata
    return describe(blocks.changed(metadata.exif, new_image, new_shot), metadata)


def _without(metadata: Metadata, known: KnownCamera, width: int, height: int) -> Metadata:
    """Return the metadata without what the known camera overrides. A new focal length alone leaves the sensor as it
    is."""
    focal, sensor = known.focal_length, known.sensor_width or known.focal_length_35mm
    plane = metadata.pixels_per_mm
    if metadata.focal_35mm and metadata.focal_mm and (focal or sensor):
        plane = focal_px(metadata, width, height) / metadata.focal_mm
    return replace(
        metadata,
        make="" if known.make else metadata.make,
        model="" if known.model else metadata.model,
        focal_mm=0.0 if focal else metadata.focal_mm,
        focal_35mm=0.0 if focal or sensor else metadata.focal_35mm,
        pixels_per_mm=0.0 if sensor else plane,
    )


def _with_focal_length(metadata: Metadata, known: KnownCamera, width: int, height: int) -> Metadata:
    metadata = replace(metadata, focal_mm=metadata.focal_mm or known.focal_length or 0.0)
    if focal_px(metadata, width, height):
        return metadata
    if known.sensor_width and metadata.focal_mm:
        return replace(metadata, pixels_per_mm=max(width, height) / known.sensor_width)
    if not known.focal_length_35mm:
        return metadata
    # Given with the focal length that it belongs to, it tells the sensor, and so what another length is worth.
    zoom = metadata.focal_mm / known.focal_length if known.focal_length else 1.0
    equivalent = known.focal_length_35mm * zoom
    if abs(equivalent - round(equivalent)) < 1e-6:
        return replace(metadata, focal_35mm=float(round(equivalent)))
    diagonal = math.hypot(width, height)
    return replace(metadata, pixels_per_mm=equivalent / DIAGONAL_35MM * diagonal / metadata.focal_mm)


def _tags(new: Metadata, old: Metadata) -> tuple[Tags, Tags]:
    """Return the tags of the image and of the shot that have to be written; None to take one out."""
    image: Tags = {}
    shot: Tags = {}
    for tag, now, before in ((Tag.MAKE, new.make, old.make), (Tag.MODEL, new.model, old.model)):
        if now != before:
            image[tag] = blocks.text(now)
    if new.focal_mm != old.focal_mm:
        shot[Tag.FOCAL_LENGTH] = blocks.rational(new.focal_mm)
    if new.focal_35mm != old.focal_35mm:
        shot[Tag.FOCAL_LENGTH_35MM] = round(new.focal_35mm) or None
    if new.pixels_per_mm != old.pixels_per_mm:
        gone: Tags = {Tag.PLANE_X: None, Tag.PLANE_Y: None, Tag.PLANE_UNIT: None}
        shot |= blocks.plane_tags(new.pixels_per_mm) if new.pixels_per_mm else gone
    return image, shot
