"""Which candidates deserve a fit: how much of what the baseline leaves points along each one's surviving signature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.fitting import Fit, differences
from tissueid.gap.parameters import starts_of
from tissueid.twin.effect import Effect

FloatArray = NDArray[np.float64]


SECOND_START = 0.7
"""A second starting point of an effect is tried as well where it is aligned by this share of the first one's."""


@dataclass(frozen=True)
class Signature:
    """What an effect at one of its starting points would add to the residuals, after a refit of everything else.

    ``surviving``, shape (residuals,), is in noise deviations: that combination of the effect itself and of its
    derivatives by its parameters which comes nearest to what the baseline leaves. ``alignment`` is its squared cosine
    with that: the share that the effect could take away if it were linear.
    """

    effect: str
    start: tuple[float, ...]
    surviving: FloatArray
    alignment: float


class Screen:
    """Signatures against the residuals of a fit."""

    def __init__(self, baseline: Fit) -> None:
        self._baseline = baseline
        jacobian = baseline.jacobian
        norms = np.linalg.norm(jacobian, axis=0)
        self._basis, _ = np.linalg.qr(jacobian[:, norms > 0.0] / norms[norms > 0.0])
        self._left = self.surviving(baseline.residuals)
        self._size = float(self._left @ self._left)

    def signatures(self, effect: Effect) -> list[Signature]:
        """The signature of an effect at each starting point."""
        declared = starts_of(self._baseline.parameters.observed, effect, self._baseline.predictions)
        found = []
        for start in (*declared, *self._shows_best(effect)):
            added, slopes = differences(self._baseline, effect, start)
            span = self.surviving(np.column_stack([added, slopes]))
            sizes = np.linalg.norm(span, axis=0)
            span = span[:, sizes > 1e-9 * max(float(sizes.max()), 1e-300)]
            if not span.shape[1]:
                found.append(Signature(effect.name, start, np.zeros_like(self._left), 0.0))
                continue
            shares, *_ = np.linalg.lstsq(span / np.linalg.norm(span, axis=0), self._left, rcond=1e-6)
            surviving = (span / np.linalg.norm(span, axis=0)) @ shares
            along = float(surviving @ surviving) / self._size if self._size > 0.0 else 0.0
            found.append(Signature(effect.name, start, surviving, along))
        return found

    def _shows_best(self, effect: Effect) -> list[tuple[float, ...]]:
        # Where on its grid what the effect adds, whatever its size, comes nearest to what the baseline leaves.
        def seen(start: tuple[float, ...]) -> float:
            return cosine(self.surviving(differences(self._baseline, effect, start, slopes=False)[0]), self._left)

        return [max(effect.scan, key=seen)] if effect.scan else []

    def surviving(self, values: FloatArray) -> FloatArray:
        """What is left of a change of the residuals once everything else was refitted, shape (residuals,)."""
        return values - self._basis @ (self._basis.T @ values)


def cosine(one: FloatArray, other: FloatArray) -> float:
    """Cosine between two signatures without regard to sign; 0 where one of them has no size."""
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return abs(float(one @ other)) / size if size > 0.0 else 0.0


def contenders(signatures: Sequence[Signature]) -> list[Signature]:
    """The best aligned start of every effect and, where it is aligned nearly as well, the second; best first."""
    found: dict[str, list[Signature]] = {}
    for item in sorted(signatures, key=lambda item: -item.alignment):
        of_effect = found.setdefault(item.effect, [])
        if not of_effect or (len(of_effect) == 1 and item.alignment >= SECOND_START * of_effect[0].alignment):
            of_effect.append(item)
    return sorted((item for items in found.values() for item in items), key=lambda item: -item.alignment)
