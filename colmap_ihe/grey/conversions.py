"""List every conversion by the name it has for `--method`: what it does, and which properties it has.

The properties are the six that the paper of 2016 asks of a conversion. A name that has not got one has a test
that shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol, get_args

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

PROPERTIES: tuple[Property, ...] = get_args(Property)


class SetFit(Protocol):
    """Gather what a conversion has to know of a set; the order and grouping of photographs do not show."""

    def add(self, rgb: Float32) -> None: ...
    def __add__(self, other: Any) -> Any: ...
    def finish(self) -> tuple[float, ...]: ...


@dataclass(frozen=True, kw_only=True)
class Conversion:
    """Describe one name of `--method`.

    `convert`: (H, W, 3) float32 in [0, 1] to (H, W) float32 in [0, 1], for scopes `image` and `colour`.
    `new_fit` and `apply`, for scope `set`: an empty `SetFit`, and `apply(rgb, fit.finish())`. All are None
    where the conversion is a triplet of weights, fixed or of IHE. `local`: neighbours have a say in a
    pixel's grey.
    """

    name: str
    scope: Scope
    does: str
    properties: frozenset[Property]
    source: str
    local: bool = False
    convert: Callable[[Float32], Float32] | None = None
    new_fit: Callable[[], SetFit] | None = None
    apply: Callable[[Float32, Any], Float32] | None = None


_SEES: frozenset[Property] = frozenset({"feature discriminability", "chrominance awareness"})
_MAPS: frozenset[Property] = frozenset({"global mapping", "unsupervised"})
_UNSUPERVISED: frozenset[Property] = frozenset({"unsupervised"})
_KEEPS: frozenset[Property] = frozenset({"greyscale preservation"})
_CONSISTENT: frozenset[Property] = frozenset({"colour consistency"})
_FIXED = _MAPS | _KEEPS | _CONSISTENT

_TRIPLETS = {
    "rec709": ("luma of HDTV; COLMAP's default", "ITU-R BT.709-6, 3.2"),
    "rgb2gray": ("luma of standard definition; MATLAB's rgb2gray", "ITU-R BT.601; MATLAB, rgb2gray"),
    "photoshop": (".4 .4 .2, Photoshop's black and white", "the paper of 2016"),
    "mean": ("(R + G + B) / 3", "the paper of 2016"),
    "red": ("the red channel", "one channel"),
    "green": ("the green channel", "one channel"),
    "blue": ("the blue channel", "one channel"),
}

_ALL = [
    Conversion(
        name="ihe",
        scope="set",
        does="the weights whose grey histogram over the set is flattest",
        properties=_SEES | _FIXED,
        source="the paper of 2016",
    ),
    Conversion(
        name="auto",
        scope="set",
        does="the one of several candidates that matches best on a few pairs of the set",
        properties=_SEES | _FIXED,
        source="ours",
    ),
    Conversion(
        name="snr",
        scope="set",
        does="the weights whose detail stands out of their noise best",
        properties=_SEES | _FIXED,
        source="ours",
    ),
    *(
        Conversion(name=name, scope="colour", does=does, properties=_FIXED, source=source)
        for name, (does, source) in _TRIPLETS.items()
    ),
    Conversion(
        name="cie-y",
        scope="colour",
        does="the grey of the same luminance",
        properties=_FIXED,
        source="IEC 61966-2-1",
        convert=cie_y,
    ),
    Conversion(
        name="value",
        scope="colour",
        does="the greatest of R, G and B",
        properties=_FIXED,
        source="Smith, SIGGRAPH 1978",
        convert=value,
    ),
    Conversion(
        name="decolorize",
        scope="image",
        does="luminance, and the chrominance it shows least, stretched",
        properties=_SEES | _MAPS | _KEEPS,
        source="Grundland and Dodgson, Pattern Recognition 40, 2007",
        convert=decolorize,
    ),
    Conversion(
        name="decolorize-set",
        scope="set",
        does="decolorize with axis and quantiles of the whole set",
        properties=_SEES | _FIXED,
        source="Benedetti et al., VSMM 2012",
        new_fit=DecolorizeSet,
        apply=apply_decolorize,
    ),
    Conversion(
        name="realtime",
        scope="image",
        does="the one of 66 triplets that keeps contrasts of colour best",
        properties=_SEES | _MAPS | _KEEPS,
        source="Lu, Xu and Jia, SIGGRAPH Asia 2012",
        convert=realtime,
    ),
    Conversion(
        name="realtime-set",
        scope="set",
        does="realtime with the pairs of pixels of the whole set",
        properties=_SEES | _FIXED,
        source="Lu, Xu and Jia, SIGGRAPH Asia 2012; over a set, ours",
        new_fit=RealtimeSet,
        apply=weighed,
    ),
    Conversion(
        name="contrast-preserving",
        scope="image",
        does="a polynomial of the colour that keeps contrasts, stretched",
        properties=_SEES | _MAPS,
        source="Lu, Xu and Jia, ICCP 2012; cv2.decolor",
        convert=contrast_preserving,
    ),
    Conversion(
        name="song",
        scope="image",
        does="the one of 66 triplets that guides a bilateral filter most like colour",
        properties=_SEES | _MAPS | _KEEPS,
        source="Song et al., SIGGRAPH Asia 2013",
        convert=song,
    ),
    Conversion(
        name="color2gray",
        scope="image",
        does="differences of grey after signed differences of colour",
        properties=_SEES | (_MAPS - _UNSUPERVISED),
        source="Gooch et al., SIGGRAPH 2005",
        convert=color2gray,
    ),
    Conversion(
        name="apparent",
        scope="image",
        does="lightness as it appears, sharpened where colour has more contrast",
        properties=_SEES | _UNSUPERVISED,
        source="Smith et al., Eurographics 2008",
        local=True,
        convert=apparent,
    ),
]

CONVERSIONS: Mapping[str, Conversion] = {conversion.name: conversion for conversion in _ALL}
"""Every name of `--method`."""
