"""What a record has to hold for others to build on it: one that somebody wrote, or a disk spoilt, counts for none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from colmap_ihe.errors import WeightsError
from colmap_ihe.grey.weights import Encoding, grey_from_dict
from colmap_ihe.machine.files import is_name_below
from colmap_ihe.project.recipe import FILES, recipe_from_dict

_Count = Annotated[int, Field(ge=0, lt=2**63)]
_Seconds = Annotated[float, Field(ge=0, lt=1e12)]


def _below(name: str) -> str:
    """A file within a folder, by its path from there."""
    if not is_name_below(name):
        raise ValueError("is no file of the folder")
    return name


def _plain(name: str) -> str:
    if len(PurePosixPath(_below(name)).parts) != 1:
        raise ValueError("is no name of a file")
    return name


def _recipe(values: dict[str, Any]) -> dict[str, Any]:
    """As `Recipe.identity` writes it: its files are named without a folder, and it says not where pixels are kept."""
    recipe = recipe_from_dict(values)
    if recipe.cache_folder or not all(
        isinstance(v, str | bool | int | float | tuple) for v in vars(recipe).values()
    ):
        raise ValueError("is no recipe of a record")
    for name in FILES:
        if name in values:
            _plain(values[name])
    return values


def _grey(values: dict[str, Any]) -> dict[str, Any]:
    try:
        grey_from_dict(values)
    except WeightsError as error:
        raise ValueError(str(error)) from error
    return values


_Name = Annotated[str, AfterValidator(_below)]
_FileName = Annotated[str, AfterValidator(_plain)]
_Recipe = Annotated[dict[str, Any], AfterValidator(_recipe)]


class _Record(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)

    fingerprint: str
    seconds: _Seconds
    options: dict[str, Any]
    versions: dict[str, Any]
    warnings: list[str]
    left_out: dict[str, str] = {}


class _Captures(_Record):
    images: _Count
    pixels: _Count
    largest: _Count
    with_gps: _Count
    shared_by: _Count
    of_one_camera: _Count = 1
    recipes: dict[str, _Recipe]
    left_out: dict[str, str]


class _Weights(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)

    weights: list[float] | None
    score: float | None
    tones: int | None
    images: _Count
    encoding: Encoding


class _Tried(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)

    in_words: str
    pairs: list[Annotated[list[str], Field(min_length=2, max_length=2)]]


class _Fit(_Record):
    weights: Annotated[dict[Encoding, Annotated[dict[str, Any], AfterValidator(_grey)]], Field(min_length=1)]
    colour_white: Annotated[float, Field(gt=0, le=1)]
    tried: dict[str, dict[str, Any]]


class _Convert(_Record):
    grey: Annotated[dict[str, _Name], Field(min_length=1)]


class _Features(_Record):
    images: _Count
    cameras: _Count
    with_focal_prior: _Count
    features: _Count


class _Matches(_Record):
    strategy: str
    pairs_verified: _Count
    inliers: _Count


class _Model(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)

    registered_images: _Count
    points3d: _Count
    points_over_3_views: _Count
    mean_track_length: float
    mean_reprojection_error_px: float


class _Sparse(_Record):
    models: Annotated[list[_Model], Field(min_length=1)]
    unregistered: list[str]


class _Dense(_Record):
    points: _Count
    backend: str
    pixels: _Count
    pixels_with_depth: _Count


class _Texture(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)

    width: _Count
    height: _Count


class _Mesh(_Record):
    files: list[_FileName]
    faces: _Count | None = None
    texture: _Texture | None = None


_SHAPES: Mapping[str, type[_Record]] = {
    "captures": _Captures,
    "fit": _Fit,
    "convert": _Convert,
    "features": _Features,
    "matches": _Matches,
    "sparse": _Sparse,
    "dense": _Dense,
    "mesh": _Mesh,
}


def is_valid(stage: str, record: Mapping[str, Any]) -> bool:
    """Whether `record` is one that `stage` could have left, or of a stage that is not on the road."""
    shape = _SHAPES.get(stage)
    if shape is None:
        return True
    try:
        shape.model_validate(record)
        if stage == "fit":
            for encoding, values in record["weights"].items():
                if _Weights.model_validate(values).encoding != encoding:
                    return False
            for tried in record["tried"].values():
                _Tried.model_validate(tried)
    except (ValidationError, TypeError, RecursionError):
        return False
    return True
