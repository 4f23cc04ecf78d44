"""Playing a test through the twin from what drives it: the command, or the first signal down the chain there is."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.equivalent import finely
from tissueid.gap.observed import ObservedTest
from tissueid.gap.parameters import DELAY, Parametrisation
from tissueid.twin._between import between
from tissueid.twin.effect import Readings
from tissueid.twin.figures import Instrument, Tissue
from tissueid.twin.simulation import NOTHING_GIVEN, Acting, Given, Start, recorded, simulate, simulated_motion

FloatArray = NDArray[np.float64]

STEP_S = 1.25e-4
"""Longest integration step: at 2 kHz four in a sample."""
_STEPS_A_RADIAN = 12.0
_LONGEST_STEP_S = 5e-4
_MOST_STEPS = 64


def starting_point(test: ObservedTest, resistance_ohm: float) -> Start:
    """Where a test starts: at rest at the surface, unless its first readings lie elsewhere."""
    position = test.signals["position"]
    first = position[np.isfinite(position)][:3]
    at = float(np.median(first)) if first.size else test.surface_m
    if test.driven_by == "input":
        return Start(0.0, at, _speed(first, test.sample_rate_hz))
    if test.starts_at_surface:
        at = test.surface_m
    if test.driven_by == "current":
        return Start(float(test.command[0]), at, 0.0)
    return Start(float(test.command[0]) / resistance_ohm, at, 0.0)


def _speed(first: FloatArray, rate_hz: float) -> float:
    return 0.5 * float(first[2] - first[0]) * rate_hz if first.size == 3 else 0.0


def played(
    parameters: Parametrisation,
    theta: FloatArray,
    test: ObservedTest,
    given: Given = NOTHING_GIVEN,
    substeps: int | None = None,
) -> Readings:
    """What the twin of a vector reads in a test, shape (n,) a signal.

    Args:
        parameters: coordinates of the fit.
        theta: their values.
        test: what was played.
        given: measured signals in place of simulated ones; by default what drives the test.
        substeps: integration steps in a sample; by default as many as ``STEP_S`` asks for.
    """
    if test.driven_by == "input":
        return _equivalent(parameters, theta, test)
    instrument = parameters.instrument(theta)
    if given is NOTHING_GIVEN and test.driven_by == "current":
        given = Given(current=test.command)
    elif given is NOTHING_GIVEN and test.driven_by == "voltage":
        given = Given(voltage=test.command)
    acting, on_tissue = parameters.acting(theta, test), test.fixture == "tissue"
    met = _MOTIONS.motion(
        test,
        instrument,
        parameters.met(theta, test),
        [item for item in acting if item.effect.hook is not None],
        given,
        substeps or max(1, int(np.ceil(1.0 / (test.sample_rate_hz * STEP_S)))),
    )
    return recorded(met, acting, on_tissue)


class _Motions:
    """The last motions that were simulated: a fit of what merely records them asks for the same again and again."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[Hashable, tuple[object, Readings]] = OrderedDict()

    def motion(
        self,
        test: ObservedTest,
        instrument: Instrument,
        met: Tissue,
        hooked: Sequence[Acting],
        given: Given,
        substeps: int,
    ) -> Readings:
        """What the sensors meet in a test, simulated if it is not among those that are kept."""
        effects = tuple((item.effect.name, item.values.tobytes()) for item in hooked)
        start, on_tissue = starting_point(test, instrument.resistance_ohm), test.fixture == "tissue"
        # A repeat is the same motion: what was played counts, not which test it was.
        key = (test.played, start, on_tissue, id(given), instrument, met, effects, substeps)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key][1]
        found = simulated_motion(
            test.command,
            test.sample_rate_hz,
            instrument,
            met,
            start,
            hooked,
            given=given,
            on_tissue=on_tissue,
            substeps=substeps,
        ).readings
        # What was given is kept as well: its identity must not be another's meanwhile.
        self._kept[key] = (given, found)
        if len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return found


_MOTIONS = _Motions(96)


def _equivalent(parameters: Parametrisation, theta: FloatArray, test: ObservedTest) -> Readings:
    # The input between samples, late by a fraction of one, drives a mass on a spring as a measured force.
    about = parameters.observed.equivalent
    assert about is not None
    times = fineness(test.sample_rate_hz)
    rate = times * test.sample_rate_hz
    instrument, met = parameters.instrument(theta), parameters.met(theta, test)
    late = parameters.value(theta, DELAY) * rate
    force = _Shifted.of(test, about.held).by(late)
    fastest = np.sqrt(met.stiffness_n_per_m / instrument.moving_mass_kg)
    step = min(_LONGEST_STEP_S, 1.0 / (_STEPS_A_RADIAN * fastest))
    fine = simulate(
        force,
        rate,
        instrument,
        met,
        starting_point(test, 1.0),
        parameters.acting(theta, test),
        given=Given(current=force),
        substeps=min(max(1, int(np.ceil(1.0 / (rate * step)))), _MOST_STEPS),
    ).readings
    each = slice(times - 1, None, times)
    # The force at the very time of a reading lies between two fine steps.
    then = 0.5 * (force[each] + np.append(force, force[-1])[times::times])
    return Readings(fine.time[each], then, then, fine.position[each], test.sample_rate_hz)


def fineness(sample_rate_hz: float) -> int:
    """Into how many parts a sample of a bare input is divided."""
    return 8 if sample_rate_hz < 500.0 else 4 if sample_rate_hz < 4000.0 else 2


class _Shifted:
    """An input between its samples, shifted in time; the newest shift is kept, since most fits ask for it again."""

    def __init__(self, values: FloatArray, sample_rate_hz: float, held: bool) -> None:
        self._times = fineness(sample_rate_hz)
        self._fine = finely(values, self._times, held=held)
        self._sum = np.concatenate([[0.0], np.cumsum(self._fine)])
        self._held = held
        self._late, self._shifted = float("nan"), self._fine

    @classmethod
    def of(cls, test: ObservedTest, held: bool) -> _Shifted:
        """The input of a test."""
        return _shifted(_Same(test.command), test.sample_rate_hz, held)

    def by(self, late: float) -> FloatArray:
        """Its mean over every fine step, shape (n times,), late by so many of them."""
        if late != self._late:
            steps = np.arange(self._fine.size, dtype=np.float64)
            if self._held:
                edges = np.interp(np.append(steps, steps.size) - late, np.arange(self._sum.size), self._sum)
                self._shifted = np.diff(edges)
            else:
                self._shifted = between(self._fine, steps + 0.5 - self._times - late)
            self._late = late
        return self._shifted


class _Same:
    """An array that is a key by its identity."""

    def __init__(self, values: FloatArray) -> None:
        self.values = values

    def __hash__(self) -> int:
        return id(self.values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Same) and other.values is self.values


@lru_cache(maxsize=32)
def _shifted(key: _Same, sample_rate_hz: float, held: bool) -> _Shifted:
    return _Shifted(key.values, sample_rate_hz, held)


__all__ = ["STEP_S", "fineness", "played", "starting_point"]
