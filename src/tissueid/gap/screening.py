"""Screening of candidates: alignment of their signatures with the residual of the baseline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.fitting import Differences, Fit, LinearRefit
from tissueid.gap.parameters import starts_of
from tissueid.twin.effect import Effect

FloatArray = NDArray[np.float64]


SECOND_START = 0.7
"""Least alignment of a second starting point of an effect, as a share of the first one's."""


@dataclass(frozen=True)
class Signature:
    """How far the change of the residuals by an effect at a starting point, after a refit of everything else, explains
    the residual of the baseline.

    ``alignment`` is the squared cosine between that residual and the closest combination of the effect and its
    derivatives by its parameters: the share that a linear effect would explain.
    """

    effect: str
    start: tuple[float, ...]
    alignment: float


class Screen:
    """Signatures on the residuals of a fit."""

    def __init__(self, baseline: Fit) -> None:
        self._baseline = baseline
        self._differences = Differences(baseline)
        self._refit = LinearRefit(baseline)
        self._left = self.surviving(baseline.residuals)
        self._size = float(self._left @ self._left)

    def signatures(self, effect: Effect, starts: Sequence[tuple[float, ...]] = ()) -> list[Signature]:
        """Return the signature of an effect at each of the starts and at the most visible point of its grid; at all its
        starting points without ``starts``."""
        declared = starts or starts_of(self._baseline.parameters.dataset, effect, self._baseline.predictions)
        found = []
        for start in dict.fromkeys((*declared, *self._most_visible_starts(effect))):
            added, slopes = self._differences.at(effect, start)
            span = self.surviving(np.column_stack([added, slopes]))
            sizes = np.linalg.norm(span, axis=0)
            span = span[:, sizes > 1e-9 * max(float(sizes.max()), 1e-300)]
            if not span.shape[1]:
                found.append(Signature(effect.name, start, 0.0))
                continue
            shares, *_ = np.linalg.lstsq(span / np.linalg.norm(span, axis=0), self._left, rcond=1e-6)
            surviving = (span / np.linalg.norm(span, axis=0)) @ shares
            along = float(surviving @ surviving) / self._size if self._size > 0.0 else 0.0
            found.append(Signature(effect.name, start, along))
        return found

    def _most_visible_starts(self, effect: Effect) -> list[tuple[float, ...]]:
        # The point of the grid at which the effect, at any size, is closest to the residual of the baseline, for each
        # combination of fixed parameters.
        kinds: dict[tuple[float, ...], list[tuple[float, ...]]] = {}
        for start in effect.scan:
            fixed = (value for item, value in zip(effect.parameters, start, strict=True) if item.fixed)
            kinds.setdefault(tuple(fixed), []).append(start)

        def seen(start: tuple[float, ...]) -> float:
            return cosine(self.surviving_change(effect, start), self._left)

        return [max(grid, key=seen) for grid in kinds.values()]

    def surviving_change(self, effect: Effect, start: Sequence[float]) -> FloatArray:
        """Return the change by an effect at a starting point that a refit cannot absorb, shape (residuals,)."""
        return self.surviving(self._differences.at(effect, start, slopes=False)[0])

    def surviving(self, values: FloatArray) -> FloatArray:
        """Return the part of a change of the residuals that a refit of everything else cannot absorb, shape
        (residuals,)."""
        return self._refit.surviving(values)


def cosine(one: FloatArray, other: FloatArray) -> float:
    """Return the absolute cosine between two signatures; 0 where one is zero."""
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return abs(float(one @ other)) / size if size > 0.0 else 0.0


def best_aligned(signatures: Sequence[Signature], most_starts: int = 2) -> list[Signature]:
    """Return the best aligned start of every effect and, up to ``most_starts``, those nearly as well aligned; best
    first."""
    found: dict[str, list[Signature]] = {}
    for item in sorted(signatures, key=lambda item: -item.alignment):
        of_effect = found.setdefault(item.effect, [])
        near_best = not of_effect or item.alignment >= SECOND_START * of_effect[0].alignment
        if near_best and len(of_effect) < most_starts:
            of_effect.append(item)
    return sorted((item for items in found.values() for item in items), key=lambda item: -item.alignment)
