"""Cascades of linear dynamics and static curves (Chen 2010, C.1.4 and C.3.1), by plain loops.

The linear stage is that of C.3.1, a second-order system of gain 5 and damping ratio 0.5, whose impulse response is cut
off at 40 samples, so that a memory of 40 lags holds all of it and the true kernels are known without error.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from identification.simulated import Array, generator, noise
from scipy import signal

from tissueid.records import Record

RATE = 500.0
LAGS = 40
GAIN, DAMPING_RATIO, NATURAL = 5.0, 0.5, 220.0
INPUT_STD = 1.2
REST = 20.0
"""What C.3.1 adds to every output."""

WARM = 400

CURVES: dict[str, Callable[[Array], Array]] = {
    "straight": lambda v: v,
    "exponential": lambda v: 10.257 * (1.0 - np.exp(-0.2112 * v)),
    "square": lambda v: v**2,
    "cubic": lambda v: 0.1 * v**3 - v**2 + v,
}


@dataclass(frozen=True)
class Cascade:
    """A record, and the per-sample impulse response (LAGS,) of its first or only linear stage."""

    record: Record
    impulse_response: Array


def impulse_response(natural: float = NATURAL, damping_ratio: float = DAMPING_RATIO, gain: float = GAIN) -> Array:
    """h(k) of a wn^2 / (s^2 + 2 zeta wn s + wn^2), per sample, (LAGS,), scaled to sum to ``gain``."""
    t = np.arange(LAGS) / RATE
    damped = natural * np.sqrt(1.0 - damping_ratio**2)
    h = np.exp(-damping_ratio * natural * t) * np.sin(damped * t)
    return gain * h / h.sum()


def white_input(*seed: int, n: int, cutoff_hz: float | None = None) -> Array:
    """Gaussian force (n + WARM,) of standard deviation 1.2, white or low-passed (Butterworth, order 8)."""
    values = generator(*seed).standard_normal(n + WARM)
    if cutoff_hz is not None:
        values = signal.sosfilt(signal.butter(8, cutoff_hz, fs=RATE, output="sos"), values)
    return INPUT_STD * values / np.std(values)


def filtered(h: Array, x: Array) -> Array:
    """Sum over k of h(k) x(n - k), sample by sample, with nothing before the first."""
    z = np.zeros(x.size)
    for n in range(x.size):
        for k in range(min(h.size, n + 1)):
            z[n] += h[k] * x[n - k]
    return z


def _finished(seed: tuple[int, ...], x: Array, y: Array, h: Array, snr_db: float | None) -> Cascade:
    x, y = x[WARM:], y[WARM:] + REST
    if snr_db is not None:
        y = y + noise(generator(*seed, 1), y, snr_db)
    return Cascade(Record(x, y, RATE), h)


def wiener(
    *seed: int, curve: str = "exponential", n: int = 2740, snr_db: float | None = None, cutoff_hz: float | None = None
) -> Cascade:
    """The linear stage, then the curve (LN)."""
    h = impulse_response()
    x = white_input(*seed, n=n, cutoff_hz=cutoff_hz)
    return _finished(seed, x, CURVES[curve](filtered(h, x)), h, snr_db)


def hammerstein(
    *seed: int, curve: str = "exponential", n: int = 2740, snr_db: float | None = None, cutoff_hz: float | None = None
) -> Cascade:
    """The curve, then the linear stage (NL)."""
    h = impulse_response()
    x = white_input(*seed, n=n, cutoff_hz=cutoff_hz)
    return _finished(seed, x, filtered(h, CURVES[curve](x)), h, snr_db)


def sandwich(
    *seed: int, curve: str = "exponential", n: int = 2740, snr_db: float | None = None, cutoff_hz: float | None = None
) -> Cascade:
    """A linear stage, the curve, and a faster linear stage (LNL); the whole memory is just under 80 samples."""
    h = impulse_response()
    second = impulse_response(3.0 * NATURAL, 0.7, 1.0)
    x = white_input(*seed, n=n, cutoff_hz=cutoff_hz)
    return _finished(seed, x, filtered(second, CURVES[curve](filtered(h, x))), h, snr_db)


def between_curves(
    *seed: int, curve: str = "exponential", n: int = 2740, snr_db: float | None = None, cutoff_hz: float | None = None
) -> Cascade:
    """The curve, the linear stage, and the curve again on 0.3 of that (NLN)."""
    h = impulse_response()
    x = white_input(*seed, n=n, cutoff_hz=cutoff_hz)
    return _finished(seed, x, CURVES[curve](0.3 * filtered(h, CURVES[curve](x))), h, snr_db)
