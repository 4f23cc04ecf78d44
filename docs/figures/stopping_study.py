"""The study of early stopping: tests on the simulated skin with three stimuli, and what is known of it when.

Used by ``early_stopping.py``, which prints and draws it, and by the claims. Everything measured is kept in memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from firmware_sim.bench import Bench
from firmware_sim.local_values import local_values
from firmware_sim.plant import Plant, PlantParameters
from firmware_sim.presets import load_preset, preset_names
from tissueid.device import DeviceDescription
from tissueid.identification import get_engine
from tissueid.identification.live.stopping import PARAMETERS, Precision, StopRule, precision
from tissueid.records import Record
from tissueid.stimuli.base import Stimulus, to_voltage, with_preload
from tissueid.stimuli.kinds.designed import Designed
from tissueid.stimuli.kinds.noise import Noise
from tissueid.stimuli.stimulus_check import StimulusCheck, assess_stimulus

Array = NDArray[np.float64]

SKIN = tuple(name for name in preset_names() if name.endswith("arm"))
DEVICE = DeviceDescription()
RATE = DEVICE.sample_rate_hz
RUNS = 50
LENGTH_S = 4.0
LOOK_EVERY_S = 0.25
TIMES = np.arange(0.5, LENGTH_S + 0.5 * LOOK_EVERY_S, LOOK_EVERY_S)
HALF_S = 0.5 * LENGTH_S
LOAD_N = 5.5
LOADS_N = (2.5, 4.0, 5.5, 7.0, 8.5)
"""Loads at which curves over depth are judged; the middle one is the mean of every stimulus here."""
CURVE_PRESETS = ("left-posterior-forearm", "upper-arm")
FIRST_SEED = 1


def reference(seed: int) -> Stimulus:
    """The product's default: Gaussian, 200 Hz, 0.5 to 10.5 N."""
    return Noise(force_min_n=0.5, force_max_n=10.5, seed=seed, seconds=LENGTH_S).build()


def about_a_load(seed: int) -> Stimulus:
    """The designed kind as it is for skin that nobody has tested."""
    return Designed(load_n=LOAD_N, seed=seed, seconds=LENGTH_S).build()


def over_depths(seed: int) -> Stimulus:
    """Even use of the reference's range, for curves over depth, of half its length."""
    return Noise(
        distribution="uniform", cutoff_hz=100.0, force_min_n=0.5, force_max_n=10.5, seed=seed, seconds=HALF_S
    ).build()


STIMULI = {"gaussian": reference, "designed": about_a_load, "even": over_depths}


def measured(preset: str, stimulus: Stimulus, seed: int) -> Record:
    """Measured force and position of one test after its preload."""
    played = with_preload(stimulus)
    bench = Bench(preset, seed=seed)
    codes = bench.block(to_voltage(played.values, DEVICE), energised=True).codes[round(played.preload_s * RATE) :]
    values = {channel.name: channel.decode(codes[:, k]) for k, channel in enumerate(bench.channels)}
    return Record(DEVICE.force_constant_n_per_a * values["current"], values["position"], RATE)


@cache
def recorded(preset: str, kind: str, seed: int) -> Record:
    """One test with one of the three stimuli."""
    return measured(preset, STIMULI[kind](seed), seed)


@cache
def looks(preset: str, kind: str, seed: int) -> tuple[Precision, ...]:
    """What is known of mass, damping and stiffness about the load as the test goes on, at ``TIMES``."""
    record = recorded(preset, kind, seed)
    return tuple(precision(record[: round(seconds * RATE)]) for seconds in TIMES)


@cache
def truth(preset: str, load_n: float = LOAD_N) -> tuple[float, tuple[float, float, float]]:
    """Where a load rests, m, and the plant's own mass, damping and stiffness there."""
    plant = Plant(PlantParameters(), load_preset(preset))
    volts = load_n * DEVICE.voltage_for_force(1.0)
    plant.rest(volts)
    position = float(plant.advance(np.full(10, volts))["position"][-1])
    own = local_values(preset, position)
    return position, (own["mass_kg"], own["damping_n_s_per_m"], own["stiffness_n_per_m"])


# -- mass, damping and stiffness about the load ---------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Course:
    """Logarithms of estimates (runs, times, 3), their deviations as reported, and the logarithm of the truth (3,)."""

    value: Array
    reported: Array
    own: Array

    @property
    def told(self) -> Array:
        """Median over the runs of the reported deviation, (times, 3)."""
        return np.asarray(np.median(self.reported, axis=0))

    @property
    def spread(self) -> Array:
        """Standard deviation of the estimates over the runs, (times, 3)."""
        return np.asarray(self.value.std(axis=0, ddof=1))

    @property
    def error(self) -> Array:
        """Root-mean-square distance from the plant's own values, (times, 3)."""
        return np.asarray(np.sqrt(np.mean((self.value - self.own) ** 2, axis=0)))


@cache
def course(preset: str, kind: str) -> Course:
    """All runs with a stimulus on a preset."""
    return _course(preset, [looks(preset, kind, seed) for seed in range(FIRST_SEED, FIRST_SEED + RUNS)])


def _course(preset: str, runs: Sequence[Sequence[Precision]]) -> Course:
    """What so many looks found in each of the runs."""
    value = [[[np.log(look.estimates[name].value) for name in PARAMETERS] for look in run] for run in runs]
    reported = [[[look.relative_std[name] for name in PARAMETERS] for look in run] for run in runs]
    return Course(np.array(value), np.array(reported), np.log(truth(preset)[1]))


def reached_after(falling: Array, target: float) -> float:
    """When a course (times,) comes to a target for good, s, between the looks by its logarithm; infinite if never."""
    above = np.flatnonzero(falling > target)
    if above.size == 0:
        return float(TIMES[0])
    last = int(above[-1])
    if last == TIMES.size - 1:
        return float("inf")
    steps = np.log([falling[last], falling[last + 1]])
    share = (steps[0] - np.log(target)) / (steps[0] - steps[1])
    return float(TIMES[last] * (TIMES[last + 1] / TIMES[last]) ** share)


def times_to_reference(preset: str) -> dict[str, list[float]]:
    """When the designed stimulus is as good as the reference at its end, s, for mass, damping and stiffness."""
    ours, theirs = course(preset, "designed"), course(preset, "gaussian")
    return {
        measure: [reached_after(getattr(ours, measure)[:, p], getattr(theirs, measure)[-1, p]) for p in range(3)]
        for measure in ("told", "spread", "error")
    }


def pooled_times(presets: Sequence[str], measure: str) -> list[float]:
    """The same with the ratio to the reference's end averaged (geometrically) over presets."""
    ratio = np.mean(
        [
            np.log(getattr(course(p, "designed"), measure) / getattr(course(p, "gaussian"), measure)[-1])
            for p in presets
        ],
        axis=0,
    )
    return [reached_after(np.exp(ratio[:, parameter]), 1.0) for parameter in range(3)]


# -- stopping -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Stopped:
    """When the runs on a preset ended (runs,), s, and the shares of their 95 % intervals that held, (3,).

    ``held_limit``: what the same stimulus finds on average after 4 s; ``held_own``: the plant's own values.
    """

    seconds: Array
    held_limit: Array
    held_own: Array


@cache
def stopped(preset: str, kind: str) -> Stopped:
    """Runs that end when they know what 4 s of the reference tell, by the product's rule."""
    targets = course(preset, "gaussian").told[-1]
    rule = StopRule(
        targets=dict(zip(PARAMETERS, targets.tolist(), strict=True)), look_every_s=LOOK_EVERY_S, min_seconds=0.5
    )
    all_runs = course(preset, kind)
    limit = all_runs.value[:, -1].mean(axis=0)
    seconds, limit_held, own_held = [], [], []
    for seed, value, reported in zip(
        range(FIRST_SEED, FIRST_SEED + RUNS), all_runs.value, all_runs.reported, strict=True
    ):
        run = looks(preset, kind, seed)
        end = next((k for k in range(TIMES.size) if rule.enough(run[: k + 1])), TIMES.size - 1)
        seconds.append(float(TIMES[end]))
        limit_held.append(np.abs(value[end] - limit) < 1.96 * reported[end])
        own_held.append(np.abs(value[end] - all_runs.own) < 1.96 * reported[end])
    return Stopped(np.array(seconds), np.mean(limit_held, axis=0), np.mean(own_held, axis=0))


# -- curves over depth ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Curves:
    """Logarithms of M, B and K at the loads (runs, 3, loads), as reported and as found, and the fits that failed."""

    value: Array
    reported: Array
    own: Array
    unsettled: int

    @property
    def told(self) -> Array:
        """Median over the runs of the reported deviation, (3, loads)."""
        return np.asarray(np.nanmedian(self.reported, axis=0))

    @property
    def spread(self) -> Array:
        """Deviation of the estimates over the runs by their median distance from the median, (3, loads)."""
        return np.asarray(1.4826 * np.median(np.abs(self.value - np.median(self.value, axis=0)), axis=0))


@cache
def curves(preset: str, kind: str, seconds: float) -> Curves:
    """Curves of the ``dpn`` engine, fitted to so many seconds of all runs."""
    places = np.array([truth(preset, load)[0] for load in LOADS_N])
    own = np.log(np.array([truth(preset, load)[1] for load in LOADS_N]).T)
    value, reported = [], []
    for seed in range(FIRST_SEED, FIRST_SEED + RUNS):
        known = get_engine("dpn")().fit(recorded(preset, kind, seed)[: round(seconds * RATE)]).estimated
        bands = (known.mass(places), known.damping(places), known.stiffness(places))
        value.append([np.log(band.value) for band in bands])
        reported.append([band.std / band.value for band in bands])
    deviations = np.array(reported)
    return Curves(np.array(value), deviations, own, int(np.isnan(deviations).any(axis=(1, 2)).sum()))


# -- what makes the difference, and what it costs ------------------------------------------------------------


def appraised(kind: str) -> StimulusCheck:
    """Edges, currents and heating of a whole test with a stimulus, preload included."""
    return assess_stimulus(
        with_preload(STIMULI[kind](FIRST_SEED)), DEVICE, max_force_n=12.0, max_seconds=10.0, max_temperature_c=60.0
    )


def resonant_power() -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Frequencies, Hz, and densities that a D-optimal design gives a force about a load when noise is all there is.

    The multiplicative algorithm of Titterington (1976) on the information of log M, log B and log K under force noise.
    """
    tissue = Designed(load_n=LOAD_N).tissue
    frequency = np.arange(1.0, 201.0)
    s = 2j * np.pi * frequency
    terms = np.stack([tissue.mass_kg * s**2, tissue.damping_n_s_per_m * s, np.full(s.size, tissue.stiffness_n_per_m)])
    slopes = terms / terms.sum(axis=0)  # (3, frequencies)
    each = np.einsum("if,jf->fij", slopes, slopes.conj()).real
    share = np.full(frequency.size, 1.0 / frequency.size)
    for _ in range(500):
        share = share * np.einsum("ij,fji->f", np.linalg.inv(np.einsum("f,fij->ij", share, each)), each) / 3.0
    return tuple(frequency.tolist()), tuple((share / share.max()).tolist())


def variants() -> dict[str, Noise]:
    """Stimuli of half the reference's length, from it to the designed one and beyond."""
    swing = Designed(load_n=LOAD_N).amplitude_n
    whole = {"force_min_n": 0.5, "force_max_n": 10.5, "seconds": HALF_S}
    frequencies, densities = resonant_power()
    resonant = {"spectrum": "power", "frequencies_hz": frequencies, "densities": densities}

    def about(half: float) -> dict[str, float]:
        return {"force_min_n": LOAD_N - half, "force_max_n": LOAD_N + half, "seconds": HALF_S}

    options = {
        "the reference, cut short": whole,
        "even use of its range": whole | {"distribution": "uniform"},
        "the same, power at the resonance": whole | {"distribution": "uniform"} | resonant,
        "Gaussian, 200 Hz, a fifth of the range": about(1.0),
        "even, 200 Hz, the designed swing": about(swing) | {"distribution": "uniform"},
        "designed: even, 100 Hz": about(swing) | {"distribution": "uniform", "cutoff_hz": 100.0},
        "half its swing": about(0.5 * swing) | {"distribution": "uniform", "cutoff_hz": 100.0},
        "twice its swing": about(2.0 * swing) | {"distribution": "uniform", "cutoff_hz": 100.0},
        "its swing, power at the resonance": about(swing) | {"distribution": "uniform"} | resonant,
    }
    return {name: Noise.model_validate(chosen) for name, chosen in options.items()}


def after_half(preset: str, variant: Noise) -> Course:
    """All runs with a variant, at the end of half the reference's length: one time."""
    seeds = range(FIRST_SEED, FIRST_SEED + RUNS)
    played = [variant.model_copy(update={"seed": seed}).build() for seed in seeds]
    return _course(preset, [[precision(measured(preset, *one))] for one in zip(played, seeds, strict=True)])
