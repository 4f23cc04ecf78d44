"""Discrete DPN model of Chen 2010, C.1.4, in numpy: a loop over the samples, and a search by finite differences.

All variations for the differences are simulated side by side in one loop.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]


def simulate(force: Array, rate: float, theta: Array, low: float, high: float, start: Array) -> Array:
    """Simulate positions (n, k) of k systems under one force (n,) by Runge-Kutta; Euler's method of C.1.4 is not
    accurate enough.

    ``theta`` (6, k) is log mass, log damping and its growth, log stiffness and its growth, both over half the range of
    positions, and the force halfway; ``start`` (2, k) is position and speed.
    """
    step = 1.0 / rate
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    mass = np.exp(theta[0])
    b0, b1, k0, k1, level = theta[1:6]
    scale = np.exp(k0) * half / k1
    half_way = signal.resample(force, 2 * force.size)  # band-limited: every second value is the force half a step later

    def acceleration(push: float, y: Array, v: Array) -> Array:
        x = (y - middle) / half
        return np.asarray((push - np.exp(b0 + b1 * x) * v - level - scale * np.expm1(k1 * x)) / mass)

    y, v = start
    position = np.empty((force.size, theta.shape[1]))
    position[0] = y
    for n in range(force.size - 1):
        first, between, last = half_way[2 * n : 2 * n + 3]
        v1, r1 = v, acceleration(first, y, v)
        v2 = v + 0.5 * step * r1
        r2 = acceleration(between, y + 0.5 * step * v1, v2)
        v3 = v + 0.5 * step * r2
        r3 = acceleration(between, y + 0.5 * step * v2, v3)
        v4 = v + step * r3
        r4 = acceleration(last, y + step * v3, v4)
        y = y + step / 6.0 * (v1 + 2.0 * (v2 + v3) + v4)
        v = v + step / 6.0 * (r1 + 2.0 * (r2 + r3) + r4)
        position[n + 1] = y
    return position


def with_slopes(force: Array, rate: float, theta: Array, low: float, high: float, start: Array) -> tuple[Array, Array]:
    """Return the position (n,) and its derivatives (n, 8) by six parameters and two initial values, by forward
    differences.
    """
    sizes = np.array([1e-5] * 6 + [1e-8, 1e-6])
    varied = np.concatenate([theta, start])[:, None] + np.hstack([np.zeros((8, 1)), np.diag(sizes)])  # (8, 9)
    positions = simulate(force, rate, varied[:6], low, high, varied[6:])
    return positions[:, 0], (positions[:, 1:] - positions[:, :1]) / sizes
