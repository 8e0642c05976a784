"""Cameras of calibration files."""

from __future__ import annotations

from colmap_ihe.colmap.calibration_file import CalibratedCamera

PARAMS = [101.123456789, 102.1, 44.7, 33.3, -0.1, 1e-7, 1 / 3, -2e-5]


def calibrated(
    make: str = "Foo", model: str = "Bar", focal: float = 35, size: tuple[int, int] = (90, 66)
) -> CalibratedCamera:
    """A camera with `PARAMS`, by default that of `grey_noise.WHOLE`."""
    return CalibratedCamera(
        make=make, model=model, focal_length_mm=focal, width=size[0], height=size[1], camera_model="OPENCV",
        params=PARAMS, standard_deviations=None, photographs=5,
    )  # fmt: skip
