"""Scenarios of the second laboratory: drawn machine, tissue, stimulus and effects; recorded; written with labels."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from firmware_sim.second_laboratory.effect import Effect, Signals, log_uniform
from firmware_sim.second_laboratory.instruments import Machine, Truth, draw_machine, draw_truth
from firmware_sim.second_laboratory.recording import EFFECTS, SIGNALS, UNITS, Laboratory, PlannedTest
from firmware_sim.second_laboratory.sizing import LEAST_GAP, MOST_GAP, Sizer
from firmware_sim.second_laboratory.stimuli import Stimulus, draw_stimulus, slow_ramp

FORMAT = "tissueid-laboratory 1"
STAGES = ("drive", "coil", "mechanics", "tissue", "sensing", "environment")
REDRAWS = 4
"""How often an effect is drawn again whose gap is too small at its largest size."""
MOST_IN_SET = 4


@dataclass(frozen=True)
class Shares:
    """Shares of scenarios: full sessions; without effect, with one unlisted, with two, with two to four effects."""

    full: float = 0.5
    none: float = 0.1
    unknown: float = 0.1
    pairs: float = 0.1
    sets: float = 0.0


@dataclass(frozen=True)
class Scenario:
    """A drawn scenario; ``gaps`` are those of each effect alone in the main test."""

    number: int
    seed: int
    machine: Machine
    truth: Truth
    effects: tuple[Effect, ...]
    gaps: tuple[float, ...]
    tests: tuple[PlannedTest, ...]
    full: bool

    def record(self, effects: tuple[Effect, ...], *, noisy: bool) -> list[Signals]:
        """Return the signals of all tests with these effects."""
        laboratory = Laboratory(self.machine, self.truth, effects)
        return [laboratory.record(test, (self.seed, self.number) if noisy else None) for test in self.tests]

    def label(self) -> dict[str, Any]:
        """Return the sealed truth."""
        effects = [
            {"name": item.name, "stage": item.stage, "listed": item.listed, "gap": gap, "figures": item.figures()}
            for item, gap in zip(self.effects, self.gaps, strict=True)
        ]
        return {"effects": effects, "baseline": self.truth, "machine": asdict(self.machine), "full": self.full}

    def description(self) -> dict[str, Any]:
        """Return what the diagnosis may know."""
        tests, first = [], 0
        for test in self.tests:
            tests.append(
                {
                    "name": f"{test.number:04d}",
                    "kind": test.kind,
                    "configuration": "indentation",
                    "preload_s": test.preload_s,
                    "surface_position_m": test.surface_m,
                    "repeat_of": f"{test.repeat_of:04d}" if test.repeat_of else "",
                    "seed": test.seed,
                    "stimulus": test.stimulus,
                    "sample_rate_hz": self.machine.sample_rate_hz,
                    "first": first,
                    "samples": test.command.size,
                }
            )
            first += test.command.size * len(SIGNALS)
        about = {"format": FORMAT, "scenario": self.number, "signals": list(SIGNALS), "units": list(UNITS)}
        return about | {"instrument": self.machine.description(), "tests": tests}


def _kinds_drawn(random: np.random.Generator, shares: Shares, without: Sequence[str]) -> list[type[Effect]]:
    listed = [kind for name, kind in EFFECTS.items() if kind.listed and name not in without]
    unlisted = [kind for name, kind in EFFECTS.items() if not kind.listed and name not in without]
    kinds = np.cumsum([shares.none, shares.unknown, shares.pairs, shares.sets])
    drawn = int(np.searchsorted(kinds, random.random(), side="right"))
    if drawn == 0:
        return []
    if drawn == 1 and unlisted:
        return [unlisted[int(random.integers(len(unlisted)))]]
    count = (1, 1, 2, int(random.integers(2, MOST_IN_SET + 1)), 1)[drawn]
    chosen: list[type[Effect]] = []
    while len(chosen) < count:
        rest = [kind for kind in listed if kind.stage not in {item.stage for item in chosen}]
        if not rest:
            break
        chosen.append(rest[int(random.integers(len(rest)))])
    return sorted(chosen, key=lambda kind: (STAGES.index(kind.stage), kind.name))


def _stimulus_volts(truth: Truth) -> float:
    return (truth["force_n"] - truth["weight_n"]) * truth["resistance_ohm"] / truth["force_constant_n_per_a"]


def _main_test(
    random: np.random.Generator, machine: Machine, truth: Truth, *, shallow: bool
) -> tuple[Stimulus, float, float]:
    """Draw stimulus, offset and scale (V) such that the motion is the wanted part of the depth."""
    mass = truth["mass_kg"] + truth["tissue_mass_kg"]
    natural = np.sqrt(truth["local_stiffness_n_per_m"] / mass) / (2.0 * np.pi)
    stimulus = draw_stimulus(random, float(natural), machine.sample_rate_hz)
    offset = _stimulus_volts(truth) / truth["gain"]
    wanted = truth["depth_m"] * float(random.uniform(0.5, 0.9) if shallow else random.uniform(0.08, 0.28))
    most = (0.95 * machine.limit_v - abs(offset)) / 3.3
    scale = 0.5 * most
    laboratory = Laboratory(machine, truth)
    for _ in range(4):
        test = planned(machine, truth, 1, "stochastic", stimulus, offset, scale, 1)
        place = laboratory.record(test)["position"][round(machine.preload_s * machine.sample_rate_hz) :]
        ratio = wanted / float(place.std())
        if not shallow and place.min() < truth["surface_m"]:
            # The probe stays in the tissue.
            ratio = min(ratio, 0.8)
        scale = float(min(scale * np.clip(ratio, 0.1, 4.0), most))
    return stimulus, offset, scale


def planned(
    machine: Machine,
    truth: Truth,
    number: int,
    kind: str,
    stimulus: Stimulus,
    offset: float,
    scale: float,
    seed: int,
    repeat_of: int = 0,
) -> PlannedTest:
    """Return a test of any kind: quiet, stochastic, slow_ramp or spring."""
    rate = machine.sample_rate_hz
    seconds = min(1.5, machine.duration_s) if kind == "quiet" else machine.duration_s
    samples, begin = round(seconds * rate), round(machine.preload_s * rate)
    course = np.zeros(samples)
    if kind == "slow_ramp":
        course[begin:] = slow_ramp(samples - begin)
    elif kind != "quiet":
        course[begin:] = stimulus.course(samples - begin, rate, seed)
    command = np.zeros(samples) if kind == "quiet" else offset + scale * course
    surface = 0.5 * machine.stroke_m if kind == "spring" else truth["surface_m"]
    about = {"type": stimulus.kind, "cutoff_hz": stimulus.cutoff_hz, "offset_v": offset, "scale_v": scale}
    return PlannedTest(number, kind, command, about, seed, surface, machine.preload_s, repeat_of)


def _tests(
    random: np.random.Generator, machine: Machine, truth: Truth, drawn: tuple[Stimulus, float, float], *, full: bool
) -> tuple[PlannedTest, ...]:
    stimulus, offset, scale = drawn
    seed, other = (int(item) for item in random.integers(1, 2**20, 2))
    rows = [("stochastic", stimulus, offset, scale, seed, 0)]
    if full:
        natural = stimulus.cutoff_hz / 5.0
        another = draw_stimulus(random, natural, machine.sample_rate_hz)
        soft = scale * float(random.uniform(0.45, 0.75))
        # The spring gets a force that moves it as far as the tissue was deep.
        push = truth["depth_m"] * truth["spring_n_per_m"] * truth["resistance_ohm"] / truth["force_constant_n_per_a"]
        spring = min(0.25 * push, 0.28 * machine.limit_v)
        rows = [
            ("quiet", stimulus, offset, 0.0, 0, 0),
            ("stochastic", stimulus, offset, scale, seed, 0),
            ("stochastic", stimulus, offset, scale, seed, 2),
            ("stochastic", another, offset, soft, other, 0),
            ("slow_ramp", stimulus, offset, max(0.7 * abs(offset), scale), 0, 0),
            ("spring", stimulus, 0.0, spring, other + 1, 0),
        ]
    return tuple(
        planned(machine, truth, number, kind, shape, middle, size, begun, again)
        for number, (kind, shape, middle, size, begun, again) in enumerate(rows, 1)
    )


def draw_scenario(seed: int, number: int, shares: Shares, without: Sequence[str] = ()) -> Scenario:
    """Draw scenario ``number`` of a seed; it does not depend on the others."""
    random = np.random.default_rng([seed, number])
    kinds = _kinds_drawn(random, shares, without)
    full = bool(random.random() < shares.full)
    shallow = any(kind.name == "contact_loss" for kind in kinds)
    machine = draw_machine(random)
    truth = draw_truth(random, machine, shallow=shallow)
    tests = _tests(random, machine, truth, _main_test(random, machine, truth, shallow=shallow), full=full)
    effects, gaps = [], []
    if kinds:
        sizer = Sizer(Laboratory(machine, truth), next(test for test in tests if test.kind == "stochastic"))
        motion = sizer.motion()
        for kind in kinds:
            wanted = log_uniform(random, LEAST_GAP, MOST_GAP)
            for _ in range(REDRAWS):
                effect, gap = sizer.sized(kind.draw(random, motion), wanted)
                if gap >= 0.5 * LEAST_GAP:
                    break
            effects.append(effect)
            gaps.append(gap)
    return Scenario(number, seed, machine, truth, tuple(effects), tuple(gaps), tests, full)


def write_scenario(folder: Path, scenario: Scenario, *, clean: bool) -> None:
    """Write a scenario, and with ``clean`` its companions: without noise, without effects, and each effect alone."""
    name = f"scenario-{scenario.number:04d}"
    about = json.dumps(scenario.description(), indent=1)
    (folder / f"{name}.json").write_text(about + "\n", encoding="utf-8")
    _write_signals(folder / f"{name}.f64", scenario.record(scenario.effects, noisy=True))
    if clean:
        _write_signals(folder / f"{name}.clean.f64", scenario.record(scenario.effects, noisy=False))
        _write_signals(folder / f"{name}.base.f64", scenario.record((), noisy=False))
        if len(scenario.effects) > 1:
            for place, effect in enumerate(scenario.effects, 1):
                _write_signals(folder / f"{name}.alone-{place}.f64", scenario.record((effect,), noisy=True))


def _write_signals(path: Path, tests: list[Signals]) -> None:
    rows = [np.concatenate([signals[name] for name in SIGNALS]) for signals in tests]
    np.concatenate(rows).astype("<f8").tofile(path)


def write_labels(folder: Path, labels: dict[str, Any]) -> str:
    """Write the labels and return their SHA-256."""
    content = json.dumps(labels, indent=1, default=lambda item: item.item()).encode() + b"\n"
    (folder / "labels.json").write_bytes(content)
    return hashlib.sha256(content).hexdigest()
