"""Scenarios of people: forearm and upper arm presets on the simulated instrument, with hidden instrument effects.

The tissue is a preset with its own effects. Instrument, filters, converters and end stops are those of
``firmware_sim.plant`` and ``firmware_sim.converters``. Every test begins at rest, with the probe on the skin under its
weight. ``labels.json`` states for each effect whether it belongs to the preset or is hidden.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from firmware_sim.converters import CHANNELS, Converters
from firmware_sim.effects import EFFECTS, LISTED, in_order
from firmware_sim.effects.base import DrawConditions, Effect
from firmware_sim.effects.sensing import DroppedSamples, Quantization
from firmware_sim.laboratory import PRELOAD_S, SPRING_SURFACE_M, Kind, Recording
from firmware_sim.laboratory.session_content import CALIBRATION_UNCERTAINTY, NOMINAL, described
from firmware_sim.plant import SAMPLE_RATE_HZ, STANDARD_GRAVITY, Plant, PlantParameters
from firmware_sim.presets import load_preset, preset_names
from firmware_sim.tissue import Exponential, Tissue

Array = NDArray[np.float64]

SITES = tuple(name for name in preset_names() if name.endswith("arm") and load_preset(name).kind == "dpn")
"""Presets of the skin of forearm and upper arm."""
PRESET_EFFECTS = {
    "contact": "contact_loss",
    "directional_damping": "directional_damping",
    "relaxation": "viscoelasticity",
    "recruited_mass": "added_mass",
}
"""Effect of the contract for each extra of a preset."""
HIDDEN = tuple(name for name in LISTED if EFFECTS[name].stage != "tissue")
"""Listed effects of the instrument and its environment."""
MOST_HIDDEN = 2
SURFACE_ERROR_M = 0.25e-3
"""Standard deviation of the surface position that a guided test finds."""
GRAVITY_NOISE_M_S2 = 0.1
"""Standard deviation of measured gravity: the offset of the accelerometer, the same in all tests of a session."""
LOWEST_N, HIGHEST_N = (-5.0, -1.0), (8.0, 11.8)
"""Limits of the smallest and largest force; the widest range is that of ``tissueid demo``."""
RAMP_LOWEST_N = 0.5
"""Smallest force of the slow ramp, which keeps the probe on the skin."""
CUTOFF_HZ = (80.0, 200.0)
DRIFT = 0.05
"""Relative standard deviation of each tissue parameter from one session of a person to the next."""
PRELOAD_CHANGE_N = 0.3
"""Standard deviation of the change of the mean load from one session to the next."""
SURFACE_CHANGE_M = 1e-3
"""Largest displacement of the surface along the stroke from one session to the next."""
MOST_TILT_RAD = 0.2
"""Largest tilt of the stroke from the vertical in a later session."""
LATER_SESSIONS = 4
"""Number of later sessions of each person."""

_CHANNELS = CHANNELS[:5]
_SAMPLES, _QUIET_SAMPLES = 9000, 3000
_RISE_S = 0.05
_VOLTS_PER_NEWTON = 12.0 / 3.0
_NOT_ON_A_SPRING = ("physiological_motion",)


@dataclass(frozen=True)
class ForceTest:
    """A test of a session: its kind, seed, force range, N, cutoff of the noise, Hz, and the test that it repeats.

    ``fitted`` is False for tests that the diagnosis holds out.
    """

    kind: Kind
    seed: int
    low_n: float
    high_n: float
    cutoff_hz: float
    repeats: int | None = None
    fitted: bool = True

    def command(self, session_seed: int) -> Array:
        """Return commands, V, shape (9000,), or (3000,) for a quiet test: a preload at the mean load, then the
        stimulus."""
        if self.kind == "quiet":
            return np.zeros(_QUIET_SAMPLES)
        preload = round(PRELOAD_S * SAMPLE_RATE_HZ)
        count = _SAMPLES - preload
        if self.kind == "slow_ramp":
            cycle = np.arange(count) / SAMPLE_RATE_HZ / 2.0
            shape = 1.0 - 4.0 * np.abs((cycle + 0.25) % 1.0 - 0.5)
        else:
            shape = _clipped_noise(np.random.default_rng([session_seed, 23, self.seed]), count, self.cutoff_hz)
        rise = np.minimum((np.arange(preload) + 1.0) / (_RISE_S * SAMPLE_RATE_HZ), 1.0)
        mean, half = 0.5 * (self.low_n + self.high_n), 0.5 * (self.high_n - self.low_n)
        force = np.concatenate([mean * 0.5 * (1.0 - np.cos(np.pi * rise)), mean + half * shape])
        return _VOLTS_PER_NEWTON * force

    def stimulus(self) -> dict[str, object]:
        """Return the description of the stimulus as in the session format."""
        limits = {"force_min_n": self.low_n, "force_max_n": self.high_n}
        return {"type": "noise", "cutoff_hz": self.cutoff_hz, **limits}


def _clipped_noise(random: np.random.Generator, count: int, cutoff_hz: float) -> Array:
    # Gaussian noise, low-passed by eight poles and clipped at two standard deviations, between -1 and 1.
    settled = 1000
    poles = butter(8, cutoff_hz, fs=SAMPLE_RATE_HZ, output="sos")
    filtered = np.asarray(sosfilt(poles, random.standard_normal(settled + count)))[settled:]
    return np.asarray(np.clip((filtered - filtered.mean()) / (2.0 * filtered.std()), -1.0, 1.0))


@dataclass(frozen=True)
class SkinScenario:
    """A session on the skin, and its labels, which are withheld from the diagnosis.

    ``surface_errors_m`` and ``gravity_errors_m_s2`` (along and across the stroke) are errors of the session's
    attributes, the first for each test.
    """

    seed: tuple[int, ...]
    tissue: Tissue
    spring: Tissue
    parameters: PlantParameters
    effects: tuple[Effect, ...]
    tests: tuple[ForceTest, ...]
    surface_errors_m: tuple[float, ...]
    gravity_errors_m_s2: tuple[float, float]
    tilt_rad: float = 0.0
    """Angle of the stroke to the vertical, which the measured gravity shows."""
    earlier: SkinScenario | None = None
    """Session of the same person and instrument from which a twin is accepted, with no hidden effect."""

    @property
    def full(self) -> bool:
        """Whether it is the full series of tests."""
        return len(self.tests) > 1

    @property
    def number(self) -> int:
        """Seed of stimuli and noise."""
        return int(np.random.SeedSequence(list(self.seed)).generate_state(1)[0])

    @cached_property
    def lift_off_s(self) -> float:
        """Time for which the probe is off the skin in the fitted tests, s."""
        touching = [
            trace["touching"]
            for test, (_, trace) in zip(self.tests, self._traces, strict=True)
            if test.fitted and test.kind != "spring"
        ]
        return float(sum(np.count_nonzero(values == 0.0) for values in touching)) / SAMPLE_RATE_HZ

    def preset_effects(self) -> tuple[str, ...]:
        """Return the effects of the preset that are present, by the names of the contract."""
        present = [name for extra, name in PRESET_EFFECTS.items() if extra in self.tissue.extras]
        return tuple(name for name in present if name != "contact_loss" or self.lift_off_s > 0.0)

    def labels(self) -> dict[str, object]:
        """Return effects with stage and origin, and the true parameters, for JSON."""
        own = [
            {"name": name, "stage": "tissue", "listed": True, "hidden": False, "figures": {}}
            for name in self.preset_effects()
        ]
        hidden = [
            {"name": e.name, "stage": e.stage, "listed": e.listed, "hidden": True, "figures": e.model_dump()}
            for e in self.effects
        ]
        return {
            "effects": [*own, *hidden],
            "preset": self.tissue.name,
            "lift_off_s": self.lift_off_s,
            "instrument": asdict(self.parameters),
            "spring_n_per_m": self.spring.stiffness.coefficient,
            "surface_m": self.tissue.surface_m,
            "full": self.full,
        }

    def record(self, *, clean: bool = False) -> tuple[Recording, ...]:
        """Return all tests recorded; optionally without noise and quantization."""
        return tuple(self._read(k, clean=clean) for k in range(len(self.tests)))

    def companions(self) -> Iterator[tuple[str, tuple[Recording, ...]]]:
        """Yield the recording without noise, and that of the bare instrument on tissue without its extras."""
        yield "clean", self.record(clean=True)
        yield "base", replace(self, tissue=self.tissue.with_extras(()), effects=()).record(clean=True)

    def described(self, number: int, recordings: Sequence[Recording]) -> dict[str, object]:
        """Return the content of the session file, which has no labels."""
        along, across = self.gravity_errors_m_s2
        notes = {
            "gravity_along_stroke_m_s2": STANDARD_GRAVITY * np.cos(self.tilt_rad) + along,
            "gravity_across_stroke_m_s2": STANDARD_GRAVITY * np.sin(self.tilt_rad) + across,
        }
        tests = [
            {
                "surface_position_m": recording.surface_m + error,
                "repeat_of": "" if test.repeats is None else f"{test.repeats:04d}",
                "seed": test.seed,
                "stimulus": test.stimulus(),
                "notes": notes,
            }
            for test, recording, error in zip(self.tests, recordings, self.surface_errors_m, strict=True)
        ]
        instrument = NOMINAL | {"filter_corner_hz": PlantParameters().filter_cutoff_hz}
        return described(number, instrument, tests, recordings)

    @cached_property
    def _traces(self) -> tuple[tuple[Array, NDArray[np.void]], ...]:
        # Played commands, V, and noise-free signals of each test.
        random = np.random.default_rng([self.number, 7])
        start_s = float(random.uniform(0.0, 50.0))
        found = []
        for test in self.tests:
            volts, _, _ = Converters(0, _CHANNELS).drive(test.command(self.number))
            on_spring = test.kind == "spring"
            acting = [e for e in self.effects if not (on_spring and e.name in _NOT_ON_A_SPRING)]
            tissue = self.spring if on_spring else self.tissue
            plant = Plant(self.parameters, tissue, effects=acting, start_s=start_s)
            found.append((volts, plant.advance(volts)))
            start_s += volts.size / SAMPLE_RATE_HZ + float(random.uniform(5.0, 40.0))
        return tuple(found)

    def _read(self, place: int, *, clean: bool) -> Recording:
        test, (volts, trace) = self.tests[place], self._traces[place]
        names = [channel.name for channel in _CHANNELS]
        table = np.stack([volts, *(trace[f"filtered_{name}"] for name in names[1:])], axis=1)
        if not clean:
            codes, _ = Converters(self.number + place, _CHANNELS).read(table)
            table = np.stack([channel.decode(codes[:, k]) for k, channel in enumerate(_CHANNELS)], axis=1)
        signals = dict(zip(names, table.T.copy(), strict=True))
        random = np.random.default_rng([self.number, 31, place])
        for effect in self.effects:
            if isinstance(effect, Quantization):
                signals["position"] = effect.applied(signals["position"])
            if isinstance(effect, DroppedSamples):
                kept = np.array(effect.kept(volts.size, SAMPLE_RATE_HZ, random), dtype=np.intp)
                for name in ("voltage", "current", "position") if effect.channels == "all" else ("position",):
                    slipped = np.full(volts.size, np.nan)
                    slipped[: kept.size] = signals[name][kept]
                    signals[name] = slipped
        surface = self.spring.surface_m if test.kind == "spring" else self.tissue.surface_m
        return Recording(test.kind, surface, np.arange(volts.size) / SAMPLE_RATE_HZ, **signals)


def draw_skin_scenario(
    seed: int | Sequence[int],
    *,
    full: bool = False,
    preset: str | None = None,
    hidden: Sequence[str] | None = None,
    without: Sequence[str] = (),
) -> SkinScenario:
    """Return a scenario on a preset with hidden instrument effects; both are drawn unless they are given.

    Raises:
        ValueError: the preset or an effect does not exist or is not one of people's skin or of the instrument.
    """
    for name in (*without, *(hidden or ())):
        if name not in EFFECTS:
            raise ValueError(f"there is no effect {name!r}; there are: {', '.join(EFFECTS)}")
    for name in hidden or ():
        if name not in HIDDEN:
            raise ValueError(f"the effect {name!r} cannot be hidden in the instrument; those are: {', '.join(HIDDEN)}")
    if preset is not None and preset not in SITES:
        raise ValueError(f"{preset!r} is no preset of skin; those are: {', '.join(SITES)}")
    names = [name for name in HIDDEN if name not in without]
    if hidden is None and len(names) < MOST_HIDDEN:
        raise ValueError(f"{MOST_HIDDEN} effects cannot be drawn from {len(names)}")
    key = (seed,) if isinstance(seed, int) else tuple(seed)
    random = np.random.default_rng(list(key))
    site = SITES[int(random.integers(len(SITES)))]
    count = int(random.integers(MOST_HIDDEN + 1))
    drawn = [names[int(k)] for k in random.choice(len(names), size=count, replace=False)] if hidden is None else hidden
    parameters = _instrument(random)
    tissue = replace(load_preset(preset or site), surface_m=float(random.uniform(0.008, 0.011)))
    tests = _plan(random, full=full)
    return SkinScenario(
        key,
        tissue,
        _spring(random),
        parameters,
        in_order(EFFECTS[name].draw(random, _conditions(parameters, tissue, tests)) for name in drawn),
        tests,
        tuple(float(error) for error in SURFACE_ERROR_M * random.standard_normal(len(tests))),
        (
            float(GRAVITY_NOISE_M_S2 * random.standard_normal()),
            float(GRAVITY_NOISE_M_S2 * random.standard_normal()),
        ),
    )


def draw_skin_scenarios(
    seed: int,
    count: int,
    *,
    full_share: float = 0.5,
    hidden: Sequence[str] | None = None,
    without: Sequence[str] = (),
) -> tuple[SkinScenario, ...]:
    """Return scenarios, of which a share are full sessions; hidden effects are drawn unless they are given.

    Raises:
        ValueError: the share is not between 0 and 1, or as ``draw_skin_scenario``.
    """
    if not 0.0 <= full_share <= 1.0:
        raise ValueError(f"the share of full sessions must lie between 0 and 1, not {full_share:g}")
    return tuple(
        draw_skin_scenario(
            (seed, number, 2),
            full=bool(np.random.default_rng([seed, number, 1]).random() < full_share),
            hidden=hidden,
            without=without,
        )
        for number in range(1, count + 1)
    )


def draw_later_session(
    earlier: SkinScenario,
    seed: int | Sequence[int],
    *,
    hidden: Sequence[str] | None = None,
    without: Sequence[str] = (),
) -> SkinScenario:
    """Return a later session of the same person and instrument with 0 or 1 new hidden instrument effect.

    The instrument keeps its true parameters. Every parameter of the tissue drifts by ``DRIFT``; surface, tilt, mean
    load, stimuli, noise, and the errors of surface and gravity are new.

    Raises:
        ValueError: a hidden effect does not exist or is not one of the instrument.
    """
    for name in hidden or ():
        if name not in HIDDEN:
            raise ValueError(f"the effect {name!r} cannot be hidden in the instrument; those are: {', '.join(HIDDEN)}")
    key = (seed,) if isinstance(seed, int) else tuple(seed)
    random = np.random.default_rng(list(key))
    names = [name for name in HIDDEN if name not in without]
    if hidden is None:
        hidden = (names[int(random.integers(len(names)))],) if random.random() < 0.5 else ()
    tissue = _drifted(earlier.tissue, random)
    tilt = float(random.uniform(-MOST_TILT_RAD, MOST_TILT_RAD))
    parameters = replace(earlier.parameters, gravity_force_n=earlier.parameters.gravity_force_n * float(np.cos(tilt)))
    change = PRELOAD_CHANGE_N * float(random.standard_normal())
    change = min(change, HIGHEST_N[1] - max(test.high_n for test in earlier.tests))
    tests = tuple(
        test if test.kind == "quiet" else replace(test, low_n=test.low_n + change, high_n=test.high_n + change)
        for test in earlier.tests
    )
    return replace(
        earlier,
        seed=key,
        tissue=tissue,
        parameters=parameters,
        effects=in_order(EFFECTS[name].draw(random, _conditions(parameters, tissue, tests)) for name in hidden),
        tests=tests,
        surface_errors_m=tuple(float(error) for error in SURFACE_ERROR_M * random.standard_normal(len(tests))),
        gravity_errors_m_s2=(
            float(GRAVITY_NOISE_M_S2 * random.standard_normal()),
            float(GRAVITY_NOISE_M_S2 * random.standard_normal()),
        ),
        tilt_rad=tilt,
        earlier=earlier,
    )


def draw_later_sessions(
    seed: int, count: int, *, full_share: float = 0.0, without: Sequence[str] = ()
) -> tuple[SkinScenario, ...]:
    """Return later sessions, ``LATER_SESSIONS`` of each person; about half of them have a new effect.

    Raises:
        ValueError: as ``draw_skin_scenarios``.
    """
    people = draw_skin_scenarios(seed, -(-count // LATER_SESSIONS), full_share=full_share, without=without, hidden=())
    return tuple(
        draw_later_session(people[place // LATER_SESSIONS], (seed, place, 3), without=without) for place in range(count)
    )


def _drifted(tissue: Tissue, random: np.random.Generator) -> Tissue:
    def near(value: float) -> float:
        return value * (1.0 + DRIFT * float(random.standard_normal()))

    def law(of: Exponential) -> Exponential:
        return replace(of, coefficient=near(of.coefficient), rate_per_m=near(of.rate_per_m))

    return replace(
        tissue,
        surface_m=tissue.surface_m + float(random.uniform(-SURFACE_CHANGE_M, SURFACE_CHANGE_M)),
        mass=law(tissue.mass),
        damping=law(tissue.damping),
        stiffness=law(tissue.stiffness),
        direction_ratio=near(tissue.direction_ratio),
        branches=tuple(replace(branch, fraction=near(branch.fraction)) for branch in tissue.branches),
        recruited_mass_kg=near(tissue.recruited_mass_kg),
    )


def _instrument(random: np.random.Generator) -> PlantParameters:
    def near(nominal: float) -> float:
        return nominal * (1.0 + CALIBRATION_UNCERTAINTY * float(random.standard_normal()))

    mass = near(0.060)
    return PlantParameters(
        resistance_ohm=near(12.0),
        inductance_h=near(1e-3),
        force_constant_n_per_a=near(3.0),
        moving_mass_kg=mass,
        bearing_damping_n_s_per_m=near(3.5),
        gravity_force_n=mass * STANDARD_GRAVITY,
        amplifier_gain=near(1.0),
    )


def _spring(random: np.random.Generator) -> Tissue:
    return Tissue(
        name="spring",
        kind="linear",
        surface_m=SPRING_SURFACE_M,
        mass=Exponential(float(random.uniform(0.004, 0.008))),
        damping=Exponential(float(random.uniform(0.2, 0.8))),
        stiffness=Exponential(1000.0 * (1.0 + 0.01 * float(random.standard_normal()))),
    )


def _plan(random: np.random.Generator, *, full: bool) -> tuple[ForceTest, ...]:
    low, high = float(random.uniform(*LOWEST_N)), float(random.uniform(*HIGHEST_N))
    cutoff = float(np.exp(random.uniform(*np.log(CUTOFF_HZ))))
    standard = ForceTest("stochastic", 1, low, high, cutoff)
    if not full:
        return (standard,)
    mean, half = 0.5 * (low + high), 0.5 * (high - low)
    return (
        ForceTest("quiet", 0, 0.0, 0.0, cutoff),
        standard,
        replace(standard, repeats=2),
        ForceTest("stochastic", 2, mean - 0.6 * half, mean + 0.6 * half, cutoff, fitted=False),
        replace(standard, kind="slow_ramp", seed=0, low_n=RAMP_LOWEST_N),
        ForceTest("spring", 3, -0.8 * half, 0.8 * half, cutoff),
    )


def _conditions(parameters: PlantParameters, tissue: Tissue, tests: Sequence[ForceTest]) -> DrawConditions:
    test = tests[min(1, len(tests) - 1)]
    mean, half = 0.5 * (test.low_n + test.high_n), 0.5 * (test.high_n - test.low_n)
    plant = Plant(parameters, tissue)
    middle, deep = (plant.static_position(force + parameters.gravity_force_n) for force in (mean, test.high_n))
    return DrawConditions(
        tissue.surface_m,
        middle - tissue.surface_m,
        0.5 * (deep - middle),
        _VOLTS_PER_NEWTON * mean,
        0.5 * _VOLTS_PER_NEWTON * half,
    )
