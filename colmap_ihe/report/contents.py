"""Hold what pages show, in plain values and arrays: `pipeline` and `evaluation` gather it, this package draws it.

Sections without contents are None or empty, and are not drawn. Names are the user's own and may hold anything: the
templates escape them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.report.survey_contents import SurveyBlock
from colmap_ihe.report.tables import Table


@dataclass(frozen=True)
class Picture:
    """Hold a coded picture. `alt` says in words what it shows."""

    jpeg: bytes
    width: int
    height: int
    alt: str


@dataclass(frozen=True)
class Cloud:
    """Hold points for the viewer, y up, the middle of the scene near the origin, in units of the model.

    `positions` (N, 3) float32; `colours` (N, 3) uint8 sRGB; `grey` (N,) uint8, the grey that the weights make of the
    colours. Points are shuffled, so that any first part of them is a thinner cloud. `kind`: "dense" or "sparse".
    """

    positions: NDArray[np.float32]
    colours: NDArray[np.uint8]
    grey: NDArray[np.uint8]
    kind: str
    points_in_all: int


@dataclass(frozen=True)
class Surface:
    """Hold a mesh for the viewer, in the frame of the cloud.

    `positions` and `normals` (V, 3) float32; `faces` (F, 3) int64, and `coarser`: fewer and fewer on the same vertices,
    which are drawn where there is no time for all. With a `texture`, `uv` (V, 2) float32 from its top
    left; without, `colours` (V, 3) uint8 sRGB. `faces_in_all`: of the mesh that it was cut from.
    """

    positions: NDArray[np.float32]
    normals: NDArray[np.float32]
    faces: NDArray[np.int64]
    coarser: Sequence[NDArray[np.int64]]
    faces_in_all: int
    texture: Picture | None = None
    uv: NDArray[np.float32] | None = None
    colours: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class ModelFrame:
    """Say how the viewer's frame lies in the model's: model = `rotation`.T @ viewer + `middle`, (3, 3) and (3,).

    `metric`: the model's unit is the metre. `grey_weights`: R, G, B of the set's grey."""

    rotation: NDArray[np.float64]
    middle: NDArray[np.float64]
    metric: bool = False
    grey_weights: tuple[float, float, float] = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True)
class CameraPose:
    """Place a registered photograph in the frame of the cloud: `centre` (3,), `corners` (4, 3) of its picture at a good
    depth, from the top left clockwise.

    `box` (4,): left, top, right, bottom of the part between the corners, in shares of the picture. `grid` (G, G, 2):
    where a lattice of its pixels lies, in steps of the edges from the top left corner to the right and down; None where
    the lens does not distort. `picture`: the photograph, larger than its thumbnail. `size`: width and height in pixels
    of the photograph as it is stored.
    """

    name: str
    centre: NDArray[np.float32]
    corners: NDArray[np.float32]
    box: NDArray[np.float64] | Sequence[float] = (0.0, 0.0, 1.0, 1.0)
    grid: NDArray[np.float64] | None = None
    picture: Picture | None = None
    size: tuple[int, int] = (1, 1)


@dataclass(frozen=True)
class PhotographEntry:
    """Describe one photograph of the set. `points` of the sparse model that it sees; `error_px` their mean reprojection
    error; `coverage` the share of its area that they lie in. `left_out`: why, if it is not in the model."""

    name: str
    thumbnail: Picture | None
    points: int = 0
    error_px: float | None = None
    coverage: float | None = None
    left_out: str = ""


@dataclass(frozen=True)
class Slider:
    """Show one photograph before and after, at one size. `difference`: chosen grey minus Rec.709, plus 127."""

    name: str
    colour: Picture
    chosen: Picture
    rec709: Picture
    difference: Picture


@dataclass(frozen=True)
class Pair:
    """Show two photographs side by side with their verified matches, in the chosen grey and in COLMAP's default, None
    where that is the chosen one."""

    first: str
    second: str
    chosen: Picture
    default: Picture | None = None


@dataclass(frozen=True)
class Grey:
    """Describe the chosen grey. `weights` R, G, B in 0..1; `tones` the histograms (256,) of the whole set in shares, in
    the chosen grey and in Rec.709, empty where that is the chosen one; `patchwork` of the set in colour and in grey."""

    method: str
    weights: tuple[float, float, float] | None
    in_words: str
    benefit: str
    tones_chosen: Sequence[float] = ()
    tones_rec709: Sequence[float] = ()
    patchwork_colour: Picture | None = None
    patchwork_grey: Picture | None = None


@dataclass(frozen=True)
class LostColour:
    """Tell what detail in colour the grey loses, in words, and show it in the photograph `name` that loses most, if
    there is anything to see: places that the chosen grey loses, those that COLMAP's default does, if that is another,
    and the grey with what the second adds to it, if there is one."""

    in_words: str
    name: str = ""
    by_chosen: Picture | None = None
    by_default: Picture | None = None
    with_second: Picture | None = None


@dataclass(frozen=True)
class FileLink:
    """Lead to a file: in words what it is, and its address, relative to the page."""

    words: str
    address: str


@dataclass(frozen=True)
class Drawing:
    """Show one drawing: its name, what is known of it, its pictures and its files."""

    name: str
    facts: Sequence[tuple[str, str]]
    pictures: Sequence[Picture]
    files: Sequence[FileLink]


@dataclass(frozen=True)
class MethodFigures:
    """Show one method of a comparison in pictures of the same photographs: the grey, its difference from Rec.709, the
    verified matches of a pair, and the dense cloud as one camera sees it."""

    method: str
    grey: Picture
    difference: Picture
    matches: Picture | None
    cloud: Picture | None


@dataclass(frozen=True)
class Comparison:
    """Hold the page of a comparison. `sentences` say what the tables say; `command` makes it again."""

    title: str
    sentences: Sequence[str]
    tables: Sequence[Table]
    figures: Sequence[MethodFigures]
    command: str
    citation: str


@dataclass(frozen=True)
class ProjectRow:
    """Describe one project of a batch. `kind` decides the look of its `state`, in words; `page` and `log`: addresses of
    its own page and of the log of its run, relative to the page of the batch, empty if there is none."""

    name: str
    kind: Literal["done", "failed", "running", "waiting"]
    state: str
    page: str
    thumbnail: Picture | None
    facts: Sequence[tuple[str, str]] = ()
    reason: str = ""
    hint: str = ""
    log: str = ""


@dataclass(frozen=True)
class BatchContents:
    """Hold the page of a batch. `again_s`: seconds after which it is loaded again, None when nothing changes any more;
    `command` resumes the batch."""

    title: str
    result: str
    rows: Sequence[ProjectRow]
    command: str
    written: str
    again_s: int | None = None
    warnings: Sequence[str] = ()


@dataclass(frozen=True)
class Contents:
    """Hold the page of a project. `rows`: the summary as a person reads it; `lenses`: the cameras of its summary, and
    what their calibration brought, in words; `points_by_images`: points by the number of images that see them;
    `matches` (n, n): verified inliers between photographs, in the order of `photographs`; `options` as YAML;
    `methods_sentence`: for a methods section, with the citation; `survey_line`: scale and accuracy in words, with the
    record of the `survey` where the model is metric; `block`: the model as a surveyor asks for it; `drawings` of the
    project; `point_names` of its control."""

    title: str
    result: str
    rows: Sequence[tuple[str, str]]
    grey: Grey | None
    photographs: Sequence[PhotographEntry]
    cloud: Cloud | None = None
    surface: Surface | None = None
    frame: ModelFrame | None = None
    cameras: Sequence[CameraPose] = ()
    lenses: Sequence[Mapping[str, Any]] = ()
    calibration: str = ""
    sliders: Sequence[Slider] = ()
    pairs: Sequence[Pair] = ()
    points_by_images: Mapping[int, int] = field(default_factory=dict)
    matches: NDArray[np.int64] | None = None
    warnings: Sequence[str] = ()
    seconds: Mapping[str, float] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    options: str = ""
    methods_sentence: str = ""
    citation: str = ""
    lost_colour: LostColour | None = None
    survey_line: str = ""
    survey: Mapping[str, Any] | None = None
    point_names: Sequence[str] = ()
    block: SurveyBlock | None = None
    drawings: Sequence[Drawing] = ()
