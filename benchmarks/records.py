"""Simulated records of the benchmarks, the same in every run."""

from __future__ import annotations

import numpy as np
from scipy import signal

from tissueid.identification.second_order import SecondOrder
from tissueid.records import Record

RATE = 2000.0
SAMPLES = 8000


def broadband(noise: float = 0.01) -> Record:
    """Return a force with power up to the Nyquist frequency and the response of second-order tissue: R is well
    conditioned.
    """
    rng = np.random.Generator(np.random.PCG64(1))
    force = signal.lfilter([1.0], [1.0, -0.7], rng.standard_normal(SAMPLES)) + 4.0
    tissue = SecondOrder(mass=0.0912, damping=22.77, stiffness=4670.0)
    position = tissue.simulate(force - 4.0, RATE) + 0.012
    return Record(force, position + noise * np.std(position) * rng.standard_normal(SAMPLES), RATE)


def wiener(noise: float = 0.01) -> Record:
    """Return the same force through linear dynamics and an exponential static nonlinearity."""
    linear = broadband(noise=0.0)
    rng = np.random.Generator(np.random.PCG64(2))
    load = 4.0 + 4670.0 * (linear.output - 0.012)
    position = 0.010 + 0.0074 * (1.0 - np.exp(-0.19 * load))
    return Record(linear.input, position + noise * np.std(position) * rng.standard_normal(SAMPLES), RATE)
