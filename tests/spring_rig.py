"""A spring on a coil of which everything is known: a plant that shares nothing with the package.

The force constant falls off by a logistic step at either end. Runge-Kutta of order four at 24 kHz. Voltages, currents
and positions pass filters of first order at 2 kHz, and are read at the end of the interval in which a command is held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import signal

from tissueid.calibration.spring_points import SweepTest

STEP_HZ = 24e3


@dataclass(frozen=True)
class Rig:
    """The truth, SI, and the errors of the channels."""

    resistance: float = 12.0
    inductance: float = 1.0e-3
    force_constant: float = 3.0
    mass: float = 0.066
    damping: float = 3.6
    stiffness: float = 1000.0
    weight: float = 0.5884
    near: tuple[float, float, float] = (0.25, 0.5e-3, 1.6e-3)  # depth, place, width of the fall at the beginning
    far: tuple[float, float, float] = (0.40, 30.5e-3, 1.7e-3)
    current_gain: float = 1.0
    position_gain: float = 1.0
    voltage_gain: float = 1.0
    current_offset: float = 0.0
    current_noise: float = 13e-3
    position_noise: float = 1e-6
    voltage_noise: float = 2.7e-3
    rate: float = 2000.0

    def k(self, position):
        """Force constant, N/A, at positions in metres."""
        return force_constant(np.asarray(position, dtype=float), *self.profile())

    def profile(self):
        return self.force_constant, *self.near, *self.far

    def linear_region(self):
        """Within 5 % of the median over the middle half of the 32 mm stroke."""
        x = np.linspace(0.0, 0.032, 32001)
        k = self.k(x)
        off = np.abs(k / np.median(k[8000:24001]) - 1.0) > 0.05
        low, high = np.flatnonzero(off[:16000]), 16000 + np.flatnonzero(off[16000:])
        return (x[low[-1] + 1] if low.size else 0.0), (x[high[0] - 1] if high.size else 0.032)

    def play(self, volts, surface, seed):
        """Readings of voltage, current and position, each (n,), under commands (n,), V, from rest without current."""
        rest = surface + self.weight / self.stiffness
        out = np.empty((volts.size, 3))
        figures = (
            self.resistance,
            self.inductance,
            self.mass,
            self.damping,
            self.stiffness,
            self.weight,
            surface,
            *self.profile(),
        )
        _integrate(np.asarray(volts, dtype=float), np.array(figures), rest, 1.0 / self.rate, out)
        random = np.random.default_rng(seed)
        voltage = self.voltage_gain * out[:, 2] + self.voltage_noise * random.standard_normal(volts.size)
        current = self.current_gain * out[:, 0] + self.current_offset
        current = current + self.current_noise * random.standard_normal(volts.size)
        position = 0.016384 + self.position_gain * (out[:, 1] - 0.016384)
        position = position + self.position_noise * random.standard_normal(volts.size)
        return voltage, current, 0.5e-6 * np.rint(position / 0.5e-6)


@njit(cache=True)
def force_constant(x, k, near, near_at, near_width, far, far_at, far_width):
    lost = near / (1.0 + np.exp((x - near_at) / near_width)) + far / (1.0 + np.exp((far_at - x) / far_width))
    return k * (1.0 - lost)


@njit(cache=True)
def _slope(s, u, p, out):
    k = force_constant(s[1], p[7], p[8], p[9], p[10], p[11], p[12], p[13])
    out[0] = (u - p[0] * s[0] - k * s[2]) / p[1]
    out[1] = s[2]
    out[2] = (k * s[0] + p[5] - p[3] * s[2] - p[4] * (s[1] - p[6])) / p[2]
    out[3] = 2.0 * np.pi * 2000.0 * (s[0] - s[3])
    out[4] = 2.0 * np.pi * 2000.0 * (s[1] - s[4])
    out[5] = 2.0 * np.pi * 2000.0 * (u - s[5])


@njit(cache=True)
def _integrate(volts, p, rest, interval, out):
    s = np.array([0.0, rest, 0.0, 0.0, rest, 0.0])
    a, b, c, d = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    steps = max(4, round(interval * STEP_HZ))
    h = interval / steps
    for n in range(volts.size):
        for _ in range(steps):
            _slope(s, volts[n], p, a)
            _slope(s + 0.5 * h * a, volts[n], p, b)
            _slope(s + 0.5 * h * b, volts[n], p, c)
            _slope(s + h * c, volts[n], p, d)
            s = s + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        out[n, 0] = s[3]
        out[n, 1] = s[4]
        out[n, 2] = s[5]


def swept(rig, places_m, seconds=4.0, seed=0, swing_m=2.5e-3, sweep=0):
    """Tests at places, each with the swing that has room there; the noise is that of the product's default stimulus."""
    tests = []
    for number, place in enumerate(places_m):
        room = min(swing_m, place - 0.9e-3, 31.1e-3 - place)
        random = np.random.default_rng(1000 * seed + number)
        low_pass = signal.butter(4, 200.0, fs=rig.rate, output="sos")
        noise = signal.sosfilt(low_pass, random.standard_normal(round(seconds * rig.rate)))
        # 16 V of standard deviation swing it by 2.5 mm at most, most of the time.
        volts = 7.0 * room / 2.5e-3 * noise / noise.std()
        surface = place - rig.weight / rig.stiffness
        readings = rig.play(volts, surface, 77 + 1000 * seed + number)
        rest = 0.016384 + rig.position_gain * (place - 0.016384)
        tests.append(SweepTest(*readings, sample_rate_hz=rig.rate, stage_m=surface, rest_m=rest, sweep=sweep))
    return tests
