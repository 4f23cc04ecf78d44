"""Which candidates deserve a fit: how much of what the baseline leaves points along each one's surviving signature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.fitting import Fit, differences
from tissueid.twin.effect import Effect

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Signature:
    """What an effect at one of its starting points would add to the residuals, after a refit of everything else.

    ``surviving``, shape (residuals,), is in noise deviations; ``alignment`` its squared cosine with what the baseline
    leaves: the share that it could take away if it were linear.
    """

    effect: str
    start: int
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
        """The signature of each starting point of an effect."""
        found = []
        for start in range(len(effect.starts)):
            added = differences(self._baseline, effect, start)
            surviving = self.surviving(added)
            size = float(surviving @ surviving)
            along = float(surviving @ self._left) ** 2 / (size * self._size) if size > 0.0 and self._size > 0.0 else 0.0
            found.append(Signature(effect.name, start, surviving, along))
        return found

    def surviving(self, values: FloatArray) -> FloatArray:
        return values - self._basis @ (self._basis.T @ values)


def cosine(one: FloatArray, other: FloatArray) -> float:
    """Cosine between two signatures without regard to sign; 0 where one of them has no size."""
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return abs(float(one @ other)) / size if size > 0.0 else 0.0


def best_starts(signatures: Sequence[Signature]) -> list[Signature]:
    """The best aligned start of every effect, best first."""
    best: dict[str, Signature] = {}
    for item in signatures:
        if item.effect not in best or item.alignment > best[item.effect].alignment:
            best[item.effect] = item
    return sorted(best.values(), key=lambda item: -item.alignment)
