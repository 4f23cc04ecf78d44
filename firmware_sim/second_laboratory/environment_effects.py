"""Effects of the environment: mains and body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

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
class MainsHum(Effect):
    """Pick-up at 50 or 60 Hz with harmonics and a slow amplitude modulation, by channel.

    Source: Levkov, Mihov, Ivanov, Daskalov, Christov and Dotsinsky, BioMed. Eng. OnLine 4 (2005) 50.
    """

    name = "mains_hum"
    stage = "environment"
    largest = 20.0

    rate_hz: float
    volts: float
    amperes: float
    metres: float
    third: float
    fifth: float
    modulation: float
    pattern: int

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw up to a tenth of each signal's deviation."""
        rate = float(random.choice([50.0, 60.0])) * (1.0 + 2e-4 * float(random.standard_normal()))
        shares = 0.1 * random.uniform(0.1, 1.0, 3)
        third, fifth = float(random.uniform(0.0, 0.5)), float(random.uniform(0.0, 0.3))
        volts, amperes, metres = shares * [test.volts, test.current_a, test.swing_m]
        return cls(
            1.0,
            rate,
            float(volts),
            float(amperes),
            float(metres),
            third,
            fifth,
            float(random.uniform(0.0, 0.4)),
            pattern_of(random),
        )

    def change_readings(self, signals: Signals, times: Floats, number: int) -> Signals:
        """Add the hum to voltage, current and position; it begins each test at another phase."""
        random = np.random.default_rng([self.pattern, number])
        swell = smooth_noise(random, times.size, float(times[1] - times[0]), 4.0)
        begin = float(random.uniform(0.0, 2.0 * np.pi))
        shift = np.random.default_rng(self.pattern).uniform(0.0, 2.0 * np.pi, (3, 3))
        found = dict(signals)
        sizes = {"voltage": self.volts, "current": self.amperes, "position": self.metres}
        for k, (name, size) in enumerate(sizes.items()):
            angle = 2.0 * np.pi * self.rate_hz * times + begin
            wave = np.sin(angle + shift[k, 0])
            wave += self.third * np.sin(3.0 * angle + shift[k, 1]) + self.fifth * np.sin(5.0 * angle + shift[k, 2])
            found[name] = signals[name] + self.size * size * (1.0 + self.modulation * swell) * wave
        return found


@dataclass(frozen=True)
class PhysiologicalMotion(Effect):
    """Breathing and pulse of irregular rate, and tremor, which move the surface.

    Sources: McSharry, Clifford, Tarassenko and Smith, IEEE Trans. Biomed. Eng. 50 (2003) 289 (irregular rate);
    McAuley and Marsden, Brain 123 (2000) 1545 (tremor).
    """

    name = "physiological_motion"
    stage = "environment"
    largest = 12.0

    form: str
    breathing_m: float
    breathing_hz: float
    pulse_m: float
    pulse_hz: float
    tremor_m: float
    tremor_hz: float
    irregularity: float
    pattern: int

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw a motion of a third of the probe's, with one of the three parts leading."""
        form = chosen(random, "breathing", "pulse", "tremor")
        parts = {"breathing": 0.1, "pulse": 0.05, "tremor": 0.02} | {form: 1.0}
        scale = 0.3 * test.swing_m * (0.5 if form == "tremor" else 1.0)
        return cls(
            1.0,
            form,
            scale * parts["breathing"],
            float(random.uniform(0.2, 0.35)),
            scale * parts["pulse"],
            float(random.uniform(0.9, 1.6)),
            scale * parts["tremor"],
            log_uniform(random, 5.0, 11.0),
            float(random.uniform(0.05, 0.25)),
            pattern_of(random),
        )

    def move_surface(self, times: Floats, number: int) -> Floats:
        """Return the motion, which begins at zero."""
        random = np.random.default_rng([self.pattern, number])
        # Nodes 2 ms apart, whatever the step: cubic between them would change nothing below 20 Hz.
        nodes = np.arange(0.0, float(times[-1]) + 4e-3, 2e-3)

        def phase(rate_hz: float) -> Floats:
            wander = smooth_noise(random, nodes.size, 2e-3, 2.0 * np.pi * rate_hz * 0.3)
            steps = 2.0 * np.pi * rate_hz * 2e-3 * np.maximum(1.0 + self.irregularity * wander, 0.2)
            return np.asarray(random.uniform(0.0, 2.0 * np.pi) + np.cumsum(steps))

        breath = phase(self.breathing_hz)
        moved = self.breathing_m * (np.sin(breath) + 0.25 * np.sin(2.0 * breath + 0.8))
        beat = phase(self.pulse_hz)
        moved += self.pulse_m * (np.sin(beat) + 0.5 * np.sin(2.0 * beat + 0.6) + 0.2 * np.sin(3.0 * beat + 1.1))
        swell = 1.0 + 0.4 * smooth_noise(random, nodes.size, 2e-3, 6.0)
        moved += self.tremor_m * swell * np.sin(phase(self.tremor_hz))
        from scipy.interpolate import CubicSpline

        return np.asarray(self.size * CubicSpline(nodes, moved - moved[0])(times))


ENVIRONMENT: tuple[type[Effect], ...] = (MainsHum, PhysiologicalMotion)
