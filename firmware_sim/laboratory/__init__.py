"""Laboratory: complete tests on the plant with effects, simulated in process, as a rig would record them.

A test starts with the probe at rest at the surface and the current of the first command in the coil. The tissue acts on
both sides of its surface unless ``contact_loss`` is active, and only ``end_stop`` limits the stroke. Readings are taken
at the end of each command's hold, unfiltered, with white noise and quantization.

``python -m firmware_sim.laboratory --help`` generates scenarios and writes their records: see ``drawing``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from firmware_sim import kernel
from firmware_sim.effects.active_effects import ActiveEffects
from firmware_sim.effects.base import DrawConditions, Effect
from firmware_sim.effects.sensing import DroppedSamples, Quantization
from firmware_sim.plant import SAMPLE_RATE_HZ, PlantParameters
from firmware_sim.tissue import Exponential, Tissue

Array = NDArray[np.float64]
Kind = Literal["quiet", "stochastic", "slow_ramp", "spring"]
SIGNALS = ("time", "command", "voltage", "current", "position", "temperature")
PRELOAD_S = 0.5
SPRING_SURFACE_M = 0.012
SUBSTEPS = 20
AMBIENT_DEGC = 25.0
GREATEST_COMMAND_V = 46.0
CUTOFF_HZ = 200.0

_SAMPLES, _QUIET_SAMPLES = 9000, 3000
_NOISE = {"voltage": 2.0e-3, "current": 0.95e-3, "position": 1.9e-6}
_STEPS = {"voltage": 50.0 / 32768.0, "current": 5.0 / 32768.0, "position": 0.032 / 65536.0}
_NOT_ON_A_SPRING = ("physiological_motion",)


@dataclass(frozen=True)
class BaselineParameters:
    """True parameters of device, tissue and spring, and of the stimulus, SI.

    The tissue has the stiffness K0 exp(gK d) N/m and damping B0 exp(gB d) N s/m at a depth d, and a mass. ``weight_n``
    is the weight of the moving part along the stroke, into the tissue.

    Raises:
        ValueError: a parameter is not finite, or not positive where it must be.
    """

    resistance_ohm: float = 12.0
    inductance_h: float = 1e-3
    force_constant_n_per_a: float = 3.0
    moving_mass_kg: float = 0.060
    bearing_damping_n_s_per_m: float = 3.5
    amplifier_gain: float = 1.0
    weight_n: float = 0.0
    stiffness_n_per_m: float = 300.0
    stiffness_rate_per_m: float = 300.0
    damping_n_s_per_m: float = 5.0
    damping_rate_per_m: float = 150.0
    tissue_mass_kg: float = 0.01
    surface_m: float = 0.010
    spring_n_per_m: float = 1000.0
    spring_mass_kg: float = 0.006
    spring_damping_n_s_per_m: float = 0.5
    mean_v: float = 16.0
    spread_v: float = 10.3

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            free = item.name in ("weight_n", "mean_v", "stiffness_rate_per_m", "damping_rate_per_m")
            may_be_zero = free or item.name in ("tissue_mass_kg", "spring_mass_kg", "spring_damping_n_s_per_m")
            if not np.isfinite(value) or not (free or value > 0 or (may_be_zero and value == 0)):
                raise ValueError(f"the laboratory's {item.name} must be finite and positive, not {value}")

    @property
    def depth_m(self) -> float:
        """Equilibrium depth under the mean command, m."""
        force = self.force_constant_n_per_a * self.amplifier_gain * self.mean_v / self.resistance_ohm + self.weight_n
        depth = 1e-3
        for _ in range(60):
            rise = self.stiffness_rate_per_m * depth
            law = self.stiffness_n_per_m * np.exp(rise)
            depth -= float((law * depth - force) / (law * (1.0 + rise)))
        return depth

    def circumstances(self) -> DrawConditions:
        """Return the conditions for drawing effects."""
        return DrawConditions(self.surface_m, self.depth_m, 5e-4, self.mean_v, self.spread_v)


@dataclass(frozen=True)
class Recording:
    """A recorded test: arrays of shape (n,), s, V, V, A, m, degC, and the position of the surface, m."""

    kind: Kind
    surface_m: float
    time: Array
    command: Array
    voltage: Array
    current: Array
    position: Array
    temperature: Array

    def stacked(self) -> Array:
        """Return all signals in the order of ``SIGNALS``, shape (6, n)."""
        return np.stack([getattr(self, name) for name in SIGNALS])


class Laboratory:
    """Records the tests of one session in sequence; the same calls give the same records.

    ``effects`` are active in every test, those of tissue not on the spring. With ``clean`` there is neither noise nor
    quantization; effects on the readings remain.
    """

    def __init__(
        self,
        effects: Iterable[Effect] = (),
        seed: int = 0,
        *,
        figures: BaselineParameters | None = None,
        clean: bool = False,
        substeps: int = SUBSTEPS,
    ) -> None:
        self.figures = figures or BaselineParameters()
        self.effects = ActiveEffects(effects).effects
        self.clean = clean
        self._seed = seed
        self._substeps = substeps
        self._tests = 0
        self._session_s = float(np.random.default_rng([seed, 7]).uniform(0.0, 50.0))

    def record(self, kind: Kind, command: Array) -> Recording:
        """Record a test of this kind with commands, shape (n,), volts, one per sample at 2 kHz.

        Raises:
            ValueError: there is no such kind, or the commands are empty, not finite or have more than one dimension.
        """
        if kind not in ("quiet", "stochastic", "slow_ramp", "spring"):
            raise ValueError(f"unknown kind of test {kind!r}; known: quiet, stochastic, slow_ramp, spring")
        volts = np.ascontiguousarray(command, dtype=np.float64)
        if volts.ndim != 1 or volts.size == 0 or not np.all(np.isfinite(volts)):
            raise ValueError("a test's commands must be finite volts in one dimension, one or more")
        self._tests += 1
        random = np.random.default_rng([self._seed, 11, self._tests])
        true = self._figures()
        plant = true.to_array()
        plant[kernel.STOP_STIFFNESS] = 0.0
        tissue = self._tissue(kind)
        state = np.zeros(kernel.STATE_SIZE)
        state[kernel.CURRENT] = true.amplifier_gain * volts[0] / true.resistance_ohm
        state[kernel.POSITION] = state[kernel.SURFACE] = tissue.surface_m
        state[kernel.TEMPERATURE] = state[kernel.SENSOR] = AMBIENT_DEGC
        state[kernel.TOUCHING] = 1.0
        acting = ActiveEffects(self._at_work(kind), self._session_s)
        figures = np.concatenate([plant, np.zeros(4)])
        interval = 1.0 / SAMPLE_RATE_HZ
        _, seen = acting.advance(volts, state, figures, tissue.to_array(), interval, self._substeps)
        self._session_s += volts.size * interval + float(random.uniform(5.0, 40.0))
        signals = self._read(seen, random)
        return Recording(
            kind,
            tissue.surface_m,
            np.arange(volts.size, dtype=np.float64) * interval,
            volts,
            signals["voltage"],
            signals["current"],
            signals["position"],
            np.full(volts.size, AMBIENT_DEGC),
        )

    def _figures(self) -> PlantParameters:
        own = self.figures
        return PlantParameters(
            resistance_ohm=own.resistance_ohm,
            inductance_h=own.inductance_h,
            force_constant_n_per_a=own.force_constant_n_per_a,
            moving_mass_kg=own.moving_mass_kg,
            bearing_damping_n_s_per_m=own.bearing_damping_n_s_per_m,
            gravity_force_n=own.weight_n,
            amplifier_gain=own.amplifier_gain,
            ambient_degc=AMBIENT_DEGC,
        )

    def _tissue(self, kind: Kind) -> Tissue:
        own = self.figures
        if kind == "spring":
            return Tissue(
                name="spring",
                kind="linear",
                surface_m=SPRING_SURFACE_M,
                mass=Exponential(own.spring_mass_kg),
                damping=Exponential(own.spring_damping_n_s_per_m),
                stiffness=Exponential(own.spring_n_per_m),
            )
        return Tissue(
            name="tissue",
            kind="dpn",
            surface_m=own.surface_m,
            mass=Exponential(own.tissue_mass_kg),
            damping=Exponential(own.damping_n_s_per_m, own.damping_rate_per_m),
            stiffness=Exponential(own.stiffness_n_per_m, own.stiffness_rate_per_m),
        )

    def _at_work(self, kind: Kind) -> tuple[Effect, ...]:
        if kind != "spring":
            return self.effects
        return tuple(e for e in self.effects if e.stage != "tissue" and e.name not in _NOT_ON_A_SPRING)

    def _read(self, seen: Array, random: np.random.Generator) -> dict[str, Array]:
        signals = {name: seen[:, k].copy() for k, name in enumerate(("voltage", "current", "position"))}
        noise = random.standard_normal(seen.shape)
        if not self.clean:
            for k, name in enumerate(signals):
                noisy = signals[name] + _NOISE[name] * noise[:, k]
                signals[name] = _STEPS[name] * np.rint(noisy / _STEPS[name])
        for effect in self.effects:
            if isinstance(effect, Quantization):
                signals["position"] = effect.applied(signals["position"])
            if isinstance(effect, DroppedSamples):
                kept = np.array(effect.kept(seen.shape[0], SAMPLE_RATE_HZ, random), dtype=np.intp)
                for name in signals if effect.channels == "all" else ("position",):
                    slipped = np.full(seen.shape[0], np.nan)
                    slipped[: kept.size] = signals[name][kept]
                    signals[name] = slipped
        return signals


@dataclass(frozen=True)
class PlannedTest:
    """A test of a session: its kind, seed, scale and mean of its stimulus, V, and the test that it repeats."""

    kind: Kind
    seed: int
    mean_v: float
    scale_v: float
    repeats: int | None = None

    def command(self, session_seed: int) -> Array:
        """Return commands, V, shape (9000,), or (3000,) for a quiet test."""
        if self.kind == "quiet":
            return np.zeros(_QUIET_SAMPLES)
        preload = round(PRELOAD_S * SAMPLE_RATE_HZ)
        count = _SAMPLES - preload
        if self.kind == "slow_ramp":
            cycle = np.arange(count) / SAMPLE_RATE_HZ / 2.0
            shape = 1.6 * (1.0 - 4.0 * np.abs((cycle + 0.25) % 1.0 - 0.5))
        else:
            shape = _low_passed(np.random.default_rng([session_seed, 23, self.seed]), count)
        played = self.mean_v + self.scale_v * np.concatenate([np.zeros(preload), shape])
        return np.clip(played, -GREATEST_COMMAND_V, GREATEST_COMMAND_V)

    def stimulus(self) -> dict[str, object]:
        """Return the description of the stimulus as in the session format."""
        return {"type": "uniform", "cutoff_hz": CUTOFF_HZ, "offset_v": self.mean_v, "scale_v": self.scale_v}


def _low_passed(random: np.random.Generator, count: int) -> Array:
    # Uniform noise, low-passed by eight poles, of mean 0 and standard deviation 1.
    settled = 500
    poles = butter(8, CUTOFF_HZ, fs=SAMPLE_RATE_HZ, output="sos")
    filtered = np.asarray(sosfilt(poles, random.uniform(-1.0, 1.0, settled + count)))[settled:]
    return np.asarray((filtered - filtered.mean()) / filtered.std())


def plan(figures: BaselineParameters, *, full: bool) -> tuple[PlannedTest, ...]:
    """Return the tests of a session: one stochastic test, or the full series."""
    mean, scale = figures.mean_v, figures.spread_v
    standard = PlannedTest("stochastic", 1, mean, scale)
    if not full:
        return (standard,)
    return (
        PlannedTest("quiet", 0, mean, 0.0),
        standard,
        PlannedTest("stochastic", 1, mean, scale, repeats=2),
        PlannedTest("stochastic", 2, mean, 0.6 * scale),
        PlannedTest("slow_ramp", 0, mean, scale),
        PlannedTest("spring", 3, 0.0, 0.8 * scale),
    )
