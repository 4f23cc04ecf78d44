"""What an effect can change on the way from command to recorded numbers, and what it may know of the test.

Every effect is a frozen dataclass whose ``size`` scales its law: at zero the law vanishes. Geometry is drawn relative
to the motion that the same test has without any effect (``TestMotion``), never in fixed millimetres.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from firmware_sim.second_laboratory.parameters import Floats, PlantModel

Signals = dict[str, Floats]


@dataclass(frozen=True)
class TestMotion:
    """The main test of a session without effects: the scales to which an effect is drawn.

    Swing, speed, current and volts are standard deviations during the stimulus.
    """

    __test__: ClassVar[bool] = False

    duration_s: float
    sample_rate_hz: float
    surface_m: float
    mean_m: float
    swing_m: float
    speed_m_s: float
    current_a: float
    current_mean_a: float
    volts_mean: float
    volts: float
    volts_rate: float
    """Standard deviation of the change of the command from hold to hold, V/s."""
    force_n: float
    """Standard deviation of the force of the coil."""
    plant: dict[str, float]
    """Parameters of the plant without effects."""

    @property
    def depth_m(self) -> float:
        """Mean depth in the tissue."""
        return max(self.mean_m - self.surface_m, self.swing_m)

    @property
    def stiffness_n_per_m(self) -> float:
        """Stiffness of the tissue at the mean depth."""
        rate = self.plant["stiffness_rate_per_m"] * self.depth_m
        return self.plant["stiffness_n_per_m"] * float(np.exp(rate)) * (1.0 + rate)


@dataclass(frozen=True)
class Effect:
    """One effect of a drawn form and size."""

    name: ClassVar[str]
    stage: ClassVar[str]
    listed: ClassVar[bool] = True
    largest: ClassVar[float] = 1e3
    """Largest plausible size."""
    fixed_size: ClassVar[bool] = False
    """Whether the test, not the size, decides how large the gap is."""

    size: float

    @classmethod
    def draw(cls, random: np.random.Generator, test: TestMotion) -> Self:
        """Draw the form and all values, at size 1."""
        raise NotImplementedError

    def sized(self, size: float) -> Self:
        """Return the same effect at another size."""
        return replace(self, size=size)

    def figures(self) -> dict[str, Any]:
        """Return the values for the label."""
        return asdict(self)

    def change_command(self, command: Floats, times: Floats, number: int) -> Floats:
        """Return the command that the amplifier receives in each hold, V, in test ``number``."""
        return command

    def change_voltage(self, volts: tuple[Floats, Floats], step_s: float, number: int) -> tuple[Floats, Floats]:
        """Return the voltage at the beginning and end of every step."""
        return volts

    def change_plant(self, plant: PlantModel, step_s: float) -> None:
        """Set parameters and tables of the plant."""

    def move_surface(self, times: Floats, number: int) -> Floats:
        """Return how far the surface is moved at these times, m."""
        return np.zeros(times.size)

    def change_motion(self, motion: Floats, step_s: float) -> Floats:
        """Return what the position sensor reads of the motion at the ends of all steps."""
        return motion

    def clock(self, times: Floats, number: int) -> Floats:
        """Return when the position is read that is recorded for these times."""
        return times

    def change_readings(self, signals: Signals, times: Floats, number: int) -> Signals:
        """Return the recorded signals; called after the noise is added."""
        return signals


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def chosen(random: np.random.Generator, *forms: str) -> str:
    """Draw one of the forms with equal probability."""
    return forms[int(random.integers(len(forms)))]


def pattern_of(random: np.random.Generator) -> int:
    """Draw the seed of a pattern in time, so that an effect stays the same at every size."""
    return int(random.integers(1, 2**31))


def smooth_noise(random: np.random.Generator, count: int, interval: float, rate: float) -> Floats:
    """Return a smooth random walk of deviation near 1: white noise twice low-passed at ``rate`` (rad/s)."""
    from scipy.signal import lfilter

    decay = float(np.exp(-rate * interval))
    found = random.standard_normal(count)
    for _ in range(2):
        found = lfilter([1.0 - decay], [1.0, -decay], found)
    return np.asarray(found / (np.std(found) + 1e-30))
