"""Stepped tests with small noise about each level (Chen 2010, 3.4 and 5.2), simulated without the package."""

from __future__ import annotations

import numpy as np
from identification.simulated import Array, generator
from scipy import signal

from tissueid.records import Record

RATE = 500.0
MEMORY = 60
"""Samples of memory in Fig. 5.2."""

MASS, DAMPING, STIFFNESS, SCALE = 0.06, 20.0, 1000.0, 1000.0
C1, C2 = 0.007, 0.2
LEVELS = (1.0, 2.0, 3.0, 4.0, 5.0)


def wiener(force: Array, rate: float = RATE) -> Array:
    """The Wiener system of C.1.4, (n,) in and out, its force held over each sample and integrated exactly."""
    continuous = (
        np.array([[0.0, 1.0], [-STIFFNESS / MASS, -DAMPING / MASS]]),
        np.array([[0.0], [SCALE / MASS]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
    )
    a, b, c, d, _ = signal.cont2discrete(continuous, 1.0 / rate, method="zoh")
    numerator, denominator = signal.ss2tf(a, b, c, d)
    load = signal.lfilter(numerator[0], denominator, force)
    return C1 * (1.0 - np.exp(-C2 * load))


def wiener_local(position: Array) -> Array:
    """Its mass, damping and stiffness for small motion about positions (k,): (k, 3)."""
    slope = C2 * (C1 - position)  # of position by load
    return np.column_stack([MASS / slope, DAMPING / slope, STIFFNESS / slope]) / SCALE


def steps(rng: np.random.Generator, continuous: int, repetitions: int, noise: float = 0.5) -> Array:
    """Force (n,): every level for so many samples, in a new order each time, with white noise about it.

    One memory and 200 samples to settle stand before it, at the first level.
    """
    levels = [level for _ in range(repetitions) for level in rng.permutation(LEVELS)]
    force = np.concatenate([np.full(MEMORY - 1 + 200, levels[0]), np.repeat(levels, continuous)])
    return force + noise * rng.standard_normal(force.size)


def stepped_wiener(*seed: int, continuous: int, repetitions: int, noise: float = 0.5) -> Record:
    """Fig. 5.2: ``continuous`` x ``repetitions`` x 5 points after the first memory."""
    force = steps(generator(*seed), continuous, repetitions, noise)
    return Record(force[200:], wiener(force)[200:], RATE)


def stochastic_wiener(*seed: int, n: int = 8000, std: float = 2.0) -> Record:
    """The same system under a white Gaussian force about 3 N (Fig. 5.1)."""
    force = 3.0 + std * generator(*seed).standard_normal(n + 200)
    return Record(force[200:], wiener(force)[200:], RATE)


def staircase(*seed: int, levels: int = 6, continuous: int = 1200, noise: float = 0.15) -> Array:
    """Force (n,) at 2 kHz: a staircase up and down from 2 to 7 N, its edges and the noise about it without power
    above 200 Hz."""
    up = np.linspace(2.0, 7.0, levels)
    heights = np.concatenate([up, up[-2::-1]])
    edges = signal.butter(4, 100.0, fs=2000.0, output="sos")
    smooth = signal.sosfilt(edges, np.repeat(heights, continuous), zi=signal.sosfilt_zi(edges) * heights[0])[0]
    low_pass = signal.butter(8, 200.0, fs=2000.0, output="sos")
    small = signal.sosfilt(low_pass, generator(*seed).standard_normal(smooth.size + 500))[500:]
    return smooth + noise * small / np.std(small)
