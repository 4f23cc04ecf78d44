"""Generation of scenarios for a blind check: drawn at random, recorded, and written with their labels in a separate
file.

A folder receives for each scenario ``scenario-0001.json``, with the content of a session (nominal parameters of the
instrument and the attributes of each test), and ``scenario-0001.f64``, its signals as little-endian 64-bit floats: test
by test, signal by signal in the stated order. ``labels.json`` holds the withheld labels: effects with their parameters,
and the true parameters of device and tissue. With ``--clean`` there are ``scenario-0001.clean.f64`` (no noise, no
quantization) and ``scenario-0001.base.f64`` (also no effect) of the same layout; and for a pair
``scenario-0001.alone-1.f64`` and ``scenario-0001.alone-2.f64``, recorded with one of the effects. With ``--later``
several scenarios belong to one person and instrument: the key ``earlier`` names the files of an earlier session.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from firmware_sim.effects import EFFECTS, LISTED, UNLISTED, in_order
from firmware_sim.effects.base import Effect
from firmware_sim.laboratory import (
    SPRING_SURFACE_M,
    BaselineParameters,
    Laboratory,
    PlannedTest,
    Recording,
    plan,
)
from firmware_sim.laboratory.session_content import CALIBRATION_UNCERTAINTY, NOMINAL, described
from firmware_sim.laboratory.skin import draw_later_sessions, draw_skin_scenarios

_SHALLOW_SHARE = 0.1


class Scenario(Protocol):
    """A session to be recorded, with its labels."""

    @property
    def earlier(self) -> Scenario | None:
        """Session of the same person and instrument from which a twin is accepted; None where there is none."""

    def labels(self) -> dict[str, object]:
        """Return the labels for JSON."""

    def record(self) -> tuple[Recording, ...]:
        """Return all tests recorded."""

    def companions(self) -> Iterator[tuple[str, tuple[Recording, ...]]]:
        """Yield further recordings for the score by their kind, such as ``clean``."""

    def described(self, number: int, recordings: Sequence[Recording]) -> dict[str, object]:
        """Return the content of the session file, which has no labels."""


@dataclass(frozen=True)
class DrawnScenario:
    """A session to be recorded, and its labels, which are withheld from the diagnosis."""

    seed: tuple[int, ...]
    figures: BaselineParameters
    effects: tuple[Effect, ...]
    tests: tuple[PlannedTest, ...]
    earlier: None = None

    @property
    def full(self) -> bool:
        """Whether it is the full series of tests."""
        return len(self.tests) > 1

    def labels(self) -> dict[str, object]:
        """Return effects with stage and parameters, and the baseline's parameters, for JSON."""
        return {
            "effects": [
                {"name": e.name, "stage": e.stage, "listed": e.listed, "figures": e.model_dump()} for e in self.effects
            ],
            "baseline": asdict(self.figures),
            "full": self.full,
        }

    def record(self, *, effects: Sequence[Effect] | None = None, clean: bool = False) -> tuple[Recording, ...]:
        """Return all tests recorded; optionally with other effects, or without noise and quantization."""
        number = int(np.random.SeedSequence(list(self.seed)).generate_state(1)[0])
        acting = self.effects if effects is None else tuple(effects)
        laboratory = Laboratory(acting, number, figures=self.figures, clean=clean)
        return tuple(laboratory.record(test.kind, test.command(number)) for test in self.tests)

    def companions(self) -> Iterator[tuple[str, tuple[Recording, ...]]]:
        """Yield the recordings without noise and without effects, and those of a pair with one effect each."""
        yield "clean", self.record(clean=True)
        yield "base", self.record(effects=(), clean=True)
        for place, alone in enumerate(self.effects if len(self.effects) > 1 else (), 1):
            yield f"alone-{place}", self.record(effects=(alone,))

    def described(self, number: int, recordings: Sequence[Recording]) -> dict[str, object]:
        """Return the content of the session file, which has no labels."""
        tests = [
            {
                "surface_position_m": SPRING_SURFACE_M if test.kind == "spring" else recording.surface_m,
                "repeat_of": "" if test.repeats is None else f"{test.repeats:04d}",
                "seed": test.seed,
                "stimulus": test.stimulus(),
            }
            for test, recording in zip(self.tests, recordings, strict=True)
        ]
        return described(number, NOMINAL, tests, recordings)


def draw_baseline(random: np.random.Generator, *, shallow: bool = False) -> BaselineParameters:
    """Return a typically calibrated device and widely distributed tissue, indented 2 to 5.5 mm deep by 13 to 18 V.

    A shallow test, 0.7 to 3.5 mm deep by 4 to 9 V, reaches the surface.
    """

    def near(nominal: float) -> float:
        return nominal * (1.0 + CALIBRATION_UNCERTAINTY * float(random.standard_normal()))

    def evenly(low: float, high: float) -> float:
        return float(random.uniform(low, high))

    resistance, force_constant, gain = near(12.0), near(3.0), near(1.0)
    weight = evenly(-0.6, 0.6)
    while True:
        stiffness = float(np.exp(random.uniform(np.log(150.0), np.log(800.0))))
        rate = evenly(100.0, 450.0)
        depth = evenly(0.0007, 0.0035) if shallow else evenly(0.002, 0.0055)
        force = stiffness * float(np.exp(rate * depth)) * depth - weight
        mean = force / force_constant * resistance / gain
        if (4.0 <= mean <= 9.0) if shallow else (13.0 <= mean <= 18.0):
            break
    return BaselineParameters(
        resistance_ohm=resistance,
        inductance_h=near(1e-3),
        force_constant_n_per_a=force_constant,
        moving_mass_kg=near(0.060),
        bearing_damping_n_s_per_m=near(3.5),
        amplifier_gain=gain,
        weight_n=weight,
        stiffness_n_per_m=stiffness,
        stiffness_rate_per_m=rate,
        damping_n_s_per_m=evenly(2.0, 8.0),
        damping_rate_per_m=evenly(50.0, 350.0),
        tissue_mass_kg=evenly(0.0, 0.030),
        surface_m=evenly(0.008, 0.011),
        spring_n_per_m=1000.0 * (1.0 + 0.01 * float(random.standard_normal())),
        spring_mass_kg=evenly(0.004, 0.008),
        spring_damping_n_s_per_m=evenly(0.2, 0.8),
        mean_v=mean,
        spread_v=evenly(9.2, 11.5),
    )


def draw_scenario(
    seed: int | Sequence[int],
    *,
    effects: int = 1,
    unknown: bool = False,
    full: bool = False,
    without: Sequence[str] = (),
) -> DrawnScenario:
    """Return a scenario with a number of effects, drawn uniformly; with ``unknown``, one outside the diagnosis's
    library.

    Raises:
        ValueError: ``without`` names no effect, or leaves fewer than ``effects``.
    """
    for name in without:
        if name not in EFFECTS:
            raise ValueError(f"there is no effect {name!r}; there are: {', '.join(EFFECTS)}")
    names = [name for name in (UNLISTED if unknown else LISTED) if name not in without]
    if not 0 <= effects <= len(names):
        raise ValueError(f"{effects} effects cannot be drawn from {len(names)}")
    key = (seed,) if isinstance(seed, int) else tuple(seed)
    random = np.random.default_rng(list(key))
    chosen = [names[int(k)] for k in random.choice(len(names), size=effects, replace=False)]
    # Contact is only lost in shallow tests; some tests without it are shallow too, so that depth is no label.
    shallow = bool(random.random() < _SHALLOW_SHARE) or "contact_loss" in chosen
    figures = draw_baseline(random, shallow=shallow)
    around = figures.circumstances()
    drawn = in_order(EFFECTS[name].draw(random, around) for name in chosen)
    return DrawnScenario(key, figures, drawn, plan(figures, full=full))


def draw_many(
    seed: int,
    count: int,
    *,
    full_share: float = 0.5,
    none_share: float = 0.1,
    pairs_share: float = 0.1,
    unknown_share: float = 0.1,
    without: Sequence[str] = (),
) -> tuple[DrawnScenario, ...]:
    """Return scenarios with no, one, two effects or an unknown one, in these shares.

    Raises:
        ValueError: a share is not between 0 and 1, the last three exceed 1 together, or as ``draw_scenario``.
    """
    shares = (full_share, none_share, pairs_share, unknown_share)
    if not all(0.0 <= share <= 1.0 for share in shares) or sum(shares[1:]) > 1.0 + 1e-9:
        raise ValueError("shares must lie between 0 and 1, and those of none, pairs and unknown must not exceed 1")
    found = []
    for number in range(1, count + 1):
        random = np.random.default_rng([seed, number, 1])
        full, place = random.random() < full_share, random.random()
        none, pairs = place < none_share, none_share <= place < none_share + pairs_share
        unknown = none_share + pairs_share <= place < none_share + pairs_share + unknown_share
        found.append(
            draw_scenario(
                (seed, number),
                effects=0 if none else 2 if pairs else 1,
                unknown=unknown,
                full=bool(full),
                without=without,
            )
        )
    return tuple(found)


def write(scenarios: Sequence[Scenario], folder: Path, *, clean: bool = False) -> str:
    """Record scenarios into a new or empty folder, the labels last; return the SHA-256 of the labels file.

    Raises:
        ValueError: the folder is not empty, or cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise ValueError(f"the folder {folder} is not empty; name a new one")
        labels: dict[str, object] = {}
        before: list[Scenario] = []
        for number, scenario in enumerate(scenarios, 1):
            name = f"scenario-{number:04d}"
            recordings = scenario.record()
            _put(folder / f"{name}.f64", recordings)
            if clean:
                for kind, companion in scenario.companions():
                    _put(folder / f"{name}.{kind}.f64", companion)
            about = scenario.described(number, recordings)
            if (earlier := scenario.earlier) is not None:
                if earlier not in before:
                    before.append(earlier)
                    _write_session(folder, _earlier(len(before)), earlier.record(), earlier, len(before))
                about["earlier"] = _earlier(before.index(earlier) + 1)
            (folder / f"{name}.json").write_text(_text(about), encoding="utf-8")
            labels[name] = scenario.labels()
        content = _text(labels).encode()
        (folder / "labels.json").write_bytes(content)
    except OSError as error:
        raise ValueError(f"cannot write scenarios to {folder}: {error.strerror or error}") from error
    return hashlib.sha256(content).hexdigest()


def _put(path: Path, recordings: Sequence[Recording]) -> None:
    path.write_bytes(b"".join(r.stacked().astype("<f8").tobytes() for r in recordings))


def _write_session(folder: Path, name: str, recordings: Sequence[Recording], scenario: Scenario, number: int) -> None:
    _put(folder / f"{name}.f64", recordings)
    (folder / f"{name}.json").write_text(_text(scenario.described(number, recordings)), encoding="utf-8")


def _earlier(number: int) -> str:
    return f"earlier-{number:04d}"


def _text(value: object) -> str:
    return json.dumps(value, indent=1) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command: draw, record and write scenarios; return 2 on failure."""
    parser = argparse.ArgumentParser(
        prog="python -m firmware_sim.laboratory",
        description="Draw scenarios with hidden effects, record them, and write signals and labels to a folder.",
    )
    parser.add_argument("--seed", type=int, default=0, help="random seed; equal seeds give equal scenarios")
    parser.add_argument("--n", type=int, default=10, help="number of scenarios")
    parser.add_argument("--out", type=Path, required=True, help="a new or empty folder")
    parser.add_argument("--skin", action="store_true", help="forearms and upper arms with hidden instrument effects")
    parser.add_argument("--later", action="store_true", help="with --skin: later sessions of the same people")
    parser.add_argument("--full-share", type=float, default=0.5, help="share with the full series of tests")
    parser.add_argument("--none-share", type=float, default=0.1, help="share without any effect")
    parser.add_argument("--pairs-share", type=float, default=0.1, help="share with two effects")
    parser.add_argument("--unknown-share", type=float, default=0.1, help="share with an effect that is not listed")
    parser.add_argument("--without", nargs="+", default=[], metavar="NAME", help="effects that are not drawn")
    parser.add_argument(
        "--clean",
        action="store_true",
        help="also record without noise, without effects, and pairs with one effect at a time",
    )
    given = parser.parse_args(arguments)
    if given.seed < 0 or not 1 <= given.n <= 100_000:
        print("--seed must be 0 or more, and --n 1 to 100000", file=sys.stderr)
        return 2
    try:
        scenarios: Sequence[Scenario]
        if given.skin:
            draw = draw_later_sessions if given.later else draw_skin_scenarios
            scenarios = draw(given.seed, given.n, full_share=given.full_share, without=given.without)
        else:
            scenarios = draw_many(
                given.seed,
                given.n,
                full_share=given.full_share,
                none_share=given.none_share,
                pairs_share=given.pairs_share,
                unknown_share=given.unknown_share,
                without=given.without,
            )
        digest = write(scenarios, given.out, clean=given.clean)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    print(f"{len(scenarios)} scenarios in {given.out}; SHA-256 of labels.json: {digest}")
    return 0
