"""Simulation from command to position with a drag proportional to the squared speed, in numpy, and its fit.

All variations for the differences are simulated side by side in one loop.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RESISTANCE, INDUCTANCE, FORCE_CONSTANT, MASS, DAMPING = 12.0, 1.0e-3, 3.0, 0.060, 3.5
REFERENCE_M_S = 0.05
SUBSTEPS = 4


def simulate(command: Array, rate: float, theta: Array, surface_m: float) -> tuple[Array, Array]:
    """Simulate current and position (n, k) of k systems under one command (n,), V, from rest at the surface.

    ``theta`` (6, k): the tissue's mass, damping and its growth, stiffness and its growth; the drag at 50 mm/s. The
    current is integrated exactly within a step, viscous forces implicitly.
    """
    step = 1.0 / (rate * SUBSTEPS)
    tissue_mass, b0, b1, k0, k1, drag = theta
    mass = MASS + tissue_mass
    decay = RESISTANCE * step / INDUCTANCE
    kept = np.exp(-decay)
    mixed = (1.0 - kept) / decay
    current = np.full(theta.shape[1], command[0] / RESISTANCE)
    position, velocity = np.full(theta.shape[1], surface_m), np.zeros(theta.shape[1])
    acceleration = np.zeros(theta.shape[1])
    currents, positions = np.empty((command.size, theta.shape[1])), np.empty((command.size, theta.shape[1]))
    for n in range(command.size):
        for _ in range(SUBSTEPS):
            middle = velocity + 0.5 * step * acceleration
            half = position + 0.5 * step * velocity
            depth = half - surface_m
            settled = (command[n] - FORCE_CONSTANT * middle) / RESISTANCE
            mean = settled + (current - settled) * mixed
            current = settled + (current - settled) * kept
            braking = DAMPING + b0 * np.exp(b1 * depth) + drag / REFERENCE_M_S**2 * np.abs(middle)
            push = FORCE_CONSTANT * mean - k0 * np.exp(k1 * depth) * depth
            share = 0.5 * step * braking / mass
            then = (velocity * (1.0 - share) + step * push / mass) / (1.0 + share)
            acceleration = (then - velocity) / step
            velocity = then
            position = half + 0.5 * step * velocity
        currents[n], positions[n] = current, position
    return currents, positions


def fitted(
    command: Array,
    rate: float,
    surface_m: float,
    current: Array,
    position: Array,
    noise: tuple[float, float],
    steps: int,
) -> Array:
    """Return the six parameters (6,) after Gauss-Newton steps on their logarithms with forward differences."""
    log = np.log(np.array([0.02, 7.0, 200.0, 450.0, 200.0, 0.05]))
    for _ in range(steps):
        varied = log[:, None] + np.hstack([np.zeros((6, 1)), 1e-5 * np.eye(6)])
        currents, positions = simulate(command, rate, np.exp(varied), surface_m)
        both = np.concatenate([currents / noise[0], positions / noise[1]])
        slopes = (both[:, 1:] - both[:, :1]) / 1e-5
        left = np.concatenate([current / noise[0], position / noise[1]]) - both[:, 0]
        log = log + np.clip(np.linalg.lstsq(slopes, left, rcond=None)[0], -1.0, 1.0)
    return np.asarray(np.exp(log))
