"""The fit of real photographs against a plain loop over their pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import oracle
import pytest

from colmap_ihe.grey.ihe import fit_weights
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import discover


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "hundredths", "every"),
    [
        *((name, 5, 8) for name in ("sceaux", "fountain-p11", "sacre-coeur")),
        *(pytest.param(name, 1, 10, marks=pytest.mark.slow) for name in ("sceaux", "fountain-p11")),
    ],
)
def test_the_winner_among_231_and_among_all_5151(
    photographs: Path, name: str, hundredths: int, every: int
) -> None:
    captures = discover(photographs / name).captures[::4]
    images = [np.asarray(read_photograph(c).rgb[::every, ::every], np.uint8) for c in captures]
    best = oracle.fit(images, hundredths)
    fit = fit_weights(images, hundredths / 100, guard="none")
    assert tuple(round(100 * w) for w in fit.triplet) == best.triplet
    assert fit.score == pytest.approx(best.score, rel=1e-9)
    assert fit.tones == best.tones
