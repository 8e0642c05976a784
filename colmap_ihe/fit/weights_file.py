"""Keep weights in files, for photographs that are to have the same grey, and compare weights of another campaign on new
photographs with what a fit of these would give."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from colmap_ihe.errors import WeightsError
from colmap_ihe.fit.counting import SetCounts
from colmap_ihe.grey.convert import to_grey
from colmap_ihe.grey.ihe import clipped, fit_cells, flatness
from colmap_ihe.grey.weights import Grey, Weights, grey_from_dict, triplets
from colmap_ihe.machine.files import write_bytes
from colmap_ihe.project.options import FitOptions
from colmap_ihe.project.safe_yaml import read_yaml

LEAST_CONTRAST = LEAST_LEVELS = 0.95
MOST_CLIPPED, LEAST_RANGE = 0.01, 0.5


def write_weights(file: Path, grey: Grey) -> None:
    text = yaml.safe_dump(grey.as_dict(), sort_keys=False, default_flow_style=None)
    write_bytes(file, text.encode())


def read_weights(file: Path) -> Grey:
    """Read a weights file, as `fit -o` writes it. Raises `WeightsError`."""
    hint = "write one with `colmap-ihe fit IMAGES -o weights.yaml`"
    try:
        values = read_yaml(file)
    except ValueError as error:
        raise WeightsError(f"{file}: cannot be read ({error})", hint=hint) from error
    if isinstance(values, dict) and values.get("weights") is None and "parameters" in values:
        return _read_formula(file, values)
    triplet = values.get("weights") if isinstance(values, dict) else None
    if not isinstance(triplet, list) or len(triplet) != 3 or {type(w) for w in triplet} - {int, float}:
        content = triplet if isinstance(values, dict) else values
        raise WeightsError(
            f"{file}: not a weights file, it holds {content!r:.60}; expected `weights: [r, g, b]`, three numbers",
            hint=hint,
        )
    try:
        return grey_from_dict(values, str(file))
    except WeightsError as error:
        if str(file) in str(error):
            raise
        raise WeightsError(f"{file}: {error}", hint=error.hint) from error


def _read_formula(file: Path, values: dict[str, Any]) -> Grey:
    """Read the conversion that is no triplet, tried on a few pixels."""
    grey = grey_from_dict(values, str(file))
    dark = np.zeros((8, 8, 3), np.uint8 if grey.encoding == "coded" else np.uint16)
    try:
        to_grey(dark, grey)
    except (ValueError, TypeError, KeyError, IndexError) as error:
        raise WeightsError(
            f"{file}: {grey.method!r} with {values['parameters']!r:.60} is no conversion of a set",
            hint="write one with `colmap-ihe fit IMAGES --method NAME -o weights.yaml`",
        ) from error
    return grey


@dataclass(frozen=True)
class WeightsFit:
    """Hold shares of what weights fitted to the photographs give: `contrast` of detail over noise, None where none was
    measured, and `levels` of grey that are filled, with the white point of the photographs. Of linear ones also
    `clipped`, the share of pixels that the weights' white point makes white, and `range`, the part of it in use."""

    contrast: float | None
    levels: float
    clipped: float = 0.0
    range: float = 1.0


def misfit(weights: Weights, gathered: SetCounts, options: FitOptions) -> WeightsFit:
    """Return what `weights` are worth on photographs that were counted, beside a fit of them by `options`."""
    grid, contrast, histogram = triplets(options.step), gathered.contrast, gathered.histogram
    fitted = fit_cells(histogram, contrast.admitted(grid) if options.guard == "noise" else grid)
    own, best = contrast.snr_of(100 * np.array([weights.triplet, fitted.triplet]))
    levels = flatness(histogram, weights.triplet) / flatness(histogram, fitted.triplet)
    share = float(own / best) if best > 0 else None
    if histogram.encoding == "coded":
        return WeightsFit(share, levels)
    return WeightsFit(share, levels, clipped(histogram, weights), fitted.white / weights.white)


def warnings_of(weights: Weights, gathered: SetCounts, options: FitOptions) -> list[str]:
    """Return what the owner of the photographs should know, nothing where the weights fit; see docs/campaigns.md."""
    fit = misfit(weights, gathered, options)
    words = []
    if fit.contrast is not None and fit.contrast < LEAST_CONTRAST:
        words.append(f"detail stands out of noise {fit.contrast:.0%} as far as in a grey fitted to them")
    if fit.levels < LEAST_LEVELS:
        words.append(f"the grey fills {fit.levels:.0%} of the levels that a fitted one does")
    if fit.clipped > MOST_CLIPPED:
        words.append(f"{fit.clipped:.1%} of the pixels are above the white point and become white")
    if fit.range < LEAST_RANGE:
        words.append(f"the brightest of them reach {fit.range:.0%} of the white point")
    if not words:
        return []
    return [
        f"the weights no longer fit these photographs: {'; '.join(words)}. For one grey with the other campaigns"
        " keep them, or fit all campaigns together; see docs/campaigns.md"
    ]
