"""Known block structures, and one system that is none: fine filters and plain loops, nothing of the package.

The linear dynamics are Chen 2010's forearm (Table 3.1) or the overdamped tissue of C.1.4; the curves are the
exponential of Eq. 3.26 with the constants of C.1.4, and the square of C.3.1.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp

import numpy as np
from identification.simulated import FINE, RATE, SCALED_DAMPING, SCALED_MASS, WARM, Array, generator, noise
from scipy import signal

from tissueid.records import Record

C1, C2 = 0.007, 0.2
MEAN_FORCE, FORCE_SPREAD = 3.0, 2.0
LAG_S = 0.006
"""Time constant of the first block of the LNL system."""

BLOCKS = (
    "linear",
    "hammerstein exponential",
    "hammerstein square",
    "wiener exponential",
    "wiener square",
    "lnl",
    "nln",
)


@dataclass(frozen=True)
class Simulated:
    """A record with its noise-free output (n,), and what left the first curve, or entered the last one, (n,)."""

    record: Record
    clean: Array
    inside: Array


def true_name(system: str) -> str:
    return system.split()[0]


def exponential(load: Array) -> Array:
    return C1 * (1.0 - np.exp(-C2 * load))


def lever(load: Array) -> Array:
    """Curve of the middle of the LNL system, of a load without unit about zero."""
    return load - 0.25 * load**2 + 0.06 * load**3


def kernel(lags: int) -> Array:
    """Impulse response per sample of the linear dynamics, which has a steady gain of one, shape (lags,)."""
    decay = SCALED_DAMPING / (2.0 * SCALED_MASS)
    rate = np.sqrt(decay**2 - 1.0 / SCALED_MASS + 0j)
    t = np.arange(lags) / RATE
    return np.real(np.exp(-decay * t) * np.sinh(rate * t) / (rate * SCALED_MASS)) / RATE


def _force(rng: np.random.Generator, n: int) -> Array:
    low_pass = signal.butter(8, 200.0, fs=RATE * FINE, output="sos")
    force = signal.sosfilt(low_pass, rng.standard_normal((n + WARM) * FINE))
    return force / np.std(force)


def _dynamics(push: Array) -> Array:
    """Second-order dynamics of unit gain, integrated at the fine rate."""
    continuous = (
        np.array([[0.0, 1.0], [-1.0 / SCALED_MASS, -SCALED_DAMPING / SCALED_MASS]]),
        np.array([[0.0], [1.0 / SCALED_MASS]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
    )
    a, b, c, d, _ = signal.cont2discrete(continuous, 1.0 / (RATE * FINE), method="foh")
    numerator, denominator = signal.ss2tf(a, b, c, d)
    return signal.lfilter(numerator[0], denominator, push)


def _lag(push: Array) -> Array:
    pole = exp(-1.0 / (LAG_S * RATE * FINE))
    return signal.lfilter([1.0 - pole], [1.0, -pole], push)


def _dpn(force: Array) -> Array:
    """Eq. 3.33 with the parameters of C.1.4: damping and stiffness grow exponentially with depth; metres."""
    step = 1.0 / (RATE * FINE)
    place = speed = 0.0
    depth = np.empty(force.size)
    for n, push in enumerate(force):
        stiffer = exp(0.3 * place)
        pull = (1000.0 * push - 20.0 * stiffer * speed - 1000.0 * (stiffer + 0.5) * place) / 0.06
        speed += step * pull
        place += step * speed
        depth[n] = place
    return 1e-3 * depth


def simulate(system: str, *seed: int, snr_db: float = 30.0, colour: float = 0.0, n: int = 8000) -> Simulated:
    """One of :data:`BLOCKS`, or ``dpn``, under a Gaussian force band-limited at 200 Hz, sampled at 2 kHz."""
    rng = generator(*seed)
    unit = _force(rng, n)
    mean, spread = (0.0, FORCE_SPREAD) if "square" in system else (MEAN_FORCE, FORCE_SPREAD)
    force = mean + spread * unit
    if system == "linear":
        inside = force
        position = 1e-3 * (mean + _dynamics(force - mean))
    elif system == "hammerstein exponential":
        inside = exponential(force)
        position = _dynamics(inside)
    elif system == "hammerstein square":
        inside = 1e-3 * force**2
        position = _dynamics(inside)
    elif system == "wiener exponential":
        inside = mean + _dynamics(force - mean)
        position = exponential(inside)
    elif system == "wiener square":
        inside = _dynamics(force)
        position = 1e-3 * inside**2
    elif system == "lnl":
        load = _lag(unit)
        inside = load / np.std(load)
        position = 1e-3 * _dynamics(lever(inside))
    elif system == "nln":
        inside = 2.0 * np.tanh(0.5 * unit)
        load = mean + spread * _dynamics(inside)
        position = exponential(load)
    elif system == "dpn":
        inside = force
        position = _dpn(force)
    else:
        raise ValueError(system)
    kept = slice(WARM * FINE, None, FINE)
    clean = 0.01 + position[kept]
    measured = clean + noise(rng, clean, snr_db, colour)
    return Simulated(Record(force[kept], measured, RATE), clean, inside[kept])


def apart(ours: Array, truth: Array) -> float:
    """Relative distance of two arrays of one shape."""
    return float(np.linalg.norm(ours - truth) / np.linalg.norm(truth))
