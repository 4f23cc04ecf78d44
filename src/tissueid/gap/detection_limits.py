"""Detection limits: the size from which an effect would have been named in a session.

The signature of an effect of growing size is simulated at the best fit, without the part that a refit absorbs. Its
limit is the size at which this error raises the score as much as a decision needs (see ``decision.Thresholds``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.gap.decision import THRESHOLDS
from tissueid.gap.fit_tasks import Screen
from tissueid.gap.fitting import residual_blocks
from tissueid.gap.parameters import starts_of
from tissueid.gap.scoring import Candidate
from tissueid.twin.effect import Effect

TRIALS = 6
"""Simulations of an effect at most; the size follows from the last two by a power law."""
CLOSE = 0.1
"""Relative difference of the score at which the search for a size ends."""
LARGEST_FACTOR = 30.0
"""Largest change of the size from one trial to the next."""
LEAST_RISE = 0.05
"""Least rise of the score by a visible effect, nats, also where the baseline is close to a gap already."""


@dataclass(frozen=True)
class DetectionLimit:
    """Smallest size of an effect that would have been named: the value of one of its parameters, SI.

    Where the effect vanishes as its parameter grows, such as the mass of a frame, it is the largest value (``below``).
    """

    parameter: str
    value: float
    unit: str
    below: bool


class DetectionLimits:
    """Detection limits at a fit.

    Args:
        found: the fit that explains the session: the baseline without a gap, or the named set.
        named: effects that it adds to the baseline.
    """

    def __init__(self, found: Candidate, named: Sequence[str]) -> None:
        self._fit = found.fit
        self._screen = Screen(found.fit)
        self._blocks = residual_blocks(found.fit)
        self._left = [float(np.mean(found.fit.residuals[block] ** 2)) for block in self._blocks]
        self._tests = len(found.fit.parameters.dataset.tests)
        # A further member of a set needs its gain; a first effect a certain gap.
        self._wanted = THRESHOLDS.set_gain if named else max(THRESHOLDS.least_score - found.score, LEAST_RISE)

    def of(self, effect: Effect) -> DetectionLimit | None:
        """Return the limit of an effect; None where no size within its bounds would have been named, or where its size
        is estimated from the record."""
        start = starts_of(self._fit.parameters.dataset, effect, self._fit.predictions)[0]
        scaled = _scaled_parameters(effect, start)
        if not scaled:
            return None
        size, last = 1.0, None
        for _ in range(TRIALS):
            values = _at_size(effect, start, scaled, size)
            raised = self._raised(effect, values)
            if abs(raised - self._wanted) <= CLOSE * self._wanted:
                break
            # The score grows with the square of a small size.
            power = 2.0
            if last is not None and last[0] != size and raised > 0.0 < last[1]:
                power = min(max(math.log(raised / last[1]) / math.log(size / last[0]), 0.3), 4.0)
            last = (size, raised)
            factor = (self._wanted / raised) ** (1.0 / power) if raised > 0.0 else LARGEST_FACTOR
            size *= min(max(factor, 1.0 / LARGEST_FACTOR), LARGEST_FACTOR)
        else:
            if raised < self._wanted:
                return None
        if any(not effect.parameters[k].low <= values[k] <= effect.parameters[k].high for k in scaled):
            return None
        first, value = effect.parameters[scaled[0]], values[scaled[0]]
        assert first.neutral is not None
        return DetectionLimit(
            first.name,
            abs(value) if first.neutral == 0.0 else value,
            first.unit,
            below=first.neutral > value and first.neutral != 0.0,
        )

    def _raised(self, effect: Effect, values: tuple[float, ...]) -> float:
        # Half the logarithm of the error with and without the effect, as in ``scoring.score``.
        change = self._screen.surviving_change(effect, values)
        added = [float(np.mean(change[block] ** 2)) for block in self._blocks]
        return sum(0.5 * math.log1p(more / max(left, 1.0)) for more, left in zip(added, self._left, strict=True)) / max(
            self._tests, 1
        )


def _scaled_parameters(effect: Effect, start: Sequence[float]) -> list[int]:
    # The parameters that vanish with the effect: the first, or all where it vanishes with all of them only.
    scaled = [
        k
        for k, (parameter, value) in enumerate(zip(effect.parameters, start, strict=True))
        if parameter.neutral is not None and not parameter.fixed and value != parameter.neutral
    ]
    return scaled if effect.jointly else scaled[:1]


def _at_size(effect: Effect, start: Sequence[float], scaled: Sequence[int], size: float) -> tuple[float, ...]:
    values = list(start)
    for k in scaled:
        neutral = effect.parameters[k].neutral
        assert neutral is not None
        values[k] = start[k] / size if math.isinf(neutral) else neutral + size * (start[k] - neutral)
    return tuple(values)


__all__ = ["DetectionLimit", "DetectionLimits"]
