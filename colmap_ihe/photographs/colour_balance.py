"""Colour balance across the set: the mean colour of each photograph brought to that of the set."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from colmap_ihe.errors import PhotographError
from colmap_ihe.machine.executor import in_order
from colmap_ihe.machine.progress import Progress
from colmap_ihe.photographs.decode import encoding_of, read_photograph
from colmap_ihe.photographs.discover import Capture
from colmap_ihe.photographs.preview import small_picture

Gains = tuple[float, float, float]

_SIDE = 1024  # pixels of a picture that a mean is taken of
_CLIPPED = (0.002, 0.98)  # shares of the range outside which a value is taken for clipped
_TAILS = (5.0, 95.0)  # percentiles of brightness between which pixels count
_LEAST = 100  # pixels; with fewer nothing is known
_SAME: Gains = (1.0, 1.0, 1.0)


def balance_gains(captures: Sequence[Capture], executor: Executor, progress: Progress) -> dict[str, Gains]:
    """Return the factors of red, green and blue for each photograph, by name.

    The mean of each channel, over pixels that are not clipped and not among the darkest and brightest twentieth,
    is brought to the geometric mean of the set's; RAW and gamma-coded photographs are balanced each among themselves.

    - RAW: factors are linear, and level brightness too, for nothing else makes up for light that fades. None
      exceeds 1, so nothing clips; the common level does not matter, since the white point of the set is found later.
    - Coded: factors multiply coded values, and the three of a photograph have the geometric mean 1. They take a cast
      away and leave its brightness, which the camera has seen to: levelling that as well was seen to cost matches
      where photographs differ in what they show. Those above 1 clip highlights.

    They come on top of the gains that a capture's recipe has. Photographs that cannot be read, or with next to no
    pixel that is not clipped, get the level of the others and no colour.

    This is grey world over a set: it takes all photographs to see the same mix of surfaces, and puts down to the
    light whatever differs. Where the light did change (clouds, dusk, automatic white balance) the same surface
    comes nearer to the same grey. Where it did not, and one photograph shows more sky or more brick, the same
    surface becomes another grey in it: colour consistency is then lost, which is why this is off by default.
    """
    progress.start(len(captures))
    means: dict[str, NDArray[np.float64]] = {}
    results = in_order(executor, _mean_if_readable, captures, progress=progress)
    for capture, mean in zip(captures, results, strict=True):
        progress.advance()
        if mean is not None:
            means[capture.name] = mean
    gains = {capture.name: _SAME for capture in captures}
    for encoding in {encoding_of(c) for c in captures}:
        members = [c.name for c in captures if encoding_of(c) == encoding]
        measured = [name for name in members if name in means]
        if len(measured) < 2:
            continue
        logs = np.log([means[name] for name in measured])
        factors = np.exp(logs.mean(axis=0) - logs)
        if encoding == "coded":
            factors /= np.exp(np.log(factors).mean(axis=1, keepdims=True))
        common = 1 / float(factors.max()) if encoding == "linear" else 1.0
        gains |= dict.fromkeys(members, (common, common, common))
        for name, (red, green, blue) in zip(measured, (common * factors).tolist(), strict=True):
            gains[name] = (red, green, blue)
    return gains


def _mean_if_readable(capture: Capture) -> NDArray[np.float64] | None:
    with suppress(PhotographError):
        return _mean_colour(capture)
    return None


def _mean_colour(capture: Capture) -> NDArray[np.float64] | None:
    """Return the mean colour, (3,) in shares of the range; None where too little of the photograph is well exposed."""
    if encoding_of(capture) == "linear":
        plain = replace(capture, recipe=replace(capture.recipe, denoise=0.0))
        rgb = read_photograph(plain).rgb
        step = max(1, max(rgb.shape[:2]) // _SIDE)
        pixels = rgb[::step, ::step].reshape(-1, 3) / 65535
    else:
        pixels = small_picture(capture, _SIDE).reshape(-1, 3) / 255
    low, high = _CLIPPED
    pixels = pixels[((pixels > low) & (pixels < high)).all(axis=1)]
    if len(pixels) < _LEAST:
        return None
    brightness = pixels.sum(axis=1)
    darkest, brightest = np.percentile(brightness, _TAILS)
    mean = pixels[(brightness >= darkest) & (brightness <= brightest)].mean(axis=0)
    return np.asarray(mean, np.float64)
