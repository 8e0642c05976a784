"""Describe how one photograph is developed: plain values, to be noted, compared and sent to another process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

Demosaic = Literal["linear", "vng", "ppg", "ahd", "dcb", "dht", "aahd"]

FILES = ("bias", "dark", "flat", "bad_pixels")
"""The fields of a `Recipe` that name a file."""


@dataclass(frozen=True)
class Recipe:
    """Hold what happens to a photograph between its file and the fit. `Recipe()` is minimal development without
    calibration frames, and of a gamma-coded photograph nothing at all.

    `dark`, `flat` and `bad_pixels` are files of `calibration`, empty for none; `dark_scale` multiplies what a
    dark frame has above `bias`. `gains` multiply red, green and blue, linear of RAW and as coded of the others;
    `denoise` is the strength of the denoising in standard deviations of the noise, 0 for none. `white_balance`: the
    factors of red, green and blue for the colour twin, empty for those of the shot. `linear`: a TIFF that holds the
    linear colours of a sensor. `cache_folder`: a folder where the
    developed pixels are kept for the next reading; empty for none.
    """

    demosaic: Demosaic = "linear"
    green_equilibrium: bool = True
    bias: str = ""
    dark: str = ""
    dark_scale: float = 1.0
    flat: str = ""
    bad_pixels: str = ""
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    denoise: float = 0.0
    white_balance: tuple[float, ...] = ()
    linear: bool = False
    cache_folder: str = ""

    def identity(self) -> dict[str, Any]:
        """Return `as_dict`, files without the folder they lie in: their names tell their content. Without
        `cache_folder`, which changes nothing."""
        plain = {k: Path(v).name if k in FILES else v for k, v in self.as_dict().items()}
        plain.pop("cache_folder", None)
        return plain

    def unbalanced(self) -> Recipe:
        """Return the same without its white balance, on which no grey image depends."""
        return replace(self, white_balance=())

    def as_dict(self) -> dict[str, Any]:
        """Return what differs from `Recipe()`, as plain values; `recipe_from_dict` reads it back."""
        return {
            one.name: list(value) if isinstance(value, tuple) else value
            for one in fields(self)
            if (value := getattr(self, one.name)) != one.default
        }


def recipe_from_dict(values: Mapping[str, Any], folder: Path | None = None) -> Recipe:
    """Read a recipe back. `folder`: where the files of an `identity` lie. Raises ValueError for an unknown key."""
    unknown = set(values) - {f.name for f in fields(Recipe)}
    if unknown:
        raise ValueError(f"{sorted(unknown)}, expected fields of a Recipe")
    plain = dict(values)
    for name in {"gains", "white_balance"} & set(plain):
        red, green, blue = (float(v) for v in plain[name])
        plain[name] = (red, green, blue)
    if folder is not None:
        plain |= {name: str(folder / plain[name]) for name in FILES if name in plain}
    return Recipe(**plain)
