"""Read a project's folder `control/`, refuse what cannot be used before any work, and name photographs as COLMAP has
them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

from colmap_ihe.machine.words import listed
from colmap_ihe.pipeline.input_digests import digest_if_there
from colmap_ihe.project.folder import Project
from colmap_ihe.project.options import Options
from colmap_ihe.survey.control import CLICKED_PX, Control
from colmap_ihe.survey.control_files import control_files, read_control
from colmap_ihe.survey.frames import frame_of
from colmap_ihe.survey.observations import Observation
from colmap_ihe.survey.targets import DEFAULT_DICTIONARY, dictionary_of

_SHOWN = 4
_TARGET = re.compile(r"T\d+")


@dataclass(frozen=True)
class NamedControl:
    """Hold control with images named as in the model, the observations of its points, and sentences on what is there
    and cannot be used."""

    control: Control
    observations: Sequence[Observation]
    warnings: Sequence[str]


def given_control(project: Project, options: Options) -> Control:
    """Return what control/ holds, with the coordinate system of project.yaml, which goes over that of the files.
    Nothing without the folder, or where `survey.align` is none. Raises `ControlFileError` for what cannot be used, and
    `OptionError` for an unknown coordinate system or dictionary."""
    if options.survey.targets not in ("auto", "none"):
        dictionary_of(options.survey.targets)
    if options.survey.align == "none":
        return Control()
    control = read_control(project.control)
    control = replace(control, crs=options.survey.crs or control.crs)
    if control.coordinates():
        frame_of(control.crs, control.coordinates())
    return control


def control_digests(project: Project, options: Options) -> dict[str, str]:
    """Return the digest of each file of control/ that is read, by name; none where `survey.align` is none."""
    files = [] if options.survey.align == "none" else control_files(project.control)
    return {file.name: digest_if_there(file) for file in files}


def dictionary_for(control: Control, options: Options) -> str:
    """Return the dictionary whose targets are to be found, empty for none."""
    if options.survey.targets == "none":
        return ""
    if options.survey.targets != "auto":
        return options.survey.targets
    clicked = {sight.name for sight in control.sights}
    named = any(_TARGET.fullmatch(name) for name in control.names - clicked)
    return DEFAULT_DICTIONARY if named else ""


def named_control(
    control: Control, grey_of: Mapping[str, str], sizes: Mapping[str, tuple[int, int]]
) -> NamedControl:
    """Return control by the names of grey images. `grey_of`: these by the names of their photographs; `sizes` of the
    registered ones, width and height. Photographs may be named without their folder or ending where that is clear."""
    names = _Names(grey_of)
    warnings, observations, unknown, outside = [], [], set(), []
    for sight in control.sights:
        image = names.grey(sight.image)
        if image is None:
            unknown.add(sight.image)
            continue
        width, height = sizes.get(image, (0, 0))
        if image in sizes and not (0 <= sight.x_px <= width and 0 <= sight.y_px <= height):
            at = f" of {width} x {height} pixels"
            outside.append(f"{sight.file} line {sight.line}: {sight.name} is outside of {sight.image}{at}")
            continue
        observations.append(Observation(image, sight.name, sight.x_px, sight.y_px, CLICKED_PX))
    positions = []
    for position in control.positions:
        image = names.grey(position.image)
        if image is None:
            unknown.add(position.image)
        else:
            positions.append(replace(position, image=image))
    if unknown:
        warnings.append(
            f"control/ names {listed(sorted(unknown), _SHOWN)}, which no photograph of the set is called"
        )
    if outside:
        warnings.append(listed(outside, _SHOWN))
    strange = {o.name for o in observations} - control.names
    if strange:
        warnings.append(
            f"{listed(sorted(strange), _SHOWN)} of the observations are in no other file of control/: they are located,"
            " and take no part"
        )
    if control.unused:
        warnings.append(f"not used: {listed([f'control/{name}' for name in control.unused], _SHOWN)}")
    return NamedControl(replace(control, positions=positions), observations, warnings)


class _Names:
    """Find the grey image of a photograph, however much of its name is told."""

    def __init__(self, grey_of: Mapping[str, str]) -> None:
        self._found: dict[str, str | None] = {}
        for shorten in (str, _base, _stem):
            found: dict[str, str | None] = {}
            for name, grey in grey_of.items():
                key = shorten(name).casefold()
                found[key] = None if key in found else grey
            self._found = {**found, **self._found}

    def grey(self, name: str) -> str | None:
        """Return the grey image of a photograph, None where none or several are called so."""
        return self._found.get(name.replace("\\", "/").casefold())


def _base(name: str) -> str:
    return PurePosixPath(name).name


def _stem(name: str) -> str:
    return PurePosixPath(name).stem
