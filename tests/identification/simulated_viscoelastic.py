"""Masses on springs and dampers in the arrangements of Chen 2010, Fig. 2.1, from their state equations."""

from __future__ import annotations

import numpy as np
from identification import simulated
from identification.simulated import Array
from scipy import signal

from tissueid.records import Record

FINE = 8
VALUES = {
    "kelvin-voigt": (0.09, 20.0, 4000.0),
    "maxwell": (0.09, 5.0, 3000.0, 60.0),
    "standard-linear-solid": (0.09, 5.0, 2500.0, 2500.0, 25.0),
    "burger": (0.09, 5.0, 6000.0, 400.0, 4000.0, 40.0),
}
"""Mass (kg), parallel damping (N s/m), then the elements in the order of the engine."""


def _states(structure: str) -> tuple[list[list[float]], list[list[float]]]:
    """State matrix and input; the first state is the position, the second the speed, then force and extension."""
    m, b, *e = VALUES[structure]
    if structure == "kelvin-voigt":
        return [[0, 1], [-e[0] / m, -b / m]], [[0], [1 / m]]
    if structure == "maxwell":
        return [[0, 1, 0], [0, -b / m, -1 / m], [0, e[0], -e[0] / e[1]]], [[0], [1 / m], [0]]
    if structure == "standard-linear-solid":
        return [[0, 1, 0], [-e[0] / m, -b / m, -1 / m], [0, e[1], -e[1] / e[2]]], [[0], [1 / m], [0]]
    k1, b1, k2, b2 = e
    force = [0, k1, -k1 / b1 - k1 / b2, k1 * k2 / b2]
    return [[0, 1, 0, 0], [0, -b / m, -1 / m, 0], force, [0, 0, 1 / b2, -k2 / b2]], [[0], [1 / m], [0], [0]]


def record(structure: str, *seed: int, snr_db: float = 40.0, colour: float = 0.0, n: int = 8000) -> Record:
    """A record at 2 kHz about 3 N and 12 mm, with a force up to 200 Hz; the load of 3 N does not make it creep."""
    rng = simulated.generator(*seed)
    a, b = (np.array(part, dtype=float) for part in _states(structure))
    rate = simulated.RATE * FINE
    low_pass = signal.butter(8, 200.0, fs=rate, output="sos")
    force = signal.sosfilt(low_pass, rng.standard_normal((n + simulated.WARM) * FINE))
    force *= 2.0 / np.std(force)
    plant = (a, b, np.eye(1, a.shape[0]), np.zeros((1, 1)))
    numerator, denominator = signal.ss2tf(*signal.cont2discrete(plant, 1.0 / rate, method="foh")[:4])
    position = signal.lfilter(numerator[0], denominator, force)
    kept = slice(simulated.WARM * FINE, None, FINE)
    force, position = force[kept], position[kept] - position[kept][0]
    like: Array = signal.detrend(position) if structure in ("maxwell", "burger") else position
    return Record(force + 3.0, position + simulated.noise(rng, like, snr_db, colour) + 0.012, simulated.RATE)
