"""Comparison of the position reading with the back-EMF.

Voltage and current give the velocity without the position sensor. Where reading and simulation differ, the current
shows which of the two is right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import DatasetTest
from tissueid.gap.excitation import interpolated
from tissueid.gap.fitting import Fit
from tissueid.gap.stage_substitution import MOTION_HZ, StageSimulation, motion, motion_noise

FloatArray = NDArray[np.float64]

_SMOOTHED_BINS = 9


@dataclass(frozen=True)
class BackEmfShare:
    """Share of the difference between reading and simulation that the current follows.

    ``share`` is 1 where the reading is right (a fault of the moving part or the tissue) and 0 where it is wrong (a
    fault of the sensor), with its standard error.
    """

    share: float
    error: float


def back_emf_share(
    baseline: Fit, answer: StageSimulation, test: DatasetTest, noise_a: float, noise_m: float
) -> BackEmfShare:
    """Regress the residual of the current, simulated from measured voltage, on the difference of the velocities.

    Args:
        baseline: the refitted baseline.
        answer: simulated current from measured voltage, with the simulated position.
        test: one of its tests.
        noise_a: standard deviation of the current, A.
        noise_m: standard deviation of the position, m.
    """
    instrument = baseline.parameters.instrument(answer.theta)
    scale = instrument.force_constant_n_per_a / instrument.resistance_ohm
    _, velocity = motion(test)
    simulated = answer.predicted[test.number]["position"]
    _, believed = motion(test, simulated)
    expected = -scale * (velocity - believed)
    left = interpolated(answer.residual(test, "current"))
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
    # Resistance, inductance and force constant are uncertain within the calibration, which can imitate motion.
    spread = baseline.parameters.dataset.instrument.calibration_relative_uncertainty
    simulated_a = interpolated(answer.predicted[test.number]["current"])
    nuisance = [simulated_a, np.diff(simulated_a, prepend=simulated_a[0]), scale * believed]
    columns = [np.sqrt(trust / floor) * one]
    for values in nuisance:
        spectrum = np.fft.rfft((values - values.mean()) * window)[inside]
        columns.append(np.sqrt(trust / floor) * spectrum)
    design = np.stack(columns, axis=1)
    normal = np.real(design.conj().T @ design)
    # Remove the power of the noise from that of the reading.
    normal[0, 0] = float(np.sum(trust / floor * np.maximum(np.abs(one) ** 2 - noise, 0.0)))
    normal += np.diag([1e-12, *(0.5 * np.array([spread, 1.0, spread]) ** -2.0)])
    if normal[0, 0] <= 1e-9:
        return BackEmfShare(float("nan"), float("inf"))
    toward = np.real(design.conj().T @ (np.sqrt(trust / floor) * other))
    found = np.linalg.solve(normal, toward)
    rest = np.abs(np.sqrt(trust / floor) * other - design @ found) ** 2
    excess = max(1.0, float(np.sum(rest) / max(np.sum(trust), 1e-9)))
    return BackEmfShare(float(found[0]), float(np.sqrt(0.5 * excess * np.linalg.inv(normal)[0, 0])))


def _level(spectrum: NDArray[np.complex128], least: float) -> FloatArray:
    smooth = np.convolve(np.abs(spectrum) ** 2, np.ones(_SMOOTHED_BINS) / _SMOOTHED_BINS, "same")
    return np.maximum(smooth, least)
