"""How far a twin lies from what was recorded: errors by channel and test, the gap, and how much of it is closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.fitting import Fit
from tissueid.gap.observed import ObservedTest, Purpose

FloatArray = NDArray[np.float64]

GAP_CHANNELS = ("current", "position", "voltage")
"""Channels that the gap is taken over; the voltage counts where the command is known."""
LEAST_RATIO = 1.0
"""Errors below the noise are the noise."""


@dataclass(frozen=True)
class ChannelError:
    """Error of one channel in one test on the samples of one purpose.

    ``square`` is the mean squared error (SI squared), ``noise`` the sensor noise (std, SI), ``spread`` the standard
    deviation of the recorded signal over the whole test, ``samples`` how many samples it was taken over.
    ``irreducible`` (std, SI) is what an effect leaves besides, however well it is known: the rest of a rounding, say.
    """

    test: int
    channel: str
    square: float
    noise: float
    spread: float
    samples: int
    irreducible: float = 0.0

    @property
    def ratio(self) -> float:
        """Mean squared error over the variance of noise and what is irreducible, at least 1."""
        return max(self.square / (self.noise**2 + self.irreducible**2), LEAST_RATIO)


def errors(fitted: Fit, *purposes: Purpose, tests: Sequence[ObservedTest] | None = None) -> list[ChannelError]:
    """Errors by test and channel on the samples that serve any of the purposes; left out where there are none.

    ``tests`` are the fit's own, with other purposes perhaps.
    """
    found = []
    observed = fitted.parameters.observed
    for test, predicted in zip(observed.tests if tests is None else tests, fitted.predictions, strict=True):
        beside = fitted.parameters.irreducible(fitted.theta, test.number)
        chosen = np.isin(test.purpose, purposes)
        for name in observed.channels:
            mask = chosen & np.isfinite(test.signals[name])
            if not mask.any():
                continue
            error = np.clip(np.nan_to_num(predicted[name][mask], nan=1e6) - test.signals[name][mask], -1e6, 1e6)
            found.append(
                ChannelError(
                    test.number,
                    name,
                    float(np.mean(error**2)),
                    observed.noise[name],
                    float(np.nanstd(test.signals[name])),
                    int(mask.sum()),
                    beside.get(name, 0.0),
                )
            )
    return found


def score(found: Sequence[ChannelError]) -> float:
    """Half the logarithm of error over noise variance, summed over channels and averaged over tests, nats.

    0 where nothing is left but noise. A scale-free figure: a candidate that halves a channel's error gains 0.69 in it
    wherever it stands, so that a cause seen faintly in one channel is not lost beside a large error in another.
    """
    tests = {item.test for item in found}
    return float(sum(0.5 * np.log(item.ratio) for item in found)) / max(len(tests), 1)


def gap(found: Sequence[ChannelError], quiet: Sequence[int] = ()) -> float:
    """Normalised root-mean-square error: errors over the deviation of the recorded signal, all channels together.

    Squares and variances are pooled over the tests of a channel; the channels count alike. ``quiet`` tests have no
    signal to be relative to and are left out.
    """
    return _pooled(found, quiet, lambda item: item.square)


def floor(found: Sequence[ChannelError], quiet: Sequence[int] = ()) -> float:
    """What sensor noise alone leaves of the gap."""
    return _pooled(found, quiet, lambda item: item.noise**2)


def _pooled(found: Sequence[ChannelError], quiet: Sequence[int], square) -> float:  # type: ignore[no-untyped-def]
    shares = []
    for name in GAP_CHANNELS:
        of_channel = [item for item in found if item.channel == name and item.test not in quiet and item.spread > 0.0]
        if of_channel:
            error = sum(square(item) * item.samples for item in of_channel)
            shares.append(error / sum(item.spread**2 * item.samples for item in of_channel))
    return float(np.sqrt(np.mean(shares))) if shares else float("nan")


def closed(before: float, after: float, least: float) -> float:
    """Share of a gap that is closed: 1 - sqrt((after^2 - floor^2) / (before^2 - floor^2)), negative where it grew.

    NaN where there was no gap above the floor.
    """
    room = before**2 - least**2
    if not room > 0.0:
        return float("nan")
    return 1.0 - float(np.sqrt(max(after**2 - least**2, 0.0) / room))


@dataclass(frozen=True)
class Candidate:
    """Baseline with some effects added, refitted, and its errors on what was held out."""

    effects: tuple[str, ...]
    fit: Fit
    chosen_by: tuple[ChannelError, ...]
    """On the samples that serve the choice."""
    checked_by: tuple[ChannelError, ...]
    """On the samples that serve the check."""

    @property
    def score(self) -> float:
        """On the samples of the choice; smaller is better."""
        return score(self.chosen_by)

    @property
    def orders(self) -> tuple[int, ...]:
        """Number of parameters that were searched for, effect by effect."""
        return tuple(effect.order for effect in self.fit.parameters.effects)


def judged(fitted: Fit) -> Candidate:
    """A fit with its held-out errors."""
    return Candidate(
        tuple(effect.name for effect in fitted.parameters.effects),
        fitted,
        tuple(errors(fitted, Purpose.CHOICE)),
        tuple(errors(fitted, Purpose.CHECK)),
    )


def quiet_tests(tests: Sequence[ObservedTest]) -> tuple[int, ...]:
    """Numbers of the tests without a stimulus."""
    return tuple(test.number for test in tests if test.quiet)
