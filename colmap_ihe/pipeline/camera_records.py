"""Describe the cameras of a model for the record of `sparse`, and find which of them are one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Literal

from pydantic import model_validator

from colmap_ihe.colmap.calibration.calibrate import Calibration
from colmap_ihe.colmap.measures import cameras_of_images, has_turned_sizes
from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.photographs.camera_identity import identities_of_cameras, read_identities, turned_partners
from colmap_ihe.pipeline.stage import Count, StrictModel
from colmap_ihe.project.folder import Project


class CameraRecord(StrictModel):
    """Describe a camera of the largest model: its parameters in COLMAP's order, by the names that COLMAP has for them,
    with their standard deviations, 0 for what was held, and pairs that are correlated so that one may stand for the
    other. `by`: what its parameters are from, "calibration", "colmap" or "given" and held."""

    camera_id: Count
    model: str
    width: Count
    height: Count
    names: list[str]
    params: list[float]
    standard_deviations: list[float] | None
    correlated: list[tuple[str, str, float]]
    photographs: Count
    by: Literal["calibration", "colmap", "given"]

    @model_validator(mode="after")
    def _one_number_a_name(self) -> CameraRecord:
        deviations = self.standard_deviations
        if len(self.params) != len(self.names) or len(deviations or self.names) != len(self.names):
            raise ValueError("expected a parameter and a standard deviation for each name")
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
    cameras = []
    for camera_id, count in sorted(photographs.items(), key=lambda item: (-item[1], item[0])):
        camera = model.cameras[camera_id]
        deviations = found.deviations.get(camera_id) if found else None
        by: Literal["calibration", "colmap", "given"]
        by = "calibration" if deviations else "given" if camera_id in held else "colmap"
        cameras.append(
            CameraRecord(
                camera_id=camera_id,
                model=camera.model_name,
                width=camera.width,
                height=camera.height,
                names=camera.params_info.replace(" ", "").split(","),
                params=[float(value) for value in camera.params],
                standard_deviations=list(deviations.values) if deviations else None,
                correlated=list(deviations.correlated) if deviations else [],
                photographs=count,
                by=by,
            )
        )
    if found is None:
        return cameras, None
    gain = found.gain
    return cameras, HeldOutRecord(
        colmap_px=gain.colmap_px, calibrated_px=gain.chosen_px, standard_errors=gain.standard_errors
    )


def turned_cameras(project: Project, grey_names: Sequence[str]) -> list[tuple[int, int]]:
    """Return the cameras, by pairs of ids, that are one whose pictures an editor turned."""
    if not has_turned_sizes(project.database):
        return []
    found = read_identities(project.grey, grey_names)
    return turned_partners(identities_of_cameras(cameras_of_images(project.database), found))
