"""Scores of a twin: errors by channel and test, the gap, and the closed share of the gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import DatasetTest, Purpose
from tissueid.gap.fitting import Fit, residual_blocks

FloatArray = NDArray[np.float64]

GAP_CHANNELS = ("current", "position", "voltage")
"""Channels of the gap; the voltage counts where the command is known."""
LEAST_RATIO = 1.0
"""Least ratio of error to noise variance: smaller errors count as noise."""
RARE_BLOCKS = 0.2
"""Share of the blocks, those with the largest error, that do not count against an accepted twin. The error that it left
in its own session rests on one or two events where it is rare, such as lift-off, and says little about the next ones.
"""


@dataclass(frozen=True)
class ChannelError:
    """Error of one channel in one test on the samples of one purpose.

    ``square`` is the mean squared error (SI squared), ``noise`` the sensor noise (std, SI), ``spread`` the standard
    deviation of the recorded signal over the whole test, ``samples`` the number of samples. ``irreducible`` (std, SI)
    is the part that an effect leaves however well it is known, such as rounding, or that a saved twin is known to
    leave. ``frequent`` is the mean squared error without rare events, where those do not count.
    """

    test: int
    channel: str
    square: float
    noise: float
    spread: float
    samples: int
    irreducible: float = 0.0
    frequent: float | None = None

    @property
    def ratio(self) -> float:
        """Mean squared error over the variance of noise and irreducible error, at least 1."""
        square = self.square if self.frequent is None else self.frequent
        return max(square / (self.noise**2 + self.irreducible**2), LEAST_RATIO)


def errors(fitted: Fit, *purposes: Purpose, tests: Sequence[DatasetTest] | None = None) -> list[ChannelError]:
    """Return the errors by test and channel on the samples of any of the purposes, where there are such samples.

    ``tests`` replaces the fit's tests by the same tests with other purposes.
    """
    found = []
    dataset = fitted.parameters.dataset
    for test, predicted in zip(dataset.tests if tests is None else tests, fitted.predictions, strict=True):
        irreducible = fitted.parameters.irreducible(fitted.theta, test.number)
        chosen = np.isin(test.purpose, purposes)
        for name in dataset.channels:
            mask = chosen & np.isfinite(test.signals[name])
            if not mask.any():
                continue
            error = np.clip(np.nan_to_num(predicted[name][mask], nan=1e6) - test.signals[name][mask], -1e6, 1e6)
            found.append(
                ChannelError(
                    test.number,
                    name,
                    float(np.mean(error**2)),
                    dataset.noise[name],
                    float(np.nanstd(test.signals[name])),
                    int(mask.sum()),
                    irreducible.get(name, 0.0),
                    without_rare_events(error, np.flatnonzero(mask)) if dataset.unmodelled else None,
                )
            )
    return found


def without_rare_events(error: FloatArray, samples: NDArray[np.intp]) -> float:
    """Return the mean squared error without the blocks of largest error, ``RARE_BLOCKS`` of them and at least one of
    several.

    Args:
        error: errors, SI, shape (n,).
        samples: their places in the test, ascending, shape (n,); a block ends where a place is left out.
    """
    begins = np.flatnonzero(np.diff(samples, prepend=samples[0] - 2) > 1)
    sums, sizes = np.add.reduceat(error**2, begins), np.diff(begins, append=error.size)
    left_out = max(int(RARE_BLOCKS * begins.size), min(begins.size - 1, 1))
    kept = np.argsort(sums / sizes)[: begins.size - left_out]
    return float(sums[kept].sum() / sizes[kept].sum())


def score(found: Sequence[ChannelError]) -> float:
    """Return half the logarithm of error over noise variance, summed over channels and averaged over tests, nats.

    0 where only noise is left. The score is scale-free: halving the error of a channel lowers it by 0.69 at any level,
    so that a weak trace in one channel counts next to a large error in another.
    """
    tests = {item.test for item in found}
    return float(sum(0.5 * np.log(item.ratio) for item in found)) / max(len(tests), 1)


def fitted_score(fitted: Fit, residuals: FloatArray) -> float:
    """Return the score of residuals on the fitted samples, shape as ``Fit.residuals``."""
    blocks = residual_blocks(fitted)
    tests = len(blocks) / len(fitted.parameters.dataset.channels)
    squares = (float(np.mean(residuals[block] ** 2)) for block in blocks)
    return float(sum(0.5 * np.log(max(square, LEAST_RATIO)) for square in squares)) / max(tests, 1.0)


def gap(found: Sequence[ChannelError], quiet: Sequence[int] = ()) -> float:
    """Return the normalised root-mean-square error: error over the standard deviation of the recorded signal.

    Squares and variances are pooled over the tests of a channel; channels have equal weight. ``quiet`` tests have no
    signal to normalise by and are left out.
    """
    return _pooled(found, quiet, lambda item: item.square)


def floor(found: Sequence[ChannelError], quiet: Sequence[int] = ()) -> float:
    """Return the gap that sensor noise and irreducible errors alone cause."""
    return _pooled(found, quiet, lambda item: item.noise**2 + item.irreducible**2)


def gap_left(before: Sequence[ChannelError], after: Sequence[ChannelError], quiet: Sequence[int] = ()) -> float:
    """Return the gap that an explanation leaves: at least the floor, as smaller errors count as noise."""
    return max(gap(after, quiet), min(floor(before, quiet), gap(before, quiet)))


def _pooled(found: Sequence[ChannelError], quiet: Sequence[int], square) -> float:  # type: ignore[no-untyped-def]
    shares = []
    for name in GAP_CHANNELS:
        of_channel = [item for item in found if item.channel == name and item.test not in quiet and item.spread > 0.0]
        if of_channel:
            error = sum(square(item) * item.samples for item in of_channel)
            shares.append(error / sum(item.spread**2 * item.samples for item in of_channel))
    return float(np.sqrt(np.mean(shares))) if shares else float("nan")


def closed(before: float, after: float, least: float) -> float:
    """Return the closed share of a gap: 1 - sqrt((after^2 - floor^2) / (before^2 - floor^2)), negative where it grew.

    NaN where there was no gap above the floor.
    """
    room = before**2 - least**2
    if not room > 0.0:
        return float("nan")
    return 1.0 - float(np.sqrt(max(after**2 - least**2, 0.0) / room))


@dataclass(frozen=True)
class Candidate:
    """A refitted baseline with added effects, and its errors on held-out data."""

    effects: tuple[str, ...]
    fit: Fit
    chosen_by: tuple[ChannelError, ...]
    """Errors on the samples for the choice."""
    checked_by: tuple[ChannelError, ...]
    """Errors on the samples for the check."""

    @property
    def score(self) -> float:
        """Score on the samples for the choice; smaller is better."""
        return score(self.chosen_by)

    @property
    def orders(self) -> tuple[int, ...]:
        """Number of fitted parameters of each effect."""
        return tuple(effect.order for effect in self.fit.parameters.effects)


def misfit(candidate: Candidate) -> float:
    """Return half the logarithm of the mean squared error in noise deviations on the samples for the choice, nats.

    It pools the channels as the fit does. Far from the noise floor, where a fit trades an error of one channel for that
    of another, a further effect of a set always lowers it; the score (see ``score``) can rise.
    """
    found = candidate.chosen_by
    return 0.5 * float(np.log(sum(item.ratio * item.samples for item in found) / sum(item.samples for item in found)))


def score_candidate(fitted: Fit) -> Candidate:
    """Return a fit with its errors on held-out data."""
    return Candidate(
        tuple(effect.name for effect in fitted.parameters.effects),
        fitted,
        tuple(errors(fitted, Purpose.CHOICE)),
        tuple(errors(fitted, Purpose.CHECK)),
    )


def quiet_tests(tests: Sequence[DatasetTest]) -> tuple[int, ...]:
    """Return the numbers of the tests without a stimulus."""
    return tuple(test.number for test in tests if test.quiet)
