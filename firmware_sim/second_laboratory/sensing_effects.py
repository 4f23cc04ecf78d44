"""Effects between the motion and the recorded numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numba import njit
from scipy.signal import cont2discrete, lfilter

from firmware_sim.second_laboratory.effect import (
    Effect,
    Signals,
    TestMotion,
    chosen,
    log_uniform,
    pattern_of,
    smooth_noise,
)
from firmware_sim.second_laboratory.parameters import Floats


@dataclass(frozen=True)
class SensorNonlinearity(Effect):
    """Static error of the reading: a polynomial, the end of a transformer's range, or the periodic error of a scale.

    Sources: Doebelin, Measurement Systems (2004), 4.3; Heydemann, Appl. Opt. 20 (1981) 3382 (interpolation error).
    """

    name = "sensor_nonlinearity"
    stage = "sensing"
    largest = 8.0

    form: str
    error_m: float
    middle_m: float
    length_m: float
    phase_rad: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw an error of a tenth of the motion."""
        form = chosen(random, "polynomial", "end of range", "interpolation")
        middle = test.mean_m + test.swing_m * float(random.uniform(-1.0, 1.0))
        length = test.swing_m * log_uniform(random, 1.5, 4.0)
        error = test.swing_m * (0.1 if form != "interpolation" else 0.05) * float(random.choice([-1.0, 1.0]))
        return cls(1.0, form, error, middle, length, float(random.uniform(0.0, 2.0 * np.pi)))

    def change_motion(self, motion: Floats, step_s: float) -> Floats:
        """Add the error."""
        way = (motion - self.middle_m) / self.length_m
        if self.form == "polynomial":
            way = np.clip(way, -4.0, 4.0)
            error = 2.0 * way**2 + 0.7 * way**3
        elif self.form == "end of range":
            error = -2.0 * np.maximum(way, 0.0) ** 2 / (1.0 + np.maximum(way, 0.0)) * np.sign(self.error_m)
        else:
            error = np.sin(2.0 * np.pi * way + self.phase_rad)
        return motion + self.size * self.error_m * error


@dataclass(frozen=True)
class SensorLag(Effect):
    """Filter of the position's electronics: one pole, or two with little damping.

    Source: Doebelin, Measurement Systems (2004), 3.3.
    """

    name = "sensor_lag"
    stage = "sensing"
    largest = 20.0

    form: str
    time_s: float
    damping_ratio: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a delay of about one hold."""
        form = chosen(random, "first order", "second order")
        damping = float(random.uniform(0.5, 1.0))
        return cls(1.0, form, log_uniform(random, 0.5, 1.5) / test.sample_rate_hz, damping)

    def change_motion(self, motion: Floats, step_s: float) -> Floats:
        """Filter the motion, which is linear between the steps."""
        if self.size <= 0.0:
            return motion
        rate = 1.0 / (self.size * self.time_s)
        bottom = [1.0, rate] if self.form == "first order" else [1.0, 2.0 * self.damping_ratio * rate, rate**2]
        top, below, _ = cont2discrete(([bottom[-1]], bottom), step_s, "foh")
        return np.asarray(lfilter(np.ravel(top), below, motion - motion[0]) + motion[0])


@njit(cache=True)
def _played(motion: Floats, gap: float, creep: float) -> Floats:
    """Return the output of a play of half-width ``gap`` that creeps to the middle by the share ``creep`` per step."""
    out = np.empty(motion.size)
    at = motion[0]
    for k in range(motion.size):
        at += creep * (motion[k] - at)
        at = min(max(at, motion[k] - gap), motion[k] + gap)
        out[k] = at
    return out


@dataclass(frozen=True)
class SensorBacklash(Effect):
    """Play between probe and sensor: with friction the sensor stays, with a weak spring it creeps to the middle.

    Source: Nordin and Gutman, Automatica 38 (2002) 1633.
    """

    name = "sensor_backlash"
    stage = "sensing"
    largest = 20.0

    form: str
    gap_m: float
    creep_s: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a gap of a tenth of the motion."""
        form = chosen(random, "friction", "creep")
        return cls(1.0, form, 0.1 * test.swing_m, log_uniform(random, 0.02, 0.5) if form == "creep" else 0.0)

    def change_motion(self, motion: Floats, step_s: float) -> Floats:
        """Follow the motion with play."""
        creep = step_s / self.creep_s if self.form == "creep" else 0.0
        return np.asarray(_played(motion, self.size * self.gap_m, creep))


@dataclass(frozen=True)
class ClockSkew(Effect):
    """Position sampled by a slower clock, whose rate is constant or wanders.

    Sources: Moon, Skelly and Towsley, Proc. IEEE INFOCOM (1999) 227; IEEE Std 1139 (2008) (random walk of frequency).
    """

    name = "clock_skew"
    stage = "sensing"
    largest = 40.0

    form: str
    rate: float
    offset_s: float
    wander: float
    pattern: int

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a difference of about a hold at the end of the test."""
        form = chosen(random, "constant", "wandering")
        rate = log_uniform(random, 0.7, 2.0) / (test.sample_rate_hz * test.duration_s)
        offset = float(random.uniform(0.0, 0.3)) / test.sample_rate_hz
        return cls(1.0, form, rate, offset, float(random.uniform(0.2, 0.6)) * (form == "wandering"), pattern_of(random))

    def clock(self, times: Floats, number: int) -> Floats:
        """Return earlier times: the clock of the position is slow."""
        course = times.copy()
        if self.wander > 0.0:
            random = np.random.default_rng([self.pattern, number])
            noise = smooth_noise(random, times.size, float(times[1] - times[0]), 6.0 / float(times[-1]))
            course = np.cumsum(np.maximum(1.0 + self.wander * noise, 0.0)) * (times[1] - times[0])
        return np.maximum(times - self.size * (self.offset_s + self.rate * course), 0.0)


@dataclass(frozen=True)
class Quantization(Effect):
    """Coarse steps of the position: rounded, cut off, or with the hysteresis of a comparator.

    Source: Widrow and Kollar, Quantization Noise (2008), chapter 1.
    """

    name = "quantization"
    stage = "sensing"
    largest = 20.0

    form: str
    step_m: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw steps of a fifth of the motion's deviation."""
        return cls(1.0, chosen(random, "rounded", "cut off", "hysteresis"), 0.2 * test.swing_m)

    def change_readings(self, signals: Signals, times: Floats, number: int) -> Signals:
        """Quantise the position."""
        step = self.size * self.step_m
        if step <= 0.0:
            return signals
        position = signals["position"]
        if self.form == "hysteresis":
            held = _played(position, 0.25 * step, 0.0)
            return signals | {"position": step * np.round(held / step)}
        cut = np.floor(position / step) + 0.5 if self.form == "cut off" else np.round(position / step)
        return signals | {"position": step * cut}


@dataclass(frozen=True)
class DroppedSamples(Effect):
    """Samples lost without a mark, singly or in bursts: what follows moves up, the end stays empty (NaN).

    Source: Gilbert, Bell Syst. Tech. J. 39 (1960) 1253 (bursts).
    """

    name = "dropped_samples"
    stage = "sensing"
    largest = 30.0

    form: str
    losses: float
    burst: float
    pattern: int

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a few losses in the test."""
        form = chosen(random, "single", "bursts")
        return cls(1.0, form, 1.0, float(random.uniform(2.0, 6.0)) if form == "bursts" else 1.0, pattern_of(random))

    def change_readings(self, signals: Signals, times: Floats, number: int) -> Signals:
        """Leave samples out of every reading; command and time stay."""
        random = np.random.default_rng([self.pattern, number])
        count = round(self.size * self.losses)
        places = np.sort(random.uniform(0.15, 0.9, 64)[:count]) * times.size
        lengths = np.ones(64, int) if self.form == "single" else random.geometric(1.0 / self.burst, 64)
        lost = np.zeros(times.size, bool)
        for place, length in zip(places.astype(int), lengths, strict=False):
            lost[place : place + min(int(length), 20)] = True
        found = dict(signals)
        for name in ("voltage", "current", "position"):
            kept = signals[name][~lost]
            found[name] = np.append(kept, np.full(times.size - kept.size, np.nan))
        return found


SENSING: tuple[type[Effect], ...] = (
    SensorNonlinearity,
    SensorBacklash,
    SensorLag,
    ClockSkew,
    Quantization,
    DroppedSamples,
)
"""In the order in which a reading passes them."""
