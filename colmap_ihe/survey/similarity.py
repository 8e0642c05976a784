"""Find the similarity that takes points of a model to where they were surveyed, and the points that do not fit it.

Least median of squares over the similarities of three points each (Rousseeuw 1984), then weighted least squares of all
points that fit (Umeyama 1991, "Least-squares estimation of transformation parameters between two point patterns").
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from colmap_ihe.survey.observations import F64

FEWEST = 3
"""Points that determine a similarity."""
USUAL_LENGTH = 1.538
"""Median length of a vector of three normal values of deviation 1."""
_MOST_TRIPLES = 500
_TIMES = 4.0  # of what is usual, from which on a point does not fit
_IN_A_LINE = 0.02  # second extent of points over the first
_NOT_ALIKE = 0.05  # of the extent: with larger residuals the points are not those of the model


@dataclass(frozen=True)
class Similarity:
    """Hold `scale`, `rotation` (3, 3) and `translation` (3,): x becomes scale * rotation @ x + translation."""

    scale: float
    rotation: F64
    translation: F64

    def __call__(self, points: F64) -> F64:
        """Return points (N, 3) transformed."""
        return np.asarray(self.scale * (np.asarray(points) @ self.rotation.T) + self.translation)

    def matrix(self) -> F64:
        """Return (3, 4)."""
        return np.concatenate((self.scale * self.rotation, self.translation[:, None]), axis=1)


@dataclass(frozen=True)
class Fitted:
    """Hold a similarity, which of the N points fit it (N,), and the distances of all (N,) in metres; or in `failure`
    why there is none."""

    similarity: Similarity | None
    fits: npt.NDArray[np.bool_]
    distances: F64
    failure: str = ""


def fitted(model: F64, surveyed: F64, accuracy: F64, up: F64 | None = None, bent_m: float = 0.0) -> Fitted:
    """Return the similarity from points (N, 3) of a model to surveyed ones (N, 3), with standard deviations (N,).

    `up` (3,): the direction of the model that becomes z where points in a line leave that open; without it such points
    determine nothing. `bent_m`: by how much the model itself may be bent, which makes no point wrong.
    """
    count = len(model)
    none = Fitted(None, np.zeros(count, bool), np.full(count, np.nan))
    if count < FEWEST:
        return Fitted(*_values(none), f"{count} of at least {FEWEST} are there")
    if in_a_line(surveyed) and up is None:
        return Fitted(*_values(none), "they lie in a line, which leaves open how the model turns about it")
    held = up if in_a_line(surveyed) or in_a_line(model) else None
    limit = np.hypot(accuracy, bent_m)
    # Of few points three always agree by chance, so that others would look wrong: all are tried first.
    whole = similarity_of(model, surveyed, accuracy, held)
    best: Similarity | None = whole
    if _off(whole, model, surveyed, limit).max() > _TIMES:
        best = min(
            (
                similarity_of(model[t], surveyed[t], accuracy[t], held)
                for t in _triples(model, surveyed, held)
            ),
            key=lambda one: _middle(_off(one, model, surveyed, limit)),
            default=None,
        )
    if best is None:
        return Fitted(*_values(none), "every three of them lie in a line")
    fits = np.ones(count, bool)
    for _ in range(10):
        off = _off(best, model, surveyed, limit)
        now = off <= _TIMES * _usual(off)
        if now.sum() < FEWEST or (in_a_line(surveyed[now]) and held is None):
            return Fitted(*_values(none), "they do not agree with one another")
        best = similarity_of(model[now], surveyed[now], accuracy[now], held)
        if (now == fits).all():
            break
        fits = now
    distances = np.linalg.norm(best(model) - surveyed, axis=1)
    extent = float(np.linalg.norm(np.ptp(surveyed[fits], axis=0)))
    if fits.sum() <= count / 2 or np.sqrt(np.mean(distances[fits] ** 2)) > _NOT_ALIKE * extent:
        worst = ", ".join(f"{d:.2f} m" for d in np.sort(distances)[::-1][:3])
        return Fitted(*_values(none), f"they do not agree with the model: the best fit leaves {worst}")
    return Fitted(best, fits, distances)


def similarity_of(model: F64, surveyed: F64, accuracy: F64, up: F64 | None = None) -> Similarity:
    """Return the similarity of least squares, weighted by accuracy (N,); with `up`, a direction of the model, nearly as
    the photographs were held."""
    weights = accuracy**-2.0 / (accuracy**-2.0).sum()
    centre, target = weights @ model, weights @ surveyed
    here, there = model - centre, surveyed - target
    crossed = (there * weights[:, None]).T @ here
    if up is not None:
        size = float(np.sqrt((weights @ (here**2).sum(axis=1)) * (weights @ (there**2).sum(axis=1))))
        crossed = crossed + 1e-3 * size * np.outer((0.0, 0.0, 1.0), up / np.linalg.norm(up))
    left, _, right = np.linalg.svd(crossed)
    flip = np.diag((1.0, 1.0, np.sign(np.linalg.det(left @ right))))
    rotation = left @ flip @ right
    scale = float((weights[:, None] * there * (here @ rotation.T)).sum() / (weights @ (here**2).sum(axis=1)))
    return Similarity(scale, rotation, target - scale * rotation @ centre)


def in_a_line(points: F64) -> bool:
    """Tell whether points (N, 3) lie so nearly in a line that they leave open how to turn about it."""
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(extents) < 2 or bool(extents[1] <= _IN_A_LINE * max(extents[0], 1e-12))


def _values(empty: Fitted) -> tuple[None, npt.NDArray[np.bool_], F64]:
    return None, empty.fits, empty.distances


def _triples(model: F64, surveyed: F64, up: F64 | None) -> Iterator[npt.NDArray[np.intp]]:
    """Yield numbers (3,) of points that determine a similarity: all of few points, as many of many."""
    count = len(model)
    if count <= 15:
        every = (np.array(t, np.intp) for t in combinations(range(count), 3))
    else:
        draw = np.random.default_rng(0)
        every = (draw.choice(count, 3, replace=False) for _ in range(_MOST_TRIPLES))
    for triple in every:
        if up is not None or not (in_a_line(model[triple]) or in_a_line(surveyed[triple])):
            yield triple


def _off(similarity: Similarity, model: F64, surveyed: F64, accuracy: F64) -> F64:
    return np.asarray(np.linalg.norm(similarity(model) - surveyed, axis=1) / accuracy)


def _middle(off: F64) -> float:
    """Return the residual that more than half of the points stay below."""
    return float(np.sort(off)[max(FEWEST - 1, len(off) // 2)])


def _usual(off: F64) -> float:
    """Return the usual residual, in accuracies, robustly; at least 1."""
    few = 1 + 5 / max(1, len(off) - FEWEST)
    return max(1.0, few * _middle(off) / USUAL_LENGTH)
