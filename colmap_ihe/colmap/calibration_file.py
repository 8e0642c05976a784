"""Keep the calibration of cameras in a file, from which the cameras of another campaign start."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import CalibrationFileError
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.photographs.camera_identity import CameraIdentity, Key
from colmap_ihe.project.safe_yaml import read_yaml, refuse_no_text

_HINT = "give a copy of report/calibration.yaml of a project that was reconstructed"
_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Millimetres = Annotated[float, Field(ge=0, le=100_000, allow_inf_nan=False)]
_Pixels = Annotated[int, Field(ge=1, le=1_000_000)]


class CalibratedCamera(BaseModel):
    """Hold one camera of a calibration file. Make, model and focal lengths as EXIF has them, empty or 0 where it does
    not; the size in pixels is that of its photographs as stored. `params` in COLMAP's order for `camera_model`, lengths
    in pixels, with their standard deviations in the same order, 0 for what was held and None where they are unknown.
    Raises ValueError for what is no camera."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    make: str
    model: str
    focal_length_mm: _Millimetres
    focal_length_35mm: _Millimetres = 0.0
    width: _Pixels
    height: _Pixels
    camera_model: str
    params: list[_Finite]
    standard_deviations: list[Annotated[float, Field(ge=0, allow_inf_nan=False)]] | None
    photographs: Annotated[int, Field(ge=0)]

    @model_validator(mode="after")
    def _numbers_of_the_model(self) -> CalibratedCamera:
        models = [m for m in pycolmap.CameraModelId.__members__ if m != "INVALID"]
        if self.camera_model not in models:
            raise ValueError(
                f"camera_model is {self.camera_model!r:.60}, expected one of {', '.join(models)}"
            )
        expected = pycolmap.Camera.create_from_model_name(1, self.camera_model, 1.0, 1, 1)
        for name in ("params", "standard_deviations"):
            numbers = getattr(self, name)
            if numbers is not None and len(numbers) != len(expected.params):
                raise ValueError(
                    f"{name} has {len(numbers)} numbers, {self.camera_model} has {len(expected.params)}"
                    f" ({expected.params_info})"
                )
        if any(self.params[index] <= 0 for index in expected.focal_length_idxs()):
            raise ValueError(f"params is {self.params}, expected a focal length above 0")
        return self

    @property
    def identity(self) -> CameraIdentity:
        """Return what EXIF and size say of the photographs that are by this camera."""
        return CameraIdentity(
            self.make, self.model, self.focal_length_mm, self.focal_length_35mm, self.width, self.height
        )


class _CalibrationFile(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    colmap_ihe_calibration: Literal[1]
    cameras: Annotated[list[CalibratedCamera], Field(min_length=1)]


def write_calibration(file: Path, cameras: Sequence[CalibratedCamera]) -> None:
    """Write a calibration file, whole or not at all. `read_calibration` reads the same numbers back."""
    values = {"colmap_ihe_calibration": 1, "cameras": [camera.model_dump() for camera in cameras]}
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None, allow_unicode=True, width=110)
    write_bytes(file, text.encode())


def cameras_of(
    model: pycolmap.Reconstruction,
    identities: Mapping[str, CameraIdentity],
    standard_deviations: Mapping[int, Sequence[float]],
) -> list[CalibratedCamera]:
    """Return the cameras of a model for `write_calibration`, in the order of their ids: one for each that took
    registered images, or several where these say different things of it. `identities` of the images by name, as
    `read_identities` gives them; `standard_deviations` of the parameters by camera id, of those that are known."""
    photographs: Counter[tuple[int, Key]] = Counter()
    by_key: dict[Key, CameraIdentity] = {}
    for image in sorted((model.images[i] for i in model.reg_image_ids()), key=lambda image: str(image.name)):
        if identity := identities.get(str(image.name)):
            photographs[image.camera_id, identity.key] += 1
            by_key.setdefault(identity.key, identity)
    return [
        _calibrated(model.cameras[camera_id], by_key[key], standard_deviations.get(camera_id), count)
        for (camera_id, key), count in sorted(photographs.items())
    ]


def _calibrated(
    camera: pycolmap.Camera,
    identity: CameraIdentity,
    standard_deviations: Sequence[float] | None,
    photographs: int,
) -> CalibratedCamera:
    return CalibratedCamera(
        make=identity.make,
        model=identity.model,
        focal_length_mm=identity.focal_mm,
        focal_length_35mm=identity.focal_35mm,
        width=camera.width,
        height=camera.height,
        camera_model=camera.model_name,
        params=[float(p) for p in camera.params],
        standard_deviations=None if standard_deviations is None else [float(s) for s in standard_deviations],
        photographs=photographs,
    )


def read_calibration(file: Path) -> list[CalibratedCamera]:
    """Return the cameras of a calibration file. Raises `CalibrationFileError`, also where two are for the same
    photographs."""
    try:
        values = read_yaml(file)
        refuse_no_text(values)
        cameras = _CalibrationFile.model_validate(values).cameras
    except ValidationError as error:
        raise CalibrationFileError(f"{file}: {_first_of(error)}", hint=_HINT) from error
    except (ValueError, RecursionError) as error:
        raise CalibrationFileError(f"{file}: cannot be read ({error})", hint=_HINT) from error
    _refuse_twins(file, cameras)
    return cameras


def in_words(identity: CameraIdentity) -> str:
    """Name a camera, as "Canon EOS 5D at 35 mm, 5616x3744"."""
    name = identity.model or identity.make
    if identity.make and not name.startswith(identity.make):
        name = f"{identity.make} {name}"
    focal = identity.focal_mm or identity.focal_35mm
    return f"{name or 'no make and model'}{f' at {focal:g} mm' if focal else ''}, {identity.width}x{identity.height}"


def _first_of(error: ValidationError) -> str:
    """Return the first fault in words, with the place of what is at fault and what came."""
    first = error.errors()[0]
    message = first["msg"].removeprefix("Value error, ")
    where = ".".join(str(part) for part in first["loc"])
    if not where:
        return f"not a calibration file, it holds {first['input']!r:.60}"
    came = f" is {first['input']!r:.60}" if first["type"] not in ("missing", "value_error") else ""
    return f"{where}{came}; {message[:1].lower()}{message[1:]}"


def _refuse_twins(file: Path, cameras: Sequence[CalibratedCamera]) -> None:
    numbers: defaultdict[Key, list[int]] = defaultdict(list)
    for number, camera in enumerate(cameras, start=1):
        numbers[camera.identity.key].append(number)
    for alike in numbers.values():
        if len(alike) > 1:
            raise CalibrationFileError(
                f"{file}: its cameras {alike[0]} and {alike[1]} are both for photographs by"
                f" {in_words(cameras[alike[0] - 1].identity)}, and nothing tells which one is meant",
                hint="keep one of them",
            )
