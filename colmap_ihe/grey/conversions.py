"""List every conversion by the name it has for `--method`: what it does, and which properties it has.

The properties are the six that the paper of 2016 asks of a conversion. A name that has not got one has a test
that shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from colmap_ihe.grey.methods.apparent import apparent
from colmap_ihe.grey.methods.color2gray import color2gray
from colmap_ihe.grey.methods.contrast_preserving import contrast_preserving
from colmap_ihe.grey.methods.decolorize import DecolorizeSet, apply_decolorize, decolorize
from colmap_ihe.grey.methods.luminance import cie_y, value
from colmap_ihe.grey.methods.realtime import RealtimeSet, realtime, weighed
from colmap_ihe.grey.methods.song import song
from colmap_ihe.grey.srgb import Float32

Scope = Literal["set", "image", "colour"]
"""`colour`: a fixed function of the colour. `set`: fitted once to all photographs. `image`: fitted to each
photograph, so that the same colour is another grey in another photograph."""

Property = Literal[
    "feature discriminability",
    "chrominance awareness",
    "global mapping",
    "colour consistency",
    "greyscale preservation",
    "unsupervised",
]


class SetFit(Protocol):
    """Gather what a conversion has to know of a set; the order and grouping of photographs do not show."""

    def add(self, rgb: Float32) -> None: ...
    def __add__(self, other: Any) -> Any: ...
    def finish(self) -> tuple[float, ...]: ...


@dataclass(frozen=True)
class Conversion:
    """Describe one name of `--method`.

    `convert`: (H, W, 3) float32 in [0, 1] to (H, W) float32 in [0, 1], for scopes `image` and `colour`.
    `new_fit` and `apply`, for scope `set`: an empty `SetFit`, and `apply(rgb, fit.finish())`. All are None
    where the conversion is a triplet of weights, fixed or of IHE. `local`: neighbours have a say in a
    pixel's grey.
    """

    name: str
    scope: Scope
    properties: frozenset[Property]
    source: str
    does: str
    convert: Callable[[Float32], Float32] | None = None
    new_fit: Callable[[], SetFit] | None = None
    apply: Callable[[Float32, Any], Float32] | None = None
    local: bool = False


_SEES: frozenset[Property] = frozenset({"feature discriminability", "chrominance awareness"})
_MAPS: frozenset[Property] = frozenset({"global mapping", "unsupervised"})
_UNSUPERVISED: frozenset[Property] = frozenset({"unsupervised"})
_KEEPS: frozenset[Property] = frozenset({"greyscale preservation"})
_CONSISTENT: frozenset[Property] = frozenset({"colour consistency"})
_FIXED = _MAPS | _KEEPS | _CONSISTENT

_PAPER = "the paper of 2016"
_TRIPLETS = {
    "rec709": ("luma of HDTV; COLMAP's default", "ITU-R BT.709-6, 3.2"),
    "rgb2gray": ("luma of standard definition; MATLAB's rgb2gray", "ITU-R BT.601; MATLAB, rgb2gray"),
    "photoshop": (".4 .4 .2, Photoshop's black and white", _PAPER),
    "mean": ("(R + G + B) / 3", _PAPER),
    "red": ("the red channel", "one channel"),
    "green": ("the green channel", "one channel"),
    "blue": ("the blue channel", "one channel"),
}

_ALL = [
    Conversion("ihe", "set", _SEES | _FIXED, _PAPER,
               "the weights whose grey histogram over the set is flattest"),
    Conversion("auto", "set", _SEES | _FIXED, "ours",
               "the one of several candidates that matches best on a few pairs of the set"),
    Conversion("snr", "set", _SEES | _FIXED, "ours",
               "the weights whose detail stands out of their noise best"),
    *(Conversion(name, "colour", _FIXED, source, does) for name, (does, source) in _TRIPLETS.items()),
    Conversion("cie-y", "colour", _FIXED, "IEC 61966-2-1",
               "the grey of the same luminance", cie_y),
    Conversion("value", "colour", _FIXED, "Smith, SIGGRAPH 1978",
               "the greatest of R, G and B", value),
    Conversion("decolorize", "image", _SEES | _MAPS | _KEEPS, "Grundland and Dodgson, Pattern Recognition 40, 2007",
               "luminance, and the chrominance it shows least, stretched", decolorize),
    Conversion("decolorize-set", "set", _SEES | _FIXED, "Benedetti et al., VSMM 2012",
               "decolorize with axis and quantiles of the whole set", None, DecolorizeSet, apply_decolorize),
    Conversion("realtime", "image", _SEES | _MAPS | _KEEPS, "Lu, Xu and Jia, SIGGRAPH Asia 2012",
               "the one of 66 triplets that keeps contrasts of colour best", realtime),
    Conversion("realtime-set", "set", _SEES | _FIXED, "Lu, Xu and Jia, SIGGRAPH Asia 2012; over a set, ours",
               "realtime with the pairs of pixels of the whole set", None, RealtimeSet, weighed),
    Conversion("contrast-preserving", "image", _SEES | _MAPS, "Lu, Xu and Jia, ICCP 2012; cv2.decolor",
               "a polynomial of the colour that keeps contrasts, stretched", contrast_preserving),
    Conversion("song", "image", _SEES | _MAPS | _KEEPS, "Song et al., SIGGRAPH Asia 2013",
               "the one of 66 triplets that guides a bilateral filter most like colour", song),
    Conversion("color2gray", "image", _SEES | (_MAPS - _UNSUPERVISED), "Gooch et al., SIGGRAPH 2005",
               "differences of grey after signed differences of colour", color2gray),
    Conversion("apparent", "image", _SEES | _UNSUPERVISED, "Smith et al., Eurographics 2008",
               "lightness as it appears, sharpened where colour has more contrast", apparent, local=True),
]  # fmt: skip

CONVERSIONS: Mapping[str, Conversion] = {conversion.name: conversion for conversion in _ALL}
"""Every name of `--method`."""
