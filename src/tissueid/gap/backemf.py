"""Whether the position reading shows the motion that the back-EMF shows.

Voltage and current tell the velocity without the position sensor. Where reading and simulation part, the current says
which of the two it follows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.driving import bridged
from tissueid.gap.fitting import Fit
from tissueid.gap.observed import ObservedTest
from tissueid.gap.stagewise import MOTION_HZ, Substituted, motion, motion_noise

FloatArray = NDArray[np.float64]

_SMOOTHED_BINS = 9


@dataclass(frozen=True)
class Followed:
    """How much of the difference between reading and simulation the current follows.

    ``share`` is 1 where the reading is right (what moves is at fault) and 0 where it is wrong (the sensor is), with its
    standard error.
    """

    share: float
    error: float


def followed(baseline: Fit, answer: Substituted, test: ObservedTest, noise_a: float, noise_m: float) -> Followed:
    """Regress what a simulation from measured voltage leaves of the current on the velocities' difference.

    Args:
        baseline: which was refitted.
        answer: current from measured voltage, with the simulated position kept.
        test: one of its tests.
        noise_a: of the current, A.
        noise_m: of the position, m.
    """
    instrument = baseline.parameters.instrument(answer.theta)
    scale = instrument.force_constant_n_per_a / instrument.resistance_ohm
    _, velocity = motion(test)
    simulated = answer.predicted[test.number]["position"]
    _, believed = motion(test, simulated)
    expected = -scale * (velocity - believed)
    left = bridged(answer.residual(test, "current"))
    window = np.hanning(left.size)
    weight = float(np.sum(window**2))
    hz = np.fft.rfftfreq(left.size, 1.0 / test.sample_rate_hz).astype(np.float64)
    inside = (hz > 0.3) & (hz < MOTION_HZ)
    one = np.fft.rfft((expected - expected.mean()) * window)[inside]
    other = np.fft.rfft((left - left.mean()) * window)[inside]
    noise = motion_noise(hz[inside], noise_m, test.sample_rate_hz) * scale**2 * weight
    power = np.convolve(np.abs(one) ** 2, np.ones(_SMOOTHED_BINS) / _SMOOTHED_BINS, "same")
    signal = np.maximum(power - noise, 0.0)
    trust = signal / np.maximum(power, 1e-300)
    floor = _level(other, noise_a**2 * weight)
    # Resistance, inductance and force constant may be off by the calibration's uncertainty, and look like motion.
    spread = baseline.parameters.observed.instrument.calibration_relative_uncertainty
    simulated_a = bridged(answer.predicted[test.number]["current"])
    nuisance = [simulated_a, np.diff(simulated_a, prepend=simulated_a[0]), scale * believed]
    columns = [np.sqrt(trust / floor) * one]
    for values in nuisance:
        spectrum = np.fft.rfft((values - values.mean()) * window)[inside]
        columns.append(np.sqrt(trust / floor) * spectrum)
    design = np.stack(columns, axis=1)
    normal = np.real(design.conj().T @ design)
    # What noise adds to the reading's power is none of the motion's.
    normal[0, 0] = float(np.sum(trust / floor * np.maximum(np.abs(one) ** 2 - noise, 0.0)))
    normal += np.diag([1e-12, *(0.5 * np.array([spread, 1.0, spread]) ** -2.0)])
    if normal[0, 0] <= 1e-9:
        return Followed(float("nan"), float("inf"))
    toward = np.real(design.conj().T @ (np.sqrt(trust / floor) * other))
    found = np.linalg.solve(normal, toward)
    rest = np.abs(np.sqrt(trust / floor) * other - design @ found) ** 2
    excess = max(1.0, float(np.sum(rest) / max(np.sum(trust), 1e-9)))
    return Followed(float(found[0]), float(np.sqrt(0.5 * excess * np.linalg.inv(normal)[0, 0])))


def _level(spectrum: NDArray[np.complex128], least: float) -> FloatArray:
    smooth = np.convolve(np.abs(spectrum) ** 2, np.ones(_SMOOTHED_BINS) / _SMOOTHED_BINS, "same")
    return np.maximum(smooth, least)
