"""Describe a triplet of grey weights, the conversions that are nothing but a triplet, and the rules by which the
compiled loops give a colour its grey level, exactly, though they compute in float32."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import WeightsError

Encoding = Literal["coded", "linear"]
"""`coded`: gamma-coded values as stored in a JPEG. `linear`: sensor values after black subtraction."""

Triplet = tuple[int, int, int]
"""Weights of red, green and blue in hundredths."""

Curve = tuple[int, ...]
"""Where the levels of an equalised grey begin, see `Weights`."""

Rules = NDArray[np.float32]
"""(m, 6): red, green, blue, fine, scale, offset; the level of a colour is `floor(floor(fine (red R + green G +
blue B)) scale + offset)`, at most 255. See `parts_rule` and `linear_rules`."""

LEVELS, DEPTH = 256, 65536
_FINE = 4

FIXED: Mapping[str, tuple[float, float, float]] = {
    "rec709": (0.2126, 0.7152, 0.0722),
    "rgb2gray": (0.2989, 0.5870, 0.1140),
    "photoshop": (0.4, 0.4, 0.2),
    "mean": (1 / 3, 1 / 3, 1 / 3),
    "red": (1.0, 0.0, 0.0),
    "green": (0.0, 1.0, 0.0),
    "blue": (0.0, 0.0, 1.0),
}
"""Conversions with fixed weights, by the name they have on the command line."""

_DIFFERENT = 0.01  # a step of the fit

_HINT = "write one with `colmap-ihe fit IMAGES -o weights.yaml`"
_COMMON = ("images", "pixels", "encoding", "white")
_SUM_TOLERANCE = 2e-3  # MATLAB's rgb2gray is published as .2989 .5870 .1140, which is .9999


def are_alike(triplet: Sequence[float], other: Sequence[float]) -> bool:
    """Tell whether two triplets of weights are the same within a step of the fit."""
    return max(abs(w - o) for w, o in zip(triplet, other, strict=True)) < _DIFFERENT


def is_rec709(triplet: Sequence[float]) -> bool:
    """Tell whether weights of red, green and blue are those of COLMAP's default, within a step of the fit."""
    return are_alike(triplet, FIXED["rec709"])


@dataclass(frozen=True)
class Weights:
    """Hold the weights of grey = red R + green G + blue B, one triplet for a whole set of photographs.

    `score` is the IHE criterion S (smaller is flatter), `tones` the number of occupied grey levels of
    256; both are None where nothing was fitted. For `linear` input `white` is the set's white point of
    this grey as a share of sensor saturation, in (0, 1]; grey is scaled by it before it is coded.
    `images` and `pixels` say what the fit has seen; `contrast`, where it was measured, how far detail stands out
    of noise, as a share of what the best triplet gives. `curve`, of `linear` input only: the least 16-bit grey of
    each of the levels 1 to 255 where the grey of the set is equalised, 65536 for a level that none has; empty
    where it was not fitted. Raises `WeightsError` unless the three weights are finite, not negative and sum to 1.
    """

    red: float
    green: float
    blue: float
    method: str = "ihe"
    encoding: Encoding = "coded"
    score: float | None = None
    tones: int | None = None
    white: float = 1.0
    images: int = 0
    pixels: int = 0
    contrast: float | None = None
    curve: Curve = ()

    def __post_init__(self) -> None:
        triplet = self.triplet
        if not all(math.isfinite(w) and 0 <= w <= 1 for w in triplet) or (
            abs(sum(triplet) - 1) > _SUM_TOLERANCE
        ):
            raise WeightsError(
                f"weights {triplet} sum to {sum(triplet):g}; expected three numbers in 0..1 that sum to 1",
                hint="correct the weights file, or fit it again with `colmap-ihe fit`",
            )
        _check_encoding(self.encoding, self.white)
        if self.curve:
            _check_curve(self.encoding, self.curve)

    @property
    def triplet(self) -> tuple[float, float, float]:
        return (self.red, self.green, self.blue)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON and YAML; `grey_from_dict` reads them back."""
        fields = {name: getattr(self, name) for name in ("score", "tones", "contrast", *_COMMON)}
        curve = {"curve": list(self.curve)} if self.curve else {}
        return {"method": self.method, "weights": list(self.triplet), **fields, **curve}


@dataclass(frozen=True)
class Formula:
    """Describe a conversion that is no triplet: `method` names it in `conversions.CONVERSIONS`, `parameters` are what
    it found of the set, if anything. The other fields as in `Weights`."""

    method: str
    parameters: tuple[float, ...] = ()
    encoding: Encoding = "coded"
    white: float = 1.0
    images: int = 0
    pixels: int = 0

    def __post_init__(self) -> None:
        _check_encoding(self.encoding, self.white)
        if not all(math.isfinite(v) for v in self.parameters):
            raise WeightsError(
                f"parameters {self.parameters} of {self.method!r}; expected finite numbers", hint=_HINT
            )

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON and YAML, with the keys of `Weights.as_dict`; `grey_from_dict` reads them."""
        values = {"method": self.method, "weights": None, "parameters": list(self.parameters)}
        return {**values, "score": None, "tones": None, **{name: getattr(self, name) for name in _COMMON}}


def _check_encoding(encoding: str, white: float) -> None:
    if encoding not in ("coded", "linear") or not 0 < white <= 1:
        raise WeightsError(
            f"encoding {encoding!r} with white {white}; expected 'coded' or 'linear' and 0 < white <= 1",
            hint="fit the weights file again with `colmap-ihe fit`",
        )


def _check_curve(encoding: str, curve: Curve) -> None:
    whole = all(type(v) is int and 0 <= v <= DEPTH for v in curve)
    rises = whole and all(a <= b for a, b in pairwise(curve))
    if encoding != "linear" or len(curve) != LEVELS - 1 or not rises:
        raise WeightsError(
            f"a curve of {len(curve)} values for {encoding} photographs; expected {LEVELS - 1} whole numbers in"
            f" 0..{DEPTH} that do not fall, for linear ones",
            hint="fit the weights file again with `colmap-ihe fit`",
        )


Grey = Weights | Formula
"""How the grey of a set is made."""


def grey_from_dict(values: Any, source: str = "weights") -> Grey:
    """Read what `as_dict` wrote. Raises `WeightsError`, naming `source`, for what it could not have written."""
    try:
        common: dict[str, Any] = {
            "encoding": values.get("encoding", "coded"),
            "white": float(values.get("white", 1.0)),
            "images": int(values.get("images", 0)),
            "pixels": int(values.get("pixels", 0)),
        }
        if values["weights"] is None:
            parameters = tuple(float(v) for v in values["parameters"])
            return Formula(method=str(values["method"]), parameters=parameters, **common)
        red, green, blue = (float(w) for w in values["weights"])
        for name, kind in (("score", float), ("tones", int), ("contrast", float)):
            common[name] = None if values.get(name) is None else kind(values[name])
        curve = tuple(values.get("curve") or ())
        return Weights(red, green, blue, str(values.get("method", "file")), curve=curve, **common)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise WeightsError(
            f"{source}: not a weights file ({error}); expected `weights: [r, g, b]`", hint=_HINT
        ) from error


def shares(triplet: Triplet) -> tuple[float, float, float]:
    """Return weights in hundredths as shares of one."""
    red, green, blue = triplet
    return red / 100, green / 100, blue / 100


def triplets(step: float = 0.01) -> list[tuple[int, int, int]]:
    """Return all weights (i, j, k) in hundredths with i + j + k = 100 on a grid of `step`, lexicographic.

    5,151 of them for step 0.01 and 66 for 0.1. Raises `WeightsError` if 1 is not a multiple of `step`
    or `step` is not a multiple of 0.01.
    """
    hundredths = round(step * 100) if math.isfinite(step) else 0
    if hundredths < 1 or 100 % hundredths or abs(hundredths / 100 - step) > 1e-9:
        raise WeightsError(f"{step=}, expected 0.01, 0.02, 0.04, 0.05, 0.1, 0.2, 0.25, 0.5 or 1")
    grid = range(0, 101, hundredths)
    return [(i, j, 100 - i - j) for i in grid for j in grid if i + j <= 100]


def parts_rule(numerators: NDArray[np.float64], parts: int) -> Rules | None:
    """Return the nearest level, halves up, of weights that are whole numbers of `parts`; None if they are not whole."""
    whole = np.rint(numerators)
    if np.abs(numerators - whole).max() > 1e-6:
        return None
    offset = 0.5 + (0.5 / parts if parts % 2 == 0 else 0)  # 0.5 / parts from every integer at least
    return np.array([[*whole, 1, 1 / parts, offset]], np.float32)


def linear_rules(triplets: Sequence[Triplet], whites: Sequence[int]) -> Rules:
    """Return levels of linear values: `(i R + j G + k B) * 256 // white`, exactly. `whites` are multiples of 1024."""
    step = np.asarray(whites, np.float64) / LEVELS / _FINE
    if (step % 1 != 0).any() or (step < 1).any():
        raise ValueError(f"{whites=}, expected multiples of {LEVELS * _FINE}")
    rules = np.empty((len(triplets), 6), np.float32)
    rules[:, :3] = triplets
    rules[:, 3] = 1 / _FINE
    rules[:, 4] = 1 / step
    rules[:, 5] = 0.5 / step  # 0.00008 from every integer at least, and float32 errs by 0.00003
    return rules
