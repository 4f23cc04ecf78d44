"""Known systems, simulated by means that share nothing with the package: fine integration, plain loops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from tissueid.records import Estimate, Record

Array = NDArray[np.float64]

RATE = 2000.0
FINE = 16
WARM = 2000

MASS, DAMPING, STIFFNESS = 0.0912, 22.77, 4670.0
"""The posterior forearm of Chen 2010, section 3.1.3."""


def generator(*seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(list(seed)))


def second_order(
    rng: np.random.Generator,
    mass: float = MASS,
    damping: float = DAMPING,
    stiffness: float = STIFFNESS,
    n: int = 8000,
) -> tuple[Array, Array]:
    """Unit-variance Gaussian force, band-limited at 200 Hz, and the displacement, each (n,) at 2 kHz, no noise.

    Filtered and integrated at sixteen times that rate, then every sixteenth sample kept: above the Nyquist
    frequency of what is kept there is no power to fold back.
    """
    rate = RATE * FINE
    low_pass = signal.butter(8, 200.0, fs=rate, output="sos")
    force = signal.sosfilt(low_pass, rng.standard_normal((n + WARM) * FINE))
    force /= np.std(force)
    continuous = (
        np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]]),
        np.array([[0.0], [1.0 / mass]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
    )
    a, b, c, d, _ = signal.cont2discrete(continuous, 1.0 / rate, method="foh")
    numerator, denominator = signal.ss2tf(a, b, c, d)
    position = signal.lfilter(numerator[0], denominator, force)
    return force[WARM * FINE :: FINE], position[WARM * FINE :: FINE]


def noise(rng: np.random.Generator, like: Array, snr_db: float, colour: float = 0.0) -> Array:
    """Noise (n,) that far below a signal, white or first-order autoregressive."""
    white = rng.standard_normal(like.size)
    coloured = signal.lfilter([1.0], [1.0, -colour], white)
    return coloured / np.std(coloured) * np.std(like) * 10.0 ** (-snr_db / 20.0)


def linear_record(*seed: int, snr_db: float = 40.0, colour: float = 0.0, **system: float) -> Record:
    """A record about an operating point of 3 N and 12 mm."""
    rng = generator(*seed)
    force, position = second_order(rng, **system)
    return Record(force + 3.0, position + noise(rng, position, snr_db, colour) + 0.012, RATE)


KERNEL = np.exp(-np.arange(30) / 6.0) * np.sin((np.arange(30) + 1) / 4.0)
"""Response of ``broadband``, per sample."""


def broadband(*seed: int, n: int, noise: float, pole: float = 0.0) -> Record:
    """White force about 2 through ``KERNEL`` at 1 kHz, about 7, with autoregressive noise."""
    rng = generator(*seed)
    u = rng.standard_normal(n)
    e = signal.lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 500))[500:]
    return Record(u + 2.0, signal.lfilter(KERNEL, [1.0], u) + noise * e + 7.0, 1000.0)


C1, C2, SURFACE = 0.00742, 0.191, 0.0102
"""The anterior forearm of Chen 2010, Table 3.1, with a surface of our own."""

SCALED_MASS, SCALED_DAMPING = 1.94e-5, 4.84e-3


def wiener_record(*seed: int, snr_db: float = 30.0, colour: float = 0.0, n: int = 8000) -> Record:
    """Second-order dynamics of unit gain about 4 N, then the exponential of Eq. 3.26."""
    rng = generator(*seed)
    force, load = second_order(rng, SCALED_MASS, SCALED_DAMPING, 1.0, n)
    force, load = 2.2 * force + 4.0, 2.2 * load + 4.0
    position = SURFACE + C1 * (1.0 - np.exp(-C2 * load))
    return Record(force, position + noise(rng, position, snr_db, colour), RATE)


def thesis_wiener(seed: int, *, gain: float = 1.0, offset: float = -0.1, steps: int = 1) -> Record:
    """The Wiener system of Chen 2010, C.1.4: M 0.06, B 20, K 1000, input scaled by 1000, C1 7 mm, C2 0.2 per N.

    White force at 500 Hz for 16 s, explicit Euler with so many steps to a sample; the first 100 samples are cut.
    """
    rate, mass, damping, stiffness, scale = 500.0, 0.06, 20.0, 1000.0, 1000.0
    force = gain * generator(seed).standard_normal(8001) + offset
    step = 1.0 / (rate * steps)
    place = speed = 0.0
    load = np.empty(force.size)
    for n, push in enumerate(force):
        load[n] = place
        for _ in range(steps):
            pull = (scale * push - damping * speed - stiffness * place) / mass
            place, speed = place + step * speed, speed + step * pull
    position = 0.007 * (1.0 - np.exp(-0.2 * load))
    return Record(force[100:], position[100:], rate)


def changed(values: Array, *changes: tuple[Any, Any]) -> Array:
    """A copy with other values at some indices: ``changed(u, (3, np.nan), (np.s_[5:9], 0.0))``."""
    values = values.copy()
    for index, value in changes:
        values[index] = value
    return values


def near(parameters: Mapping[str, Estimate], rel: float, **expected: float) -> None:
    """Assert that parameters have these values within a relative tolerance."""
    for name, value in expected.items():
        assert parameters[name].value == pytest.approx(value, rel=rel), name
