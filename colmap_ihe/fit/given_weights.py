"""Compare weights of another campaign on new photographs with what a fit of these would give."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from colmap_ihe.fit.counting import SetCounts
from colmap_ihe.grey.ihe import clipped, fit_cells, flatness
from colmap_ihe.grey.weights import Weights, triplets
from colmap_ihe.project.options import FitOptions

LEAST_CONTRAST = LEAST_LEVELS = 0.95
MOST_CLIPPED, LEAST_RANGE = 0.01, 0.5


@dataclass(frozen=True)
class WeightsFit:
    """Hold shares of what weights fitted to the photographs give: `contrast` of detail over noise, None where none was
    measured, and `levels` of grey that are filled, with the white point of the photographs. Of linear ones also
    `clipped`, the share of pixels that the weights' white point makes white, and `range`, how much of the grey up to
    it is used."""

    contrast: float | None
    levels: float
    clipped: float = 0.0
    range: float = 1.0

    def as_dict(self) -> dict[str, float | None]:
        return asdict(self)


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
