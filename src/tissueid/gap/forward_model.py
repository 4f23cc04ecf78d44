"""Simulation of a test by the twin from its excitation: the command or the first recorded downstream signal.

An input-output record is simulated by the equivalent machine, as a free run or restarted from recorded states. A free
run of a machine that integrates its input drifts, most of all if the record was made in closed loop: its error grows
with the record and says little about the machine. Such a machine is predicted over windows that start from the recorded
motion (multi-step prediction: Ljung, System Identification, 2nd ed. (1999), 3.2; Farina and Piroddi, Automatica 47
(2011) 2063-2070).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.signal import savgol_coeffs, savgol_filter

from tissueid.gap.dataset import DatasetTest, interpolated
from tissueid.gap.equivalent_oscillator import VELOCITY_TIME_S, Equivalent, resampled
from tissueid.gap.parameters import DELAY, Parametrisation
from tissueid.twin import bus
from tissueid.twin._interpolation import interpolate
from tissueid.twin.chain_parameters import InstrumentParameters, Tissue, nothing
from tissueid.twin.effect import Readings
from tissueid.twin.simulation import (
    NOTHING_MEASURED,
    ActiveEffect,
    MeasuredSignals,
    Start,
    prepared,
    recorded,
    simulate_windows,
    simulated_motion,
)

FloatArray = NDArray[np.float64]

_STEPS_A_RADIAN = 12.0
_LONGEST_STEP_S = 5e-4
_DRY_STEP_S = 1.25e-4
"""Longest step with dry friction, which switches at every reversal, s."""
_DRY = ("dry_friction", "directional_friction")
_MOST_STEPS = 64
_HALF_WIDTHS = (3, 5, 8, 12, 18, 27, 40)
"""Half widths of the cubic through the readings around a restart, samples."""
_ONLY_NOISE = 1.15
"""Largest residual of that cubic, relative to white noise of the level that the narrowest one leaves."""


def simulate_equivalent(parameters: Parametrisation, theta: FloatArray, test: DatasetTest) -> Readings:
    """Return the simulated readings of an input-output test, shape (n,) a signal; ``current`` is the force.

    The input between samples, with a fractional delay, drives the machine as a measured force.
    """
    about = parameters.dataset.equivalent
    assert about is not None
    times = fineness(test.sample_rate_hz)
    rate = times * test.sample_rate_hz
    instrument, met = parameters.instrument(theta), parameters.tissue_of(theta, test)
    driven = _shifted(_Identity(test.command), test.sample_rate_hz, about.held)
    force = driven.by(parameters.value(theta, DELAY) * rate)
    acting = parameters.acting(theta, test)
    driving = [item for item in acting if bus.AMPLIFIER in item.effect.places]
    if driving:
        force = _driven(force, rate, driving, about)
    moving = [item for item in acting if item.effect.hook is not None and item not in driving]
    fastest = max(np.sqrt(met.stiffness_n_per_m / instrument.moving_mass_kg), parameters.fastest(theta))
    dry = any(item.effect.name in _DRY for item in moving)
    step = min(_LONGEST_STEP_S, 1.0 / (_STEPS_A_RADIAN * max(fastest, 1e-9)), _DRY_STEP_S if dry else np.inf)
    substeps = min(max(1, int(np.ceil(1.0 / (rate * step)))), _MOST_STEPS)
    first = restarts(test, about)
    fine = simulate_windows(
        prepared(moving, on_tissue=True),
        force,
        rate,
        instrument,
        met,
        np.array([*first, test.command.size], np.int64) * times,
        np.array([_begin(test, about, sample) for sample in first]),
        substeps,
        second_mass=about.has_coupling,
    )
    each = slice(times - 1, None, times)
    # The force at the time of a reading is between two fine steps.
    then = 0.5 * (force[each] + np.append(force, force[-1])[times::times])
    position = VELOCITY_TIME_S * fine[3, each] if about.output_is_velocity else fine[2, each]
    seconds = np.arange(1, then.size + 1) / test.sample_rate_hz
    met_readings = Readings(seconds, then, then, np.ascontiguousarray(position), test.sample_rate_hz)
    return recorded(met_readings, [item for item in acting if item not in driving])


def restarts(test: DatasetTest, about: Equivalent) -> tuple[int, ...]:
    """Return the first sample of each window of a prediction; only 0 for a free run.

    Windows are about as long as ``about.restart_s``. Each begins where the recorded velocity is the most certain, away
    from corners of the motion.
    """
    if about.restart_s is None:
        return (0,)
    length = max(round(about.restart_s * test.sample_rate_hz), 8)
    doubt = _velocity_doubt(_Identity(test.signals["position"]), 4, 12)
    first_samples = [0]
    for middle in range(length, test.command.size - length // 2, length):
        first, end = middle - length // 4, min(middle + length // 4, test.command.size - 1)
        first_samples.append(first + 1 + int(np.argmin(doubt[first:end])))
    return tuple(first_samples)


def velocity_error(test: DatasetTest, about: Equivalent) -> float:
    """Return the median error of the velocity at the restarts of a test, m/s, by two widths of the local cubic."""
    places = [sample - 1 for sample in restarts(test, about)[1:]]
    doubt = _velocity_doubt(_Identity(test.signals["position"]), 3, 5)
    return float(np.median(doubt[places])) * test.sample_rate_hz if places else 0.0


@lru_cache(maxsize=32)
def _velocity_doubt(key: _Identity, narrow_half: int, wide_half: int) -> FloatArray:
    # Difference of the slopes of a narrow and a wide cubic, in readings, as the largest of some neighbours.
    values = interpolated(key.values)
    narrow, wide = (savgol_filter(values, 2 * half + 1, 3, deriv=1) for half in (narrow_half, wide_half))
    return np.asarray(maximum_filter1d(np.abs(narrow - wide), 9))


def _begin(test: DatasetTest, about: Equivalent, sample: int) -> tuple[float, float]:
    # Position and velocity of the mass at a sample.
    if about.restart_s is None:
        recorded = test.signals["position"]
        first = recorded[np.isfinite(recorded)][:3]
        at = float(np.median(first)) if first.size else test.surface_m
        speed = 0.5 * float(first[2] - first[0]) * test.sample_rate_hz if first.size == 3 else 0.0
    else:
        position, velocity = recorded_state(test)
        at, speed = float(position[max(sample - 1, 0)]), float(velocity[max(sample - 1, 0)])
    return (0.0, at / VELOCITY_TIME_S) if about.output_is_velocity else (at, speed)


def _driven(force: FloatArray, rate_hz: float, acting: list[ActiveEffect], about: Equivalent) -> FloatArray:
    # The input after an amplifier; its zero is that of the recorded input.
    middle = about.input_middle_n
    volts = about.volts_per_newton * (force + middle)
    amplifier = InstrumentParameters(amplifier_gain=1.0, amplifier_limit_v=1e9)
    simulated = simulated_motion(
        volts, rate_hz, amplifier, nothing(), Start(0.0, 0.0), acting, on_tissue=False, substeps=1
    )
    return simulated.readings.voltage / about.volts_per_newton - middle


def recorded_state(test: DatasetTest) -> tuple[FloatArray, FloatArray]:
    """Return the recorded position (m) and velocity (m/s), shape (n,) each, by a local cubic.

    The cubic is as wide as leaves a residual of the size of the noise.
    """
    return _state(_Identity(test.signals["position"]), test.sample_rate_hz)


@lru_cache(maxsize=32)
def _state(key: _Identity, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    values = interpolated(key.values)
    chosen, noise = _HALF_WIDTHS[0], 0.0
    for half in _HALF_WIDTHS:
        if 2 * half + 1 > values.size:
            break
        residual_std = float(np.std(values - savgol_filter(values, 2 * half + 1, 3)))
        residual_std /= np.sqrt(1.0 - savgol_coeffs(2 * half + 1, 3)[half])
        noise = noise or residual_std
        if residual_std > _ONLY_NOISE * noise:
            break
        chosen = half
    width = 2 * chosen + 1
    return savgol_filter(values, width, 3), savgol_filter(values, width, 3, deriv=1, delta=1.0 / rate_hz)


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


STEP_S = 1.25e-4
"""Longest integration step, s: four in a sample at 2 kHz."""


def substeps_of(test: DatasetTest, step_s: float = STEP_S) -> int:
    """Return the number of integration steps in a sample of a test that are not longer than ``step_s``."""
    return max(1, int(np.ceil(1.0 / (test.sample_rate_hz * step_s))))


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
        return simulate_equivalent(parameters, theta, test)
    instrument = parameters.instrument(theta)
    if given is NOTHING_MEASURED:
        given = test.excitation(parameters.dataset.tracking_rad_s)
    acting, on_tissue = parameters.acting(theta, test), test.fixture == "tissue"
    met = _MOTIONS.motion(
        test,
        instrument,
        parameters.tissue_of(theta, test),
        [item for item in acting if item.effect.hook is not None],
        given,
        substeps or substeps_of(test),
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
        instrument: InstrumentParameters,
        met: Tissue,
        hooked: Sequence[ActiveEffect],
        given: MeasuredSignals,
        substeps: int,
    ) -> Readings:
        """Return the signals before the sensors, simulated if they are not in the cache."""
        effects = tuple((item.effect.name, item.values.tobytes()) for item in hooked)
        # At rest at the surface, unless the first readings differ.
        begin_a = float(test.command[0]) / (1.0 if test.driven_by == "current" else instrument.resistance_ohm)
        start, on_tissue = Start(begin_a, test.starting_position_m, 0.0), test.fixture == "tissue"
        # A repeat has the same motion: the key is the command and not the test.
        key = (test.played, start, on_tissue, id(given), instrument, met, effects, substeps)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key][1]
        readings = simulated_motion(
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
        self._kept[key] = (given, readings)
        if len(self._kept) > self._most:
            self._kept.popitem(last=False)
        return readings


_MOTIONS = _MotionCache(96)
