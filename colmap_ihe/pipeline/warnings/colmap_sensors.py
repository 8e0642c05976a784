"""Ask COLMAP's table of sensors in the only way there is: by an image with EXIF."""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache

import numpy as np

from colmap_ihe.colmap.native import pycolmap
from colmap_ihe.errors import CapabilityError
from colmap_ihe.machine.scratch import scratch_folder
from colmap_ihe.photographs.encode import encode_image
from colmap_ihe.photographs.exif.blocks import Tag, put_together, rational, text


@lru_cache(maxsize=1024)
def knows_sensor(make: str, model: str) -> bool:
    """Tell whether COLMAP knows how wide the sensor of this camera is, so that a focal length in mm is enough;
    true also without pycolmap, where nobody is to guess it."""
    exif = put_together(
        {Tag.MAKE: text(make), Tag.MODEL: text(model)}, {Tag.FOCAL_LENGTH: rational(10.0)}, {}
    )
    with scratch_folder() as folder:
        image = folder / "camera.png"
        image.write_bytes(encode_image(np.zeros((2, 2), np.uint8), exif, "png"))
        with suppress(CapabilityError):
            return bool(pycolmap.infer_camera_from_image(image).has_prior_focal_length)
        return True
