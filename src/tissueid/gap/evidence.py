"""What each stage shows when everything upstream of it is measured, and what of it is another stage's doing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.backemf import Followed, followed
from tissueid.gap.fitting import Fit
from tissueid.gap.forces import Family, families
from tissueid.gap.noise import coarse_step
from tissueid.gap.observed import Observed, ObservedTest
from tissueid.gap.rhythm import SETTLING_S, lines, restlessness, slips
from tissueid.gap.stagewise import (
    COIL,
    DRIVE,
    MOVING,
    SPRING,
    TISSUE,
    Substituted,
    carried_noise,
    substitute,
    velocity_noise,
)
from tissueid.twin.effect import Stage

FloatArray = NDArray[np.float64]

MARGIN = 1.2
"""Errors up to so many times the floor are the floor: the noise is known to some 5 %."""
_COARSE = 3.0
"""A step of the reading is coarse where it is so many times the noise."""
_SETTLED = 40
_RESTING_M = 3e-4
_PLACES = {"spring": "without tissue", "tissue": "on tissue"}
_UNMOVED = 0.6
_FAR = 20.0
_FOLLOWS_NOT = 0.4
"""Where the coil's own equation is broken by the reading, and whole without it, less need be sure of the share."""
_CLEARLY = 0.2
_AS_GOOD = 0.9
_LEAST_GAIN = 0.02
"""Nats a sample that a family of forces takes away on held-out stretches where something is there to take."""


@dataclass(frozen=True)
class StageFinding:
    """One thing that speaks against a stage.

    ``weight`` is the error in nats: the logarithm of error over floor. ``error`` and ``floor`` are standard deviations,
    SI, of ``channel``.
    """

    stage: Stage
    what: str
    weight: float
    channel: str
    error: float
    floor: float

    def as_answer(self) -> dict[str, Any]:
        """Plain values."""
        return dict(vars(self))


@dataclass(frozen=True)
class Evidence:
    """All findings, heaviest first.

    ``nearest`` says how near to a finding each stage came, ``errors`` the errors of each question in floors:
    ``drive``, ``coil``, ``free current`` (from measured voltage without the position), ``spring``, ``tissue``.
    """

    findings: tuple[StageFinding, ...]
    nearest: dict[Stage, float]
    errors: dict[str, float]
    followed: Followed
    families: tuple[Family, ...]
    """Of the force that is missing on tissue, best first."""
    fixture_families: tuple[Family, ...]
    """The same on the spring or in free air."""
    answers: dict[str, Substituted] = field(repr=False)


def evidence(observed: Observed, baseline: Fit) -> Evidence:
    """Put every stage's question to the tests that can answer it."""
    return _Inquiry(observed, baseline).run()


class _Inquiry:
    """The questions, one after the other; later ones know the answers of the earlier."""

    def __init__(self, observed: Observed, baseline: Fit) -> None:
        self._observed, self._baseline = observed, baseline
        self._noise = observed.noise
        self._has = set(observed.recorded)
        self._findings: list[StageFinding] = []
        self._errors: dict[str, float] = {}
        self._answers: dict[str, Substituted] = {}
        self._tissue = [test for test in observed.tests if test.fixture == "tissue" and not test.quiet]
        self._fixture = [test for test in observed.tests if test.fixture != "tissue" and not test.quiet]
        self._step = max((coarse_step(test.signals["position"]) for test in observed.tests), default=0.0)
        self._position_noise = float(np.hypot(self._noise["position"], self._step / np.sqrt(12.0)))
        self._slipped = False
        self._floors: dict[str, float] = {}

    def run(self) -> Evidence:
        """Ask everything."""
        self._resolution()
        self._impulses()
        self._drive()
        self._quiet()
        coil = self._coil()
        free, told = self._free()
        mechanics = self._ask_motion("spring", self._fixture, (*MOVING, *SPRING), on_tissue=False)
        tests = [test for test in self._tissue if test.repeat_of is None]
        tissue = self._ask_motion("tissue", tests, (*MOVING, *TISSUE), on_tissue=True)
        self._judge(coil, free, told, mechanics, tissue)
        self._findings.sort(key=lambda item: -item.weight)
        return Evidence(
            tuple(self._findings), self._nearest(), self._errors, told, tuple(tissue), tuple(mechanics), self._answers
        )

    def _add(self, stage: Stage, what: str, times: float, channel: str, floor: float, least: float = MARGIN) -> None:
        if times > least:
            self._findings.append(StageFinding(stage, what, float(np.log(times)), channel, times * floor, floor))

    def _nearest(self) -> dict[Stage, float]:
        stages: dict[str, Stage] = {"drive": "drive", "coil": "coil", "spring": "mechanics", "tissue": "tissue"}
        return {stage: self._errors[name] for name, stage in stages.items() if name in self._errors}

    # -- sensing and environment by themselves -----------------------------------------------------------------

    def _resolution(self) -> None:
        if self._step > _COARSE * self._noise["position"]:
            times = self._position_noise / self._noise["position"]
            what = f"the position comes in steps of {1e6 * self._step:.3g} um"
            self._add("sensing", what, times, "position", self._noise["position"])

    def _impulses(self) -> None:
        for name, whole in self._observed.impulsive.items():
            what = f"single readings of the {name} are far off"
            self._add("sensing", what, whole / self._noise[name], name, self._noise[name])

    def _quiet(self) -> None:
        quiet = [test for test in self._observed.tests if test.quiet]
        # A probe that gravity takes off the skin shows nothing of what the skin does.
        resting = [test for test in quiet if float(np.nanstd(test.signals["position"][_settled(test) :])) < _RESTING_M]
        restless = [restlessness(test.signals["position"], test.sample_rate_hz) for test in resting]
        floor = self._position_noise
        self._errors["quiet"] = max(restless, default=floor) / floor
        self._add("environment", "the position moves while nothing is asked", self._errors["quiet"], "position", floor)

    def _without_lines(self, answer: Substituted, floor: float, what: str) -> float:
        """Error of an answer in floors, the worst test's, without the mains; which speaks against the environment."""
        left, hum = [], []
        for test in answer.tests:
            residual = answer.residual(test)
            found = lines(residual, test.sample_rate_hz)
            hum.append(found.deviation)
            left.append(float(np.nanstd((residual - found.waveform)[_SETTLED:])))
        times = float(np.hypot(max(hum), floor)) / floor
        self._add("environment", f"lines of the mains in the {answer.channel}, {what}", times, answer.channel, floor)
        return max(left) / floor

    # -- upstream of the motion ---------------------------------------------------------------------------------

    def _drive(self) -> None:
        if "voltage" not in self._has:
            return
        floor = self._noise["voltage"]
        answer = substitute(self._baseline, self._observed.tests, (), "voltage", DRIVE, floor)
        self._answers["drive"] = answer
        self._errors["drive"] = self._without_lines(answer, floor, "from the command")
        if self._errors["drive"] <= MARGIN:
            return
        moved = [
            slips(test.command, test.signals["voltage"], test.sample_rate_hz) for test in answer.tests if not test.quiet
        ]
        worst = max(moved, key=abs, default=0)
        if worst:
            self._slipped = True
            what = f"the record slips by {abs(worst)} samples against the command"
            self._add("sensing", what, self._errors["drive"], "voltage", floor)
        else:
            self._add("drive", "the voltage is not what the command asks", self._errors["drive"], "voltage", floor)

    def _coil_floor(self) -> float:
        instrument = self._baseline.parameters.instrument(self._baseline.theta)
        rate = self._observed.tests[0].sample_rate_hz
        from_motion = instrument.force_constant_n_per_a * velocity_noise(self._position_noise, rate)
        return float(
            np.hypot(self._noise["current"], np.hypot(from_motion, self._noise["voltage"]) / instrument.resistance_ohm)
        )

    def _coil(self) -> float:
        if not {"voltage", "current"} <= self._has:
            return 1.0
        floor, tests = self._coil_floor(), self._observed.tests
        names = ("voltage", "motion")
        answer = substitute(self._baseline, tests, names, "current", COIL, self._noise["current"])
        self._answers["coil"] = answer
        self._errors["coil"] = self._without_lines(answer, floor, "from voltage and motion")
        return self._errors["coil"]

    def _free(self) -> tuple[float, Followed]:
        """Current from the voltage alone: how well, and whether it follows the reading or the simulation."""
        unknown = Followed(float("nan"), float("inf"))
        tests = [*self._tissue[:1], *self._fixture[:1]]
        if not {"voltage", "current"} <= self._has or not tests:
            return 1.0, unknown
        floor = self._noise["current"]
        free = (*COIL, *MOVING[1:], *TISSUE, *SPRING)
        answer = substitute(self._baseline, tests, ("voltage",), "current", free, floor, ("position",))
        self._answers["free current"] = answer
        self._errors["free current"] = self._without_lines(answer, floor, "from the voltage")
        told = [followed(self._baseline, answer, test, floor, self._position_noise) for test in tests]
        weights = np.array([item.error**-2.0 for item in told])
        if not weights.sum() > 0.0:
            return self._errors["free current"], unknown
        shares = np.nan_to_num([item.share for item in told])
        return self._errors["free current"], Followed(
            float(weights @ shares / weights.sum()), float(weights.sum() ** -0.5)
        )

    # -- the motion ---------------------------------------------------------------------------------------------

    def _motion_floor(self, tests: Sequence[ObservedTest], upstream: tuple[str, ...]) -> float:
        # The measured current drives the twin with its noise. A nearly linear twin filters it away; friction that
        # sticks or slips by it moves the probe by more than the position's own noise.
        if not upstream or not self._baseline.parameters.effects:
            return self._position_noise
        carried = carried_noise(self._baseline, tests, upstream[0], self._noise[upstream[0]])
        return float(np.hypot(self._position_noise, carried))

    def _ask_motion(
        self, name: str, tests: Sequence[ObservedTest], free: Sequence[str], *, on_tissue: bool
    ) -> list[Family]:
        if not tests:
            return []
        upstream = ("current",) if "current" in self._has else ("voltage",) if "voltage" in self._has else ()
        floor = self._floors[name] = self._motion_floor(tests, upstream)
        answer = substitute(self._baseline, tests, upstream, "position", free, floor)
        if _worst(answer) > _FAR * floor:
            # The baseline may lie far off where another stage misled it: begin once more where nothing is known.
            afresh = self._baseline.parameters.array("start")
            again = substitute(self._baseline, tests, upstream, "position", free, floor, theta=afresh)
            answer = again if _worst(again) < _worst(answer) else answer
        self._answers[name] = answer
        self._without_lines(answer, floor, "from the current")
        found = families(self._baseline, answer, tests, floor, on_tissue=on_tissue)
        if found and found[0].left > _UNMOVED * found[0].before > _UNMOVED * MARGIN:
            # Far from the simulated motion, as behind a wall, only the recorded one says where the force acts.
            along = families(self._baseline, answer, tests, floor, on_tissue=on_tissue, recorded=True)
            found = along if along[0].left < found[0].left else found
        self._errors[name] = found[0].before if found else 1.0
        return _steady(found)

    def _judge(
        self, coil: float, free: float, told: Followed, mechanics: Sequence[Family], tissue: Sequence[Family]
    ) -> None:
        wrong_reading = bool(np.isfinite(told.share)) and told.error < 0.04 and told.share + 2.0 * told.error < 0.2
        if self._fixture and self._errors["spring"] <= MARGIN:
            # A wrong sensor is wrong on the spring as well.
            wrong_reading = False
        drive = self._errors.get("drive", 1.0)
        if coil > MARGIN and not self._slipped:
            # Volts that the amplifier does not deliver are amperes that the coil does not get.
            resistance = self._observed.instrument.coil_resistance_ohm
            from_drive = drive > MARGIN and drive * self._noise["voltage"] > coil * self._coil_floor() * resistance
            healed = free < max(MARGIN, 1.0 + 0.25 * (coil - 1.0)) and told.share + 2.0 * told.error < _FOLLOWS_NOT
            # A delay is the same on tissue and off it; what only looks late is late in one of them.
            asked = [item for item in (tissue, mechanics) if item and item[0].before > MARGIN]
            late = any(map(_late, asked)) and all(item[0].stage == "drive" for item in asked)
            if from_drive:
                wrong_reading = False
            elif healed:
                what = "the position does not show the motion that the back-EMF shows"
                self._add("sensing", what, coil, "current", self._coil_floor())
            elif late:
                what = "everything from the current on comes late"
                self._add("drive", what, coil, "current", self._coil_floor())
            else:
                what = "the current is not what voltage and motion make"
                self._add("coil", what, coil, "current", self._coil_floor())
        at_coil = any(item.stage == "coil" for item in self._findings)
        for name, found in (("spring", mechanics), ("tissue", tissue)):
            times = self._errors.get(name, 1.0)
            if not found or self._slipped or max(times / MARGIN, found[0].gain / _LEAST_GAIN) <= 1.0:
                continue
            floor = self._floors[name]
            if wrong_reading and not at_coil:
                self._add("sensing", f"{_PLACES[name]} the reading departs from the motion", times, "position", floor)
                continue
            chosen = self._blamed(name, found, at_coil, coil)
            what = f"{_PLACES[name]} a force is missing that goes with {chosen.kind}"
            self._add(chosen.stage, what, times, "position", floor, least=1.0)

    def _blamed(self, name: str, found: Sequence[Family], at_coil: bool, coil: float) -> Family:
        if not (coil > MARGIN and _late(found)) or at_coil:
            found = [item for item in found if item.stage != "drive"]
        on_fixture = self._errors.get("spring", 1.0) > MARGIN
        best = found[0]
        if name == "tissue" and self._fixture and not on_fixture:
            # What leaves the spring alone is the tissue's, or the surroundings'.
            return next((item for item in found if item.stage in ("tissue", "environment")), best)
        if name == "tissue" and on_fixture:
            best = next((item for item in found if item.stage not in ("tissue", "environment")), best)
        if self._errors.get("quiet", 1.0) > MARGIN and self._errors["quiet"] > 0.3 * self._errors[name]:
            return next((item for item in found if item.stage == "environment"), best)
        if best.kind == "periodic along the stroke" and not on_fixture:
            # Over little more than one period a wave is any bent law, and tissue is the likelier to have one.
            law = next((item for item in found if item.kind == "depth"), best)
            best = law if law.gain >= _AS_GOOD * best.gain else best
        ours = next((item for item in found if item.stage == "coil"), best)
        return ours if at_coil and ours.gain > 0.3 * best.gain else best


def _steady(found: Sequence[Family]) -> list[Family]:
    """With a rhythm behind what goes with time and past alone unless clearly better: it is wide enough for both."""
    others = [item for item in found if item.kind in ("wear", "memory", "loops", "current by time")]
    best = max((item.gain for item in others), default=-np.inf)
    held_back = [item for item in found if item.stage == "environment" and item.gain < best + _CLEARLY]
    return sorted(found, key=lambda item: -(min(item.gain, best - 1e-6) if item in held_back else item.gain))


def _late(found: Sequence[Family]) -> bool:
    if not found or found[0].stage != "drive" or found[0].gain < 5.0 * _LEAST_GAIN:
        return False
    return found[0].left < max(1.1, 0.6 * found[0].before)


def _worst(answer: Substituted) -> float:
    return max(float(np.nanstd(answer.residual(test)[_SETTLED:])) for test in answer.tests)


def _settled(test: ObservedTest) -> int:
    return min(round(SETTLING_S * test.sample_rate_hz), test.command.size // 2)
