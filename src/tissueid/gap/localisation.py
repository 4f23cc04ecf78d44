"""Localisation of the gap: stage of the chain, and regions of frequency, depth, direction and time.

The evidence against each stage is simulated from measured upstream signals, without any list of effects. Voltage and
current give the velocity without the position sensor. Where reading and simulation differ, the current shows which of
the two is right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import Dataset, DatasetTest, interpolated
from tissueid.gap.decision import Candidate
from tissueid.gap.error_regions import ErrorRegions, find_error_regions
from tissueid.gap.fitting import Fit
from tissueid.gap.forces import DEPTH, OF_TIME_AND_PAST, PERIODIC, ForceFamily, force_families
from tissueid.gap.noise import (
    MARGIN,
    coarse_step,
    lost_samples,
    mains_lines,
    quiet_motion,
    settling_samples,
    without_outliers,
)
from tissueid.gap.stage_substitution import (
    COIL,
    DRIVE,
    MOTION_HZ,
    MOVING,
    SPRING,
    TISSUE,
    StageSimulation,
    motion,
    motion_noise,
    propagated_noise,
    simulate_stage,
    velocity_noise,
)
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.twin.effect import STAGES, Stage

FloatArray = NDArray[np.float64]

_SMOOTHED_BINS = 9


@dataclass(frozen=True)
class BackEmfShare:
    """Share of the difference between reading and simulation that the current follows.

    ``share`` is 1 where the reading is right (a fault of the moving part or the tissue) and 0 where it is wrong (a
    fault of the sensor), with its standard error.
    """

    share: float
    error: float


def back_emf_share(
    baseline: Fit, answer: StageSimulation, test: DatasetTest, noise_a: float, noise_m: float
) -> BackEmfShare:
    """Regress the residual of the current, simulated from measured voltage, on the difference of the velocities.

    Args:
        baseline: the refitted baseline.
        answer: simulated current from measured voltage, with the simulated position.
        test: one of its tests.
        noise_a: standard deviation of the current, A.
        noise_m: standard deviation of the position, m.
    """
    instrument = baseline.parameters.instrument(answer.theta)
    scale = instrument.force_constant_n_per_a / instrument.resistance_ohm
    _, velocity = motion(test)
    simulated = answer.predicted[test.number]["position"]
    _, believed = motion(test, simulated)
    expected = -scale * (velocity - believed)
    residual = interpolated(answer.residual(test, "current"))
    window = np.hanning(residual.size)
    weight = float(np.sum(window**2))
    hz = np.fft.rfftfreq(residual.size, 1.0 / test.sample_rate_hz).astype(np.float64)
    inside = (hz > 0.3) & (hz < MOTION_HZ)
    expected_spectrum = np.fft.rfft((expected - expected.mean()) * window)[inside]
    residual_spectrum = np.fft.rfft((residual - residual.mean()) * window)[inside]
    noise = motion_noise(hz[inside], noise_m, test.sample_rate_hz) * scale**2 * weight
    power = np.convolve(np.abs(expected_spectrum) ** 2, np.ones(_SMOOTHED_BINS) / _SMOOTHED_BINS, "same")
    signal = np.maximum(power - noise, 0.0)
    trust = signal / np.maximum(power, 1e-300)
    floor = _level(residual_spectrum, noise_a**2 * weight)
    # Resistance, inductance and force constant are uncertain within the calibration, which can imitate motion.
    spread = baseline.parameters.dataset.instrument.calibration_relative_uncertainty
    simulated_a = interpolated(answer.predicted[test.number]["current"])
    nuisance = [simulated_a, np.diff(simulated_a, prepend=simulated_a[0]), scale * believed]
    columns = [np.sqrt(trust / floor) * expected_spectrum]
    for values in nuisance:
        spectrum = np.fft.rfft((values - values.mean()) * window)[inside]
        columns.append(np.sqrt(trust / floor) * spectrum)
    design = np.stack(columns, axis=1)
    normal = np.real(design.conj().T @ design)
    # Remove the power of the noise from that of the reading.
    normal[0, 0] = float(np.sum(trust / floor * np.maximum(np.abs(expected_spectrum) ** 2 - noise, 0.0)))
    normal += np.diag([1e-12, *(0.5 * np.array([spread, 1.0, spread]) ** -2.0)])
    if normal[0, 0] <= 1e-9:
        return BackEmfShare(float("nan"), float("inf"))
    toward = np.real(design.conj().T @ (np.sqrt(trust / floor) * residual_spectrum))
    coefficients = np.linalg.solve(normal, toward)
    rest = np.abs(np.sqrt(trust / floor) * residual_spectrum - design @ coefficients) ** 2
    excess = max(1.0, float(np.sum(rest) / max(np.sum(trust), 1e-9)))
    return BackEmfShare(float(coefficients[0]), float(np.sqrt(0.5 * excess * np.linalg.inv(normal)[0, 0])))


def _level(spectrum: NDArray[np.complex128], least: float) -> FloatArray:
    smooth = np.convolve(np.abs(spectrum) ** 2, np.ones(_SMOOTHED_BINS) / _SMOOTHED_BINS, "same")
    return np.maximum(smooth, least)


_QUANTISATION_RATIO = 3.0
"""Least quantization step of the position that is a finding, in deviations of the noise."""
_SETTLED = 40
"""Samples at the start of a test that are left out."""
_RESTING_M = 3e-4
"""Largest deviation of the position in a quiet test on the skin, m."""
_UNCHANGED_ERROR_SHARE = 0.6
"""Least share of the error that stays with the simulated motion before the recorded motion is tried."""
_REFIT_ERROR = 20.0
"""Error in floors above which a stage is refitted from the starting values."""
_LEAST_BACK_EMF_SHARE = 0.4
"""Largest share of the recorded motion in the back-EMF when the current fits without the position."""
_PERIODIC_LEAD = 0.2
"""Lead of a periodic motion over forces of time and past, nats: it is flexible enough to imitate them."""
_STATIC_GAIN_SHARE = 0.9
"""Least gain of a static law relative to a periodic force for the law to be preferred."""
_LEAST_GAIN = 0.02
"""Least gain of a kind of force on held-out data that is a finding, nats a sample."""
_READINGS = {
    "spring": Message("evidence.reading_off_tissue", "Without tissue the position reading departs from the motion"),
    "tissue": Message("evidence.reading_on_tissue", "On tissue the position reading departs from the motion"),
}
_FORCES = {
    "spring": Message("evidence.force_off_tissue", "Unmodelled force without tissue, correlated with {kind}"),
    "tissue": Message("evidence.force_on_tissue", "Unmodelled force on tissue, correlated with {kind}"),
}
"""Texts of findings on the motion off the tissue and on it."""
_FROM_COMMAND = marked("from the command")
_FROM_VOLTAGE_AND_MOTION = marked("from voltage and motion")
_FROM_VOLTAGE = marked("from the voltage")
_FROM_CURRENT = marked("from the current")


_SIMULATED: dict[str, Stage] = {"drive": "drive", "coil": "coil", "spring": "mechanics", "tissue": "tissue"}
"""Simulation of a single stage, and the stage."""


@dataclass(frozen=True)
class StageFinding:
    """One finding against a stage.

    ``weight`` is the error in nats: the logarithm of error over floor. ``error`` and ``floor`` are standard deviations,
    SI, of ``channel``.
    """

    stage: Stage
    what: Message
    weight: float
    channel: str
    error: float
    floor: float

    def as_answer(self) -> dict[str, Any]:
        """Return plain values for JSON: the text under ``what``, its code and values under ``message``."""
        return vars(self) | {"what": str(self.what), "message": self.what.as_dict()}


class _StageAnalysis:
    """The simulations of the stages in order; later ones use the results of earlier ones."""

    def __init__(self, dataset: Dataset, baseline: Fit) -> None:
        self._dataset, self._baseline = dataset, baseline
        self._noise = dataset.noise
        self._has = set(dataset.recorded)
        self.findings: list[StageFinding] = []
        self.errors: dict[str, float] = {}
        self._tissue = [test for test in dataset.tests if test.fixture == "tissue" and not test.quiet]
        self._fixture = [test for test in dataset.tests if test.fixture != "tissue" and not test.quiet]
        self._step = max((coarse_step(test.signals["position"]) for test in dataset.tests), default=0.0)
        self._position_noise = float(np.hypot(self._noise["position"], self._step / np.sqrt(12.0)))
        self._slipped = False
        self._floors: dict[str, float] = {}

    def run(self) -> None:
        """Run all simulations; ``findings`` and ``errors`` then hold the results."""
        self._resolution()
        self._drive()
        self._quiet()
        coil = self._coil()
        free, back_emf = self._free()
        mechanics = self._simulate_motion("spring", self._fixture, (*MOVING, *SPRING), on_tissue=False)
        tests = [test for test in self._tissue if test.repeat_of is None]
        tissue = self._simulate_motion("tissue", tests, (*MOVING, *TISSUE), on_tissue=True)
        self._assign_stage(coil, free, back_emf, mechanics, tissue)
        self.findings.sort(key=lambda item: -item.weight)

    def _add(
        self, stage: Stage, what: Message, times: float, channel: str, floor: float, least: float = MARGIN
    ) -> None:
        if times > least:
            self.findings.append(StageFinding(stage, what, float(np.log(times)), channel, times * floor, floor))

    # -- sensing and environment alone -------------------------------------------------------------------------

    def _resolution(self) -> None:
        if self._step > _QUANTISATION_RATIO * self._noise["position"]:
            times = self._position_noise / self._noise["position"]
            what = Message(
                "evidence.coarse_position", "Position in steps of {step_um:.3g} µm", step_um=1e6 * self._step
            )
            self._add("sensing", what, times, "position", self._noise["position"])
        for name, whole in self._dataset.impulsive.items():
            what = Message("evidence.outliers", "Isolated outliers in the {channel}", channel=name)
            self._add("sensing", what, whole / self._noise[name], name, self._noise[name])

    def _quiet(self) -> None:
        quiet = [test for test in self._dataset.tests if test.quiet]
        # A probe off the skin does not measure the motion of the skin.
        resting = [test for test in quiet if float(np.nanstd(_settled(test))) < _RESTING_M]
        restless = [quiet_motion(test.signals["position"], test.sample_rate_hz) for test in resting]
        floor = self._position_noise
        self.errors["quiet"] = max(restless, default=floor) / floor
        what = Message("evidence.quiet_motion", "The position moves without a command")
        self._add("environment", what, self.errors["quiet"], "position", floor)

    def _without_lines(self, answer: StageSimulation, floor: float, source: str) -> float:
        """Return the largest error of a simulation in floors without mains lines, which become a finding."""
        remaining, hum = [], []
        for test in answer.tests:
            residual = answer.residual(test)
            mains = mains_lines(residual, test.sample_rate_hz)
            hum.append(mains.deviation)
            remaining.append(float(np.nanstd((residual - mains.waveform)[_SETTLED:])))
        times = float(np.hypot(max(hum), floor)) / floor
        what = Message(
            "evidence.mains",
            "Mains lines in the {channel}, relative to the prediction {source}",
            channel=answer.channel,
            source=source,
        )
        self._add("environment", what, times, answer.channel, floor)
        return max(remaining) / floor

    # -- upstream of the motion ---------------------------------------------------------------------------------

    def _drive(self) -> None:
        if "voltage" not in self._has:
            return
        floor = self._noise["voltage"]
        answer = simulate_stage(self._baseline, self._dataset.tests, (), "voltage", DRIVE, floor)
        self.errors["drive"] = self._without_lines(answer, floor, _FROM_COMMAND)
        if self.errors["drive"] <= MARGIN:
            return
        moved = [
            lost_samples(test.command, test.signals["voltage"], test.sample_rate_hz)
            for test in answer.tests
            if not test.quiet
        ]
        worst = max(moved, key=abs, default=0)
        if worst:
            self._slipped = True
            what = Message(
                "evidence.lost_samples",
                "The record is shifted by {count} samples against the command",
                count=abs(worst),
            )
            self._add("sensing", what, self.errors["drive"], "voltage", floor)
        else:
            what = Message("evidence.voltage", "The voltage does not follow the command")
            self._add("drive", what, self.errors["drive"], "voltage", floor)

    def _coil_floor(self) -> float:
        instrument = self._baseline.parameters.instrument(self._baseline.theta)
        rate = self._dataset.tests[0].sample_rate_hz
        from_motion = instrument.force_constant_n_per_a * velocity_noise(self._position_noise, rate)
        return float(
            np.hypot(self._noise["current"], np.hypot(from_motion, self._noise["voltage"]) / instrument.resistance_ohm)
        )

    def _coil(self) -> float:
        if not {"voltage", "current"} <= self._has:
            return 1.0
        floor, tests = self._coil_floor(), self._dataset.tests
        names = ("voltage", "motion")
        answer = simulate_stage(self._baseline, tests, names, "current", COIL, self._noise["current"])
        self.errors["coil"] = self._without_lines(answer, floor, _FROM_VOLTAGE_AND_MOTION)
        return self.errors["coil"]

    def _free(self) -> tuple[float, BackEmfShare]:
        """Return the error of the current from the voltage, and which motion it follows: recorded or simulated."""
        unknown = BackEmfShare(float("nan"), float("inf"))
        tests = [*self._tissue[:1], *self._fixture[:1]]
        if not {"voltage", "current"} <= self._has or not tests:
            return 1.0, unknown
        floor = self._noise["current"]
        free = (*COIL, *MOVING[1:], *TISSUE, *SPRING)
        answer = simulate_stage(self._baseline, tests, ("voltage",), "current", free, floor, ("position",))
        self.errors["free current"] = self._without_lines(answer, floor, _FROM_VOLTAGE)
        back_emf = [back_emf_share(self._baseline, answer, test, floor, self._position_noise) for test in tests]
        weights = np.array([item.error**-2.0 for item in back_emf])
        if not weights.sum() > 0.0:
            return self.errors["free current"], unknown
        shares = np.nan_to_num([item.share for item in back_emf])
        return self.errors["free current"], BackEmfShare(
            float(weights @ shares / weights.sum()), float(weights.sum() ** -0.5)
        )

    # -- the motion ---------------------------------------------------------------------------------------------

    def _motion_floor(self, tests: Sequence[DatasetTest], upstream: tuple[str, ...]) -> float:
        # The measured current drives the twin with its noise. A nearly linear twin filters the noise; friction turns it
        # into motion above the noise of the position.
        if not upstream or not self._baseline.parameters.effects:
            return self._position_noise
        carried = propagated_noise(self._baseline, tests, upstream[0], self._noise[upstream[0]])
        return float(np.hypot(self._position_noise, carried))

    def _simulate_motion(
        self, name: str, tests: Sequence[DatasetTest], free: Sequence[str], *, on_tissue: bool
    ) -> list[ForceFamily]:
        if not tests:
            return []
        upstream = ("current",) if "current" in self._has else ("voltage",) if "voltage" in self._has else ()
        floor = self._floors[name] = self._motion_floor(tests, upstream)
        answer = simulate_stage(self._baseline, tests, upstream, "position", free, floor)
        if _worst(answer) > _REFIT_ERROR * floor:
            # Another stage can have misled the baseline: fit again from the starting values.
            afresh = self._baseline.parameters.array("start")
            again = simulate_stage(self._baseline, tests, upstream, "position", free, floor, theta=afresh)
            answer = again if _worst(again) < _worst(answer) else answer
        self._without_lines(answer, floor, _FROM_CURRENT)
        families = force_families(self._baseline, answer, tests, floor, on_tissue=on_tissue)
        if (
            families
            and families[0].after > _UNCHANGED_ERROR_SHARE * families[0].before > _UNCHANGED_ERROR_SHARE * MARGIN
        ):
            # If recorded and simulated motion differ much, as at an end stop, the force depends on the recorded one.
            along = force_families(self._baseline, answer, tests, floor, on_tissue=on_tissue, recorded=True)
            families = along if along[0].after < families[0].after else families
        self.errors[name] = families[0].before if families else 1.0
        return _without_periodic_motion(families)

    def _assign_stage(
        self,
        coil: float,
        free: float,
        back_emf: BackEmfShare,
        mechanics: Sequence[ForceFamily],
        tissue: Sequence[ForceFamily],
    ) -> None:
        wrong_reading = (
            bool(np.isfinite(back_emf.share)) and back_emf.error < 0.04 and back_emf.share + 2.0 * back_emf.error < 0.2
        )
        if self._fixture and self.errors["spring"] <= MARGIN:
            # A faulty sensor is faulty on the spring as well.
            wrong_reading = False
        drive = self.errors.get("drive", 1.0)
        if coil > MARGIN and not self._slipped:
            # A voltage that the amplifier does not deliver is missing in the current.
            resistance = self._dataset.instrument.coil_resistance_ohm
            from_drive = drive > MARGIN and drive * self._noise["voltage"] > coil * self._coil_floor() * resistance
            healed = (
                free < max(MARGIN, 1.0 + 0.25 * (coil - 1.0))
                and back_emf.share + 2.0 * back_emf.error < _LEAST_BACK_EMF_SHARE
            )
            # A true delay is the same on tissue and on the spring.
            asked = [item for item in (tissue, mechanics) if item and item[0].before > MARGIN]
            late = any(map(_late, asked)) and all(item[0].stage == "drive" for item in asked)
            if from_drive:
                wrong_reading = False
            elif healed:
                what = Message("evidence.back_emf", "The position contradicts the motion that the back-EMF shows")
                self._add("sensing", what, coil, "current", self._coil_floor())
            elif late:
                what = Message("evidence.lag", "Current and motion lag the command")
                self._add("drive", what, coil, "current", self._coil_floor())
            else:
                what = Message("evidence.current", "The current does not follow from voltage and motion")
                self._add("coil", what, coil, "current", self._coil_floor())
        at_coil = any(item.stage == "coil" for item in self.findings)
        for name, families in (("spring", mechanics), ("tissue", tissue)):
            times = self.errors.get(name, 1.0)
            if not families or self._slipped or max(times / MARGIN, families[0].gain / _LEAST_GAIN) <= 1.0:
                continue
            floor = self._floors[name]
            if wrong_reading and not at_coil:
                self._add("sensing", _READINGS[name], times, "position", floor)
                continue
            chosen = self._force_at_fault(name, families, at_coil, coil)
            what = Message(_FORCES[name].code, _FORCES[name].template, kind=chosen.kind)
            self._add(chosen.stage, what, times, "position", floor, least=1.0)

    def _force_at_fault(self, name: str, families: Sequence[ForceFamily], at_coil: bool, coil: float) -> ForceFamily:
        if not (coil > MARGIN and _late(families)) or at_coil:
            families = [item for item in families if item.stage != "drive"]
        on_fixture = self.errors.get("spring", 1.0) > MARGIN
        best = families[0]
        if name == "tissue" and self._fixture and not on_fixture:
            # An effect that is absent on the spring belongs to the tissue or the surroundings.
            return next((item for item in families if item.stage in ("tissue", "environment")), best)
        if name == "tissue" and on_fixture:
            best = next((item for item in families if item.stage not in ("tissue", "environment")), best)
        if self.errors.get("quiet", 1.0) > MARGIN and self.errors["quiet"] > 0.3 * self.errors[name]:
            return next((item for item in families if item.stage == "environment"), best)
        if best.kind == PERIODIC and not on_fixture:
            # Over about one period a periodic force imitates any curved law, and a law of the tissue is likelier.
            law = next((item for item in families if item.kind == DEPTH), best)
            best = law if law.gain >= _STATIC_GAIN_SHARE * best.gain else best
        ours = next((item for item in families if item.stage == "coil"), best)
        return ours if at_coil and ours.gain > 0.3 * best.gain else best


def _without_periodic_motion(families: Sequence[ForceFamily]) -> list[ForceFamily]:
    """Order periodic motion behind forces of time and past unless clearly better: it is flexible enough for both."""
    others = [item for item in families if item.kind in OF_TIME_AND_PAST]
    best = max((item.gain for item in others), default=-np.inf)
    held_back = [item for item in families if item.stage == "environment" and item.gain < best + _PERIODIC_LEAD]
    return sorted(families, key=lambda item: -(min(item.gain, best - 1e-6) if item in held_back else item.gain))


def _late(families: Sequence[ForceFamily]) -> bool:
    if not families or families[0].stage != "drive" or families[0].gain < 5.0 * _LEAST_GAIN:
        return False
    return families[0].after < max(1.1, 0.6 * families[0].before)


def _worst(answer: StageSimulation) -> float:
    return max(float(np.nanstd(answer.residual(test)[_SETTLED:])) for test in answer.tests)


def _settled(test: DatasetTest) -> FloatArray:
    return test.signals["position"][settling_samples(test.command.size, test.sample_rate_hz) :]


@dataclass(frozen=True)
class Localisation:
    """Stage and regions in which a recording differs from the refitted baseline.

    ``stage`` has the largest of the ``shares``, which add up to 1. All shares are 0 where nothing is above the floor;
    ``stage`` is then the closest to it. ``findings`` give the reasons, heaviest first. ``nearest`` holds the error of
    each stage in floors, ``errors`` that of each simulation: ``drive``, ``coil``, ``free current`` (from measured
    voltage without the position), ``spring``, ``tissue``.
    """

    stage: Stage
    shares: dict[Stage, float]
    findings: tuple[StageFinding, ...]
    regions: ErrorRegions
    nearest: dict[Stage, float] = field(repr=False)
    errors: dict[str, float] = field(repr=False)

    @property
    def above_floor(self) -> bool:
        """Whether any stage is above its floor."""
        return any(share > 0.0 for share in self.shares.values())

    def neutral(self) -> Localisation:
        """Return a copy without a stage at fault and without regions, for a recording that the whole twin explains.

        A stage alone is driven by measured signals, whose noise can cause a larger error than that of the whole twin.
        Insignificant shares would contradict the verdict.
        """
        return replace(self, shares=dict.fromkeys(STAGES, 0.0), findings=(), regions=self.regions.unmarked())

    def as_answer(self) -> dict[str, Any]:
        """Return plain values for JSON under the contract's names, SI, with the findings by stage."""
        return {
            "stage": self.stage,
            "stages": {stage: self.shares[stage] for stage in STAGES},
            **self.regions.as_answer(),
            "findings": [item.as_answer() for item in self.findings],
        }


def localise(dataset: Dataset, baseline: Candidate) -> Localisation:
    """Localise the gap of a refitted baseline, without any list of effects.

    Args:
        dataset: the tests.
        baseline: the refitted baseline with its errors on held-out data.
    """
    analysis = _StageAnalysis(without_outliers(dataset, baseline.fit), baseline.fit)
    analysis.run()
    nearest = {stage: analysis.errors[name] for name, stage in _SIMULATED.items() if name in analysis.errors}
    weights = dict.fromkeys(STAGES, 0.0)
    for item in analysis.findings:
        weights[item.stage] = max(weights[item.stage], item.weight)
    total = sum(weights.values())
    shares = {stage: weight / total if total > 0.0 else 0.0 for stage, weight in weights.items()}
    blamed = max(STAGES, key=lambda stage: (weights[stage], nearest.get(stage, 0.0)))
    regions = find_error_regions(dataset, baseline.fit)
    return Localisation(blamed, shares, tuple(analysis.findings), regions, nearest, analysis.errors)
