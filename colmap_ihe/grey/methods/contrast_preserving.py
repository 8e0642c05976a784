"""Convert by a polynomial of the colour, fitted to each photograph by OpenCV (contrast preserving decolorization).

Lu, Xu and Jia, "Contrast preserving decolorization", ICCP 2012, as `cv2.decolor` has it: a polynomial of
second degree in R, G and B, whose values are stretched over all tones.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from colmap_ihe.errors import CapabilityError, PhotographError
from colmap_ihe.grey.srgb import Float32, checked, rounded


def contrast_preserving(rgb: Float32) -> Float32:
    """Return the grey of one photograph, in 256 levels. The stretch is the photograph's own: greys are not kept.

    rgb: (H, W, 3) float32 in [0, 1], coded. Returns (H, W) float32 in [0, 1]. A photograph without any
    colour, for which OpenCV gives black, is returned as it is. Raises ValueError for another shape or
    dtype, `PhotographError` where OpenCV finds no grey (its answer is then black all over) and
    `CapabilityError` where this OpenCV has no `decolor`.
    """
    codes = rounded(checked(rgb))
    if not hasattr(cv2, "decolor"):
        raise CapabilityError(
            f"OpenCV {cv2.__version__} has no `decolor`, which contrast-preserving needs",
            hint="install opencv-python-headless, which has its photo module, or take `realtime`",
        )
    if (codes == codes[..., :1]).all():
        return np.ascontiguousarray(rgb[..., 0])
    # OpenCV's own order is blue, green, red; the red is not the first, as it is here.
    levels: Any = cv2.decolor(np.ascontiguousarray(codes[..., ::-1]))[0]
    if levels.min() == levels.max():
        raise PhotographError(
            "OpenCV's contrast preserving decolorization found no grey for it (all black)",
            hint="take another method, such as `realtime` of the same authors",
        )
    return np.asarray(levels, np.float32) / np.float32(255)
