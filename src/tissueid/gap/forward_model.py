"""Simulation of a test by the twin from its excitation: the command or the first recorded downstream signal."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import DatasetTest
from tissueid.gap.equivalent_oscillator import resampled
from tissueid.gap.parameters import DELAY, Parametrisation
from tissueid.twin._interpolation import interpolate
from tissueid.twin.chain_parameters import Instrument, Tissue
from tissueid.twin.effect import Readings
from tissueid.twin.simulation import (
    NOTHING_MEASURED,
    ActiveEffect,
    MeasuredSignals,
    Start,
    recorded,
    simulate,
    simulated_motion,
)

FloatArray = NDArray[np.float64]

STEP_S = 1.25e-4
"""Longest integration step, s: four in a sample at 2 kHz."""
_STEPS_A_RADIAN = 12.0
_LONGEST_STEP_S = 5e-4
_MOST_STEPS = 64


def starting_point(test: DatasetTest, resistance_ohm: float) -> Start:
    """Return the start of a test: at rest at the surface, unless its first readings differ."""
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


def simulate_test(
    parameters: Parametrisation,
    theta: FloatArray,
    test: DatasetTest,
    given: MeasuredSignals = NOTHING_MEASURED,
    substeps: int | None = None,
) -> Readings:
    """Return the simulated readings of a test, shape (n,) a signal.

    Args:
        parameters: coordinates of the fit.
        theta: their values.
        test: the test.
        given: measured signals that replace simulated ones; by default the excitation.
        substeps: integration steps in a sample; by default by ``STEP_S``.
    """
    if test.driven_by == "input":
        return _equivalent(parameters, theta, test)
    instrument = parameters.instrument(theta)
    if given is NOTHING_MEASURED and test.driven_by == "current":
        given = MeasuredSignals(current=test.command)
    elif given is NOTHING_MEASURED and test.driven_by == "voltage":
        given = MeasuredSignals(voltage=test.command)
    acting, on_tissue = parameters.acting(theta, test), test.fixture == "tissue"
    met = _MOTIONS.motion(
        test,
        instrument,
        parameters.tissue_of(theta, test),
        [item for item in acting if item.effect.hook is not None],
        given,
        substeps or max(1, int(np.ceil(1.0 / (test.sample_rate_hz * STEP_S)))),
    )
    return recorded(met, acting, on_tissue)


class _MotionCache:
    """Cache of the last simulated motions: a fit of effects on the recorded numbers asks for the same motion
    repeatedly."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[Hashable, tuple[object, Readings]] = OrderedDict()

    def motion(
        self,
        test: DatasetTest,
        instrument: Instrument,
        met: Tissue,
        hooked: Sequence[ActiveEffect],
        given: MeasuredSignals,
        substeps: int,
    ) -> Readings:
        """Return the signals before the sensors, simulated if they are not in the cache."""
        effects = tuple((item.effect.name, item.values.tobytes()) for item in hooked)
        start, on_tissue = starting_point(test, instrument.resistance_ohm), test.fixture == "tissue"
        # A repeat has the same motion: the key is the command and not the test.
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
        # Keep the given signals as well, so that their identities are not reused.
        self._kept[key] = (given, found)
        if len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return found


_MOTIONS = _MotionCache(96)


def _equivalent(parameters: Parametrisation, theta: FloatArray, test: DatasetTest) -> Readings:
    # The input between samples, with a fractional delay, drives the oscillator as a measured force.
    about = parameters.dataset.equivalent
    assert about is not None
    times = fineness(test.sample_rate_hz)
    rate = times * test.sample_rate_hz
    instrument, met = parameters.instrument(theta), parameters.tissue_of(theta, test)
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
        given=MeasuredSignals(current=force),
        substeps=min(max(1, int(np.ceil(1.0 / (rate * step)))), _MOST_STEPS),
    ).readings
    each = slice(times - 1, None, times)
    # The force at the time of a reading is between two fine steps.
    then = 0.5 * (force[each] + np.append(force, force[-1])[times::times])
    return Readings(fine.time[each], then, then, fine.position[each], test.sample_rate_hz)


def fineness(sample_rate_hz: float) -> int:
    """Return the number of parts of a sample of an input-output record."""
    return 8 if sample_rate_hz < 500.0 else 4 if sample_rate_hz < 4000.0 else 2


class _Shifted:
    """An input between its samples with a time shift; the last shift is cached, since most fits use it again."""

    def __init__(self, values: FloatArray, sample_rate_hz: float, held: bool) -> None:
        self._times = fineness(sample_rate_hz)
        self._fine = resampled(values, self._times, held=held)
        self._sum = np.concatenate([[0.0], np.cumsum(self._fine)])
        self._held = held
        self._late, self._shifted = float("nan"), self._fine

    @classmethod
    def of(cls, test: DatasetTest, held: bool) -> _Shifted:
        """Return the command of a test, to be delayed by any time; ``held`` between the samples."""
        return _shifted(_Identity(test.command), test.sample_rate_hz, held)

    def by(self, late: float) -> FloatArray:
        """Return its mean over every fine step, shape (n times,), at a delay in fine steps."""
        if late != self._late:
            steps = np.arange(self._fine.size, dtype=np.float64)
            if self._held:
                edges = np.interp(np.append(steps, steps.size) - late, np.arange(self._sum.size), self._sum)
                self._shifted = np.diff(edges)
            else:
                self._shifted = interpolate(self._fine, steps + 0.5 - self._times - late)
            self._late = late
        return self._shifted


class _Identity:
    """An array as a key by identity."""

    def __init__(self, values: FloatArray) -> None:
        self.values = values

    def __hash__(self) -> int:
        return id(self.values)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Identity) and other.values is self.values


@lru_cache(maxsize=32)
def _shifted(key: _Identity, sample_rate_hz: float, held: bool) -> _Shifted:
    return _Shifted(key.values, sample_rate_hz, held)


__all__ = ["STEP_S", "fineness", "simulate_test", "starting_point"]
