"""Stimuli of the second laboratory: courses of zero mean and unit deviation, made again by their seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, cheby1, sosfilt

from firmware_sim.second_laboratory.effect import chosen
from firmware_sim.second_laboratory.parameters import Floats

KINDS = ("gaussian", "binary", "ternary", "multisine", "laplacian", "steps and noise", "chirp")
MOST = 3.2
"""Largest value of a course, in deviations."""


@dataclass(frozen=True)
class Stimulus:
    """A kind of course up to ``cutoff_hz``; ``order`` and ``ripple`` are those of the filter of noise."""

    kind: str
    cutoff_hz: float
    order: int
    ripple: bool

    def course(self, samples: int, sample_rate_hz: float, seed: int) -> Floats:
        """Return the course, shape (samples,)."""
        random = np.random.default_rng([seed, 77])
        times = np.arange(samples) / sample_rate_hz
        found = _COURSES[self.kind](self, random, times, sample_rate_hz)
        found = np.clip((found - found.mean()) / found.std(), -MOST, MOST)
        return np.asarray(found - found.mean())

    def filtered(self, noise: Floats, sample_rate_hz: float) -> Floats:
        """Return noise through the low-pass, without its first transient."""
        band = self.cutoff_hz / (0.5 * sample_rate_hz)
        sos = cheby1(self.order, 1.0, band, output="sos") if self.ripple else butter(self.order, band, output="sos")
        return np.asarray(sosfilt(sos, noise))


def _gaussian(shape: Stimulus, random: np.random.Generator, times: Floats, rate: float) -> Floats:
    return shape.filtered(random.standard_normal(times.size), rate)


def _laplacian(shape: Stimulus, random: np.random.Generator, times: Floats, rate: float) -> Floats:
    return shape.filtered(random.laplace(size=times.size), rate)


def _held(shape: Stimulus, random: np.random.Generator, times: Floats, rate: float, levels: list[float]) -> Floats:
    hold = max(1, round(rate / (2.0 * shape.cutoff_hz)))
    values = random.choice(levels, times.size // hold + 1)
    return np.repeat(values, hold)[: times.size]


def _binary(shape: Stimulus, random: np.random.Generator, times: Floats, rate: float) -> Floats:
    return _held(shape, random, times, rate, [-1.0, 1.0])


def _ternary(shape: Stimulus, random: np.random.Generator, times: Floats, rate: float) -> Floats:
    return _held(shape, random, times, rate, [-1.0, 0.0, 1.0])


def _multisine(shape: Stimulus, random: np.random.Generator, times: Floats, rate: float) -> Floats:
    lines = np.unique(np.geomspace(1.0, shape.cutoff_hz * times[-1], 60).astype(int))
    phases = random.uniform(0.0, 2.0 * np.pi, lines.size)
    return np.asarray(np.sum(np.cos(2.0 * np.pi * lines[:, None] * times / times[-1] + phases[:, None]), axis=0))


def _steps(shape: Stimulus, random: np.random.Generator, times: Floats, rate: float) -> Floats:
    length = max(1, round(0.12 * rate))
    steps = np.repeat(random.uniform(-1.5, 1.5, times.size // length + 1), length)[: times.size]
    noise = shape.filtered(random.standard_normal(times.size), rate)
    return np.asarray(steps + 0.5 * noise / noise.std())


def _chirp(shape: Stimulus, random: np.random.Generator, times: Floats, rate: float) -> Floats:
    # Exponential sweeps up to the cutoff, one after the other, with a little noise so that no phase repeats.
    length = times[-1] / float(random.integers(1, 4))
    low, high = 1.0, shape.cutoff_hz
    way = np.mod(times, length)
    speed = np.log(high / low) / length
    angle = 2.0 * np.pi * low * np.expm1(speed * way) / speed
    noise = shape.filtered(random.standard_normal(times.size), rate)
    return np.asarray(np.sin(angle + float(random.uniform(0.0, 6.28))) + 0.2 * noise / noise.std())


_COURSES = dict(zip(KINDS, (_gaussian, _binary, _ternary, _multisine, _laplacian, _steps, _chirp), strict=True))


def draw_stimulus(random: np.random.Generator, natural_hz: float, sample_rate_hz: float) -> Stimulus:
    """Draw a stimulus that goes beyond the natural frequency of probe and tissue."""
    cutoff = min(natural_hz * float(random.uniform(3.0, 10.0)), sample_rate_hz / 6.0)
    return Stimulus(chosen(random, *KINDS), cutoff, int(random.integers(2, 6)), bool(random.random() < 0.4))


def slow_ramp(samples: int) -> Floats:
    """Return two triangles between -1 and 1 that begin and end at 0, shape (samples,)."""
    return np.asarray(np.interp(np.linspace(0.0, 2.0, samples), [0, 0.25, 0.75, 1.25, 1.75, 2], [0, 1, -1, 1, -1, 0]))
