"""The fit of real photographs against a plain loop over their pixels."""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from numpy.typing import NDArray
from small_demo import PHOTOGRAPHS

from colmap_ihe.grey.ihe import fit_weights
from colmap_ihe.photographs.decode import read_photograph
from colmap_ihe.photographs.discover import discover

DATA = PHOTOGRAPHS
pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not DATA.is_dir(), reason=f"the photographs of {DATA.name} are not there"),
]


def some(name: str, step: int) -> list[NDArray[np.uint8]]:
    captures = discover(DATA / name).captures[::4]
    return [np.asarray(read_photograph(c).rgb[::step, ::step], np.uint8) for c in captures]


@pytest.mark.parametrize("name", ["sceaux", "fountain-p11", "sacre-coeur"])
def test_the_winner_among_231(name: str) -> None:
    images = some(name, 8)
    best = oracle.fit(images, 5)
    found = fit_weights(images, 0.05, guard="none")
    assert tuple(round(100 * w) for w in found.triplet) == best.triplet
    assert found.score == pytest.approx(best.score, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sceaux", "fountain-p11"])
def test_the_winner_among_all_5151(name: str) -> None:
    images = some(name, 10)
    best = oracle.fit(images, 1)
    found = fit_weights(images, guard="none")
    assert tuple(round(100 * w) for w in found.triplet) == best.triplet
    assert found.score == pytest.approx(best.score, rel=1e-9)
    assert found.tones == best.tones
