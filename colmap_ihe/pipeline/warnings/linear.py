"""Say what the owner of linear photographs should know: RAW of several cameras, and TIFFs that look linear."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from statistics import median

import numpy as np

from colmap_ihe.errors import PhotographError
from colmap_ihe.photographs.decode import encoding_of
from colmap_ihe.photographs.preview import small_picture
from colmap_ihe.photographs.survey import Surveyed

_LOOKED_AT, _SIDE = 6, 256  # photographs, and the pixels of their longer side
_BRIGHTEST = 99.5  # percentile of what is not clipped
_DARK = 0.3
"""Of the brightest value: half of the pixels of a gamma-coded photograph lie above 0.45 to 0.6 of it, of the same
photograph as linear above 0.2 to 0.33."""


def linear_warnings(surveyed: Sequence[Surveyed]) -> list[str]:
    """Warn of RAW of several cameras in one set, and of TIFFs that are read as gamma-coded and look linear."""
    return [*_raw_cameras(surveyed), *_linear_looking(surveyed)]


def _raw_cameras(surveyed: Sequence[Surveyed]) -> list[str]:
    """Warn of linear photographs by several models: each sensor has colours of its own, and one triplet weighs all."""
    models = Counter(
        f"{s.metadata.make} {s.metadata.model}".strip() or "an unknown camera"
        for s in surveyed
        if encoding_of(s.capture) == "linear"
    )
    if len(models) < 2:
        return []
    counts = ", ".join(f"{count} by {model}" for model, count in models.most_common())
    return [
        f"the RAW photographs are by different cameras ({counts}), whose sensors have colours of their own: the same"
        " colour is not the same grey in them; for one grey, convert all of them to TIFF in one colour space first"
    ]


def _linear_looking(surveyed: Sequence[Surveyed]) -> list[str]:
    """Warn of TIFFs by other programs that look linear: they are read as gamma-coded, and come out far too dark."""
    tiffs = [s for s in surveyed if s.capture.name.lower().endswith((".tif", ".tiff"))]
    tiffs = [s for s in tiffs if encoding_of(s.capture) == "coded"]
    named = [s for s in tiffs if "linear" in s.metadata.profile.lower()]
    plain = [s for s in tiffs if s.metadata.profile == "sRGB"]  # or they do not say
    what = f"a profile called {named[0].metadata.profile!r}" if named else ""
    if not named and plain and median(_darkness(plain)) < _DARK:
        named, what = plain, "half of their pixels far below the brightest ones"
    if not named:
        return []
    return [
        f"{len(named)} TIFF files look linear, as {named[0].capture.name}: they have {what}, and are read as"
        " gamma-coded. Export them in sRGB; or use the RAW files, or what `colmap-ihe develop` makes of them"
    ]


def _darkness(surveyed: Sequence[Surveyed]) -> list[float]:
    """Return the median of the brightest channel as a share of the brightest value, of some of the photographs; 1 for
    all that cannot be read."""
    step = max(1, len(surveyed) // _LOOKED_AT)
    shares = []
    for photograph in surveyed[::step][:_LOOKED_AT]:
        try:
            brightest = small_picture(photograph.capture, _SIDE).max(axis=2)
        except PhotographError:
            continue
        shares.append(float(np.median(brightest) / max(1.0, float(np.percentile(brightest, _BRIGHTEST)))))
    return shares or [1.0]
