"""A system whose linear answer, even and odd distortion and noise are known, by plain filters alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from tissueid.records import Record
from tissueid.stimuli.kinds.multisine import Multisine

Array = NDArray[np.float64]

RATE = 2000.0
LOW_N, HIGH_N = 0.5, 10.5
EVEN, ODD = 0.10, 0.06
NOISE, POLE = 0.01, 0.9
_AT_REST = 1000


@dataclass(frozen=True)
class Truth:
    """Root mean square over the driven band: even lines, all odd lines, detection lines alone, one period's noise."""

    even: float
    odd: float
    detection: float
    noise: float


@lru_cache(maxsize=64)
def played(multisine: Multisine) -> Array:
    return multisine.build().values


def answer(force: Array) -> Array:
    """Low-pass of 40 Hz on the force, plus a and b times the square and the cube of a 60 Hz low-pass, smoothed."""
    scaled = (force - 0.5 * (LOW_N + HIGH_N)) / 2.0
    seen = signal.lfilter(*signal.butter(1, 60.0, fs=RATE), scaled)
    bent = signal.lfilter(*signal.butter(1, 120.0, fs=RATE), EVEN * seen**2 + ODD * seen**3)
    return signal.sosfilt(signal.butter(2, 40.0, fs=RATE, output="sos"), scaled) + bent


def coloured(seed: int, n: int) -> Array:
    rng = np.random.default_rng([seed, 7])
    return NOISE * signal.lfilter([np.sqrt(1.0 - POLE**2)], [1.0, -POLE], rng.standard_normal(n + 500))[500:]


def recorded(multisine: Multisine) -> Record:
    """What a test records: preload at the mean, then the stimulus, with noise; the preload is cut off."""
    force = played(multisine)
    output = answer(np.concatenate([np.full(_AT_REST, force.mean()), force]))[_AT_REST:]
    return Record(force, output + coloured(multisine.seed, force.size), RATE)


def settled(multisine: Multisine) -> tuple[Array, Array]:
    """Spectra of a period of force and of its noise-free answer, after three periods of run-in."""
    period = multisine.period
    one = played(multisine)[-period:]
    return np.fft.rfft(one), np.fft.rfft(answer(np.tile(one, 4))[-period:])


def linear_answer(spec: Multisine, seeds: Sequence[int]) -> NDArray[np.complex128]:
    """Best linear approximation at the driven lines: noise-free answers to other phases, averaged."""
    lines = spec.driven_lines()
    pairs = [settled(spec.model_copy(update={"seed": seed})) for seed in seeds]
    u, y = (np.array([pair[k][lines] for pair in pairs]) for k in (0, 1))
    return np.mean(y * u.conj(), axis=0) / np.mean(np.abs(u) ** 2, axis=0)


def truth(specs: Sequence[Multisine], linear: NDArray[np.complex128]) -> Truth:
    """Levels of these very phases: noise-free answers less the linear one, and the noise from its filter."""
    driven, period = specs[0].driven_lines(), specs[0].period
    band = np.arange(driven[0], driven[-1] + 1)
    everywhere = np.interp(band, driven, linear.real) + 1j * np.interp(band, driven, linear.imag)
    power = np.zeros(band.size)
    for spec in specs:
        u, y = settled(spec)
        power += 2.0 * np.abs(y[band] - everywhere * u[band]) ** 2 / period**2 / len(specs)
    colour = np.abs(1.0 / (1.0 - POLE * np.exp(-2j * np.pi * np.arange(period) / period))) ** 2
    undriven = ~np.isin(band, driven)
    levels = [power[band % 2 == 0], power[band % 2 == 1], power[(band % 2 == 1) & undriven]]
    even, odd, detection = (float(np.sqrt(np.sum(level))) for level in levels)
    return Truth(even, odd, detection, NOISE * float(np.sqrt(2.0 * colour[band].sum() / colour.sum())))


def decibels(ratio: float) -> float:
    return 20.0 * float(np.log10(ratio))
