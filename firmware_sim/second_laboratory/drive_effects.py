"""Effects between the command and the voltage of the coil."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.signal import bessel, butter, cont2discrete, lfilter

from firmware_sim.second_laboratory.effect import Effect, TestMotion, chosen, log_uniform, pattern_of, smooth_noise
from firmware_sim.second_laboratory.parameters import Floats


@dataclass(frozen=True)
class Latency(Effect):
    """Delay of every update: constant, or with jitter from update to update as on a shared bus.

    Source: Nilsson, Real-Time Control Systems with Delays, Lund (1998), chapter 2.
    """

    name = "latency"
    stage = "drive"
    largest = 12.0

    form: str
    delay_s: float
    jitter: float
    pattern: int

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw about one hold of delay."""
        form = chosen(random, "constant", "jitter")
        jitter = float(random.uniform(0.05, 0.2)) if form == "jitter" else 0.0
        return cls(1.0, form, log_uniform(random, 0.7, 1.5) / test.sample_rate_hz, jitter, pattern_of(random))

    def change_voltage(self, volts: tuple[Floats, Floats], step_s: float, number: int) -> tuple[Floats, Floats]:
        """Delay each step by its own whole number of steps; the first value has been held before."""
        before, after = volts
        count = before.size
        blocks = np.random.default_rng([self.pattern, number]).standard_normal(count // 20 + 1)
        late = self.size * self.delay_s * (1.0 + self.jitter * np.repeat(np.clip(blocks, -2, 2), 20)[:count])
        source = np.arange(count) - np.round(late / step_s).astype(int)
        held = before[0]
        return (
            np.where(source >= 0, before[np.maximum(source, 0)], held),
            np.where(source >= 0, after[np.maximum(source, 0)], held),
        )


@dataclass(frozen=True)
class AmplifierLag(Effect):
    """Low-pass of the power stage: one pole, Bessel of second order, or Butterworth of second order.

    Source: Thomson, Proc. IEE 96 III (1949) 487 (the Bessel filter).
    """

    name = "amplifier_lag"
    stage = "drive"
    largest = 12.0

    form: str
    time_s: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a time constant of a fraction of a hold."""
        form = chosen(random, "one pole", "bessel", "butterworth")
        return cls(1.0, form, log_uniform(random, 0.4, 1.2) / test.sample_rate_hz)

    def change_voltage(self, volts: tuple[Floats, Floats], step_s: float, number: int) -> tuple[Floats, Floats]:
        """Filter the held voltage exactly, from the state in which the first value has been held."""
        before, after = volts
        if self.size <= 0.0:
            return volts
        rate = 1.0 / (self.size * self.time_s)
        if self.form == "one pole":
            system = ([rate], [1.0, rate])
        else:
            system = (bessel if self.form == "bessel" else butter)(2, rate, analog=True)
        top, bottom, _ = cont2discrete(system, step_s, "zoh")
        driven = 0.5 * (before + after) - before[0]
        found = lfilter(np.ravel(top), bottom, np.append(driven, driven[-1])) + before[0]
        return found[:-1], found[1:]


@dataclass(frozen=True)
class AmplifierClipping(Effect):
    """Limited swing, asymmetric: hard, hyperbolic tangent, or the algebraic limiter of solid-state amplifiers.

    Source: Rapp, Proc. 2nd European Conf. on Satellite Communications (1991) 179.
    """

    name = "amplifier_clipping"
    stage = "drive"
    largest = 4.0

    form: str
    up_v: float
    down_v: float
    from_v: float
    smoothness: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw limits about two deviations from the mean command."""
        form = chosen(random, "hard", "tanh", "algebraic")
        up, down = (test.volts * float(random.uniform(1.2, 2.2)) for _ in range(2))
        return cls(1.0, form, up, down, test.volts_mean, float(random.uniform(2.0, 6.0)))

    def change_command(self, command: Floats, times: Floats, number: int) -> Floats:
        """Limit the swing about the mean command; the limits widen as the size falls."""
        swing = command - self.from_v
        limit = np.where(swing >= 0.0, self.up_v, self.down_v) / max(self.size, 1e-9)
        if self.form == "hard":
            limited = np.clip(swing, -limit, limit)
        elif self.form == "tanh":
            limited = limit * np.tanh(swing / limit)
        else:
            ratio = np.abs(swing / limit) ** self.smoothness
            limited = swing / (1.0 + ratio) ** (1.0 / self.smoothness)
        return self.from_v + limited


@dataclass(frozen=True)
class AmplifierDeadband(Effect):
    """Crossover of an under-biased output stage: smooth loss of gain round zero voltage.

    Source: Self, Audio Power Amplifier Design (2013), chapter on crossover distortion.
    """

    name = "amplifier_deadband"
    stage = "drive"
    largest = 20.0

    form: str
    width_v: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a width of a fraction of the command's deviation."""
        return cls(1.0, chosen(random, "tanh", "rational"), test.volts * log_uniform(random, 0.1, 0.3))

    def change_command(self, command: Floats, times: Floats, number: int) -> Floats:
        """Take the dead part away."""
        width = max(self.size * self.width_v, 1e-12)
        if self.form == "tanh":
            return command - width * np.tanh(command / width)
        kept: Floats = np.abs(command) ** 3
        return command * kept / (kept + width**3)


@dataclass(frozen=True)
class AmplifierDrift(Effect):
    """Gain or offset that moves in the test: thermal exponential, smooth random walk, or a few steps.

    Source: IEEE Std 952 (1997), annex B (random walk and drift of an instrument's output).
    """

    name = "amplifier_drift"
    stage = "drive"
    largest = 8.0

    form: str
    of: str
    change: float
    time_s: float
    pattern: int

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a change of a few percent, of the mean command for an offset."""
        form, of = chosen(random, "thermal", "walk", "steps"), chosen(random, "gain", "offset")
        change = log_uniform(random, 0.04, 0.12) * float(random.choice([-1.0, 1.0]))
        change *= 1.0 if of == "gain" else test.volts
        return cls(1.0, form, of, change, test.duration_s * float(random.uniform(0.2, 0.8)), pattern_of(random))

    def change_command(self, command: Floats, times: Floats, number: int) -> Floats:
        """Change gain or offset along the test."""
        random = np.random.default_rng([self.pattern, number])
        if self.form == "thermal":
            course = 1.0 - np.exp(-times / self.time_s)
        elif self.form == "walk":
            course = smooth_noise(random, times.size, float(times[1] - times[0]), 6.0 / self.time_s)
            course = course - course[0]
        else:
            places = np.sort(random.uniform(0.1, 0.9, int(random.integers(1, 4)))) * times[-1]
            heights = random.uniform(0.4, 1.0, places.size)
            course = np.sum([height * (times >= place) for place, height in zip(places, heights, strict=True)], axis=0)
        moved = self.size * self.change * course
        return command * (1.0 + moved) if self.of == "gain" else command + moved


DRIVE: tuple[type[Effect], ...] = (AmplifierDrift, AmplifierDeadband, AmplifierClipping, Latency, AmplifierLag)
"""In the order in which a signal passes them."""
