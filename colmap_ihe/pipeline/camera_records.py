"""Describe the cameras of a model for the record of `sparse`, and find which of them are one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, Strict, model_validator

from colmap_ihe.colmap.calibration.calibrate import Calibration
from colmap_ihe.colmap.measures import cameras_of_images, has_turned_sizes
from colmap_ihe.colmap.native import parameter_names, pycolmap
from colmap_ihe.photographs.camera_identity import identities_of_cameras, read_identities, turned_partners
from colmap_ihe.pipeline.stage import Count, StrictModel
from colmap_ihe.project.folder import Project

_By = Literal["calibration", "colmap", "given"]
_Pixels = Annotated[int, Field(ge=1, le=1_000_000)]


class ExifRecord(StrictModel):
    """Hold what EXIF says of a camera, empty or 0 where it does not. Focal lengths in mm."""

    make: str
    model: str
    focal_length_mm: float
    focal_length_35mm: float


class CameraRecord(StrictModel):
    """Describe a camera of the largest model: its parameters in COLMAP's order, by the names that COLMAP has for them,
    with their standard deviations, 0 for what was held, and pairs that are correlated so that one may stand for the
    other. `by`: what its parameters are from, "calibration", "colmap" or "given" and held; `exif` only where all of its
    photographs say the same. Raises ValueError for what is no camera of COLMAP's."""

    camera_id: Count
    model: str
    width: _Pixels
    height: _Pixels
    names: list[str]
    params: list[float]
    standard_deviations: list[float] | None
    correlated: list[Annotated[tuple[str, str, float], Strict(False)]]  # JSON has lists
    photographs: Count
    by: _By
    exif: ExifRecord | None = None

    @model_validator(mode="after")
    def _parameters_of_the_model(self) -> CameraRecord:
        models = pycolmap.CameraModelId.__members__
        if self.model not in models or self.model == "INVALID":
            raise ValueError(f"{self.model!r:.60} is no camera model of COLMAP's")
        camera = pycolmap.Camera.create_from_model_name(1, self.model, 1.0, self.width, self.height)
        numbers = (
            [self.params] if self.standard_deviations is None else [self.params, self.standard_deviations]
        )
        if self.names != parameter_names(camera) or any(len(each) != len(self.names) for each in numbers):
            raise ValueError(f"{self.model} has the parameters {camera.params_info}")
        return self


class HeldOutRecord(StrictModel):
    """Hold the median reprojection error of points held out, in pixels, and by how many standard errors the model
    chosen is better than COLMAP's."""

    colmap_px: float
    calibrated_px: float
    standard_errors: float


def camera_records(
    project: Project, found: Calibration | None, held: frozenset[int]
) -> tuple[list[CameraRecord], HeldOutRecord | None]:
    """Return the records of the cameras of a project's largest model, that of most photographs first, and of what
    calibrating them brought. `held`: the ids of those that the mapping held."""
    model = pycolmap.Reconstruction(project.sparse / "0")
    photographs = Counter(model.images[i].camera_id for i in model.reg_image_ids())
    exif = _exif_of_cameras(project, model)
    cameras = []
    for camera_id, count in sorted(photographs.items(), key=lambda item: (-item[1], item[0])):
        camera = model.cameras[camera_id]
        deviations = found.deviations.get(camera_id) if found else None
        by: _By = "calibration" if deviations else "given" if camera_id in held else "colmap"
        cameras.append(
            CameraRecord(
                camera_id=camera_id,
                model=camera.model_name,
                width=camera.width,
                height=camera.height,
                names=parameter_names(camera),
                params=[float(value) for value in camera.params],
                standard_deviations=list(deviations.values) if deviations else None,
                correlated=list(deviations.correlated) if deviations else [],
                photographs=count,
                by=by,
                exif=exif.get(camera_id),
            )
        )
    if found is None:
        return cameras, None
    gain = found.gain
    return cameras, HeldOutRecord(
        colmap_px=gain.colmap_px, calibrated_px=gain.chosen_px, standard_errors=gain.standard_errors
    )


def _exif_of_cameras(project: Project, model: pycolmap.Reconstruction) -> dict[int, ExifRecord]:
    camera_ids = {str(model.images[i].name): int(model.images[i].camera_id) for i in model.reg_image_ids()}
    identities = identities_of_cameras(camera_ids, read_identities(project.grey, camera_ids))
    return {
        camera_id: ExifRecord(
            make=identity.make,
            model=identity.model,
            focal_length_mm=identity.focal_mm,
            focal_length_35mm=identity.focal_35mm,
        )
        for camera_id, identity in identities.items()
    }


def turned_cameras(project: Project, grey_names: Sequence[str]) -> list[tuple[int, int]]:
    """Return the cameras, by pairs of ids, that are one whose pictures an editor turned."""
    if not has_turned_sizes(project.database):
        return []
    found = read_identities(project.grey, grey_names)
    return turned_partners(identities_of_cameras(cameras_of_images(project.database), found))
