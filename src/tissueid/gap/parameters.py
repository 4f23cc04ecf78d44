"""The parameters of a fit: instrument, tissue, fixture and effects as one vector with bounds and priors.

Positive parameters are fitted by their logarithm, within bounds from the calibration's uncertainty. Without bounds the
fit diverges into an implausible instrument.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.dataset import Dataset, DatasetTest, Prior, Purpose
from tissueid.gap.equivalent_oscillator import FORCE_N, MOST_DELAY_SAMPLES
from tissueid.twin.chain_parameters import COUPLING, STANDARD_GRAVITY, InstrumentParameters, Tissue, nothing, spring
from tissueid.twin.effect import Effect, Parameter
from tissueid.twin.simulation import ActiveEffect

FloatArray = NDArray[np.float64]
Starts = tuple[tuple[float, ...], ...]

DELAY = "input_delay_s"
"""Delay of the output of an input-output record, which its sampling leaves open."""
WITHIN_STDS = 4.0
"""Bounds of the instrument's parameters around the nominal values, in calibration uncertainties."""

WIDER = 20.0
"""Factor of the step of numerical derivatives where an effect switches: about 2 % of a value."""


@dataclass(frozen=True)
class Coordinate:
    """One fitted number: starting value, bounds, prior and step of its derivative."""

    name: str
    start: float
    low: float
    high: float
    step: float
    """Step of its numerical derivative."""
    reach: float
    """Largest change in one step of the optimiser."""
    prior: float = 0.0
    prior_std: float = np.inf
    test: int | None = None
    """Number of its test; None where all tests share it."""


INSTRUMENT_COORDINATES = {
    "amplifier_gain": "amplifier_gain",
    "resistance_ohm": "coil_resistance_ohm",
    "inductance_h": "coil_inductance_h",
    "force_constant_n_per_a": "force_constant_n_per_a",
    "moving_mass_kg": "moving_mass_kg",
    "bearing_damping_n_s_per_m": "bearing_damping_n_s_per_m",
}
"""Coordinates (logarithm of the ratio to the nominal value) and the device's name of the parameter."""
_TISSUE = (
    # name, most probable value, low, high, logarithmic, std of the prior (of the logarithm where logarithmic)
    ("tissue_mass_kg", 0.012, 1e-4, 0.2, True, 1.5),
    ("tissue_damping_n_s_per_m", 5.0, 0.05, 80.0, True, 1.0),
    ("tissue_damping_growth_per_m", 200.0, -400.0, 1000.0, False, 200.0),
    ("tissue_stiffness_n_per_m", 400.0, 10.0, 20000.0, True, 1.0),
    ("tissue_stiffness_growth_per_m", 200.0, -400.0, 1000.0, False, 200.0),
)
SURFACE_SHIFT, SPRING_SHIFT = "surface_shift_m", "spring_shift_m"
SURFACE_STD_M = 2e-4
"""Standard deviation of the detected surface of tissue or spring where the test does not begin at it, m."""
_SPRING = (
    ("spring_mass_kg", 0.004, 0.0, 0.02, False, 0.005),
    ("spring_damping_n_s_per_m", 0.3, 0.0, 5.0, False, 0.5),
    ("spring_stiffness_ratio", 0.0, -0.06, 0.06, False, 0.015),
)


TISSUE_COORDINATES = {name: name.removeprefix("tissue_") for name, *_ in _TISSUE}
LOGARITHMIC_TISSUE = tuple(item[0] for item in _TISSUE if item[4])
SPRING_COORDINATES = {name: (likely, std) for name, likely, _, _, _, std in _SPRING}
"""Most probable value and standard deviation of the parameters of the spring."""
_WITHOUT_INFLUENCE = ("amplifier_gain", "resistance_ohm", "inductance_h", "force_constant_n_per_a")
"""Parameters without influence where the current is the excitation: its force only scales mass, damping and stiffness.
"""
_WIDE = 3.5
"""Bounds of the equivalent oscillator around its least-squares estimate, in powers of e."""
_REST_M = 2e-4
_COUPLING = ("coupling_hz", "coupling_damping_ratio", "coupling_mass_ratio", "coupling_drag_1_s")
"""Coordinates of the coupling of two masses, logarithmic."""
_COUPLING_RANGES = (1.2, 3.5, 3.5, 6.0)


@dataclass(frozen=True)
class Parametrisation:
    """All coordinates of a fit, in order, and their conversion to a twin of each test."""

    dataset: Dataset = field(repr=False)
    effects: tuple[Effect, ...]
    coordinates: tuple[Coordinate, ...]
    index: dict[str, int] = field(repr=False)
    constants: dict[str, float] = field(repr=False, default_factory=dict)
    """Parameters of effects that are estimated from the record and not fitted."""

    def without(self, name: str) -> Parametrisation:
        """Return the coordinates of a chain without one of the effects."""
        return replace(self, effects=tuple(effect for effect in self.effects if effect.name != name))

    def re_estimate(self, effect: Effect, predictions: Sequence[Mapping[str, FloatArray]]) -> Parametrisation:
        """Return a copy with per-test constants of ``effect`` re-estimated from the residual without that effect."""
        tests = self.dataset.tests
        signals = [_signals(test, predicted) for test, predicted in zip(tests, predictions, strict=True)]
        fresh = {
            f"{effect.name}.{name}@{test.number}": value
            for test, read in zip(tests, _estimate_all(tests, effect, signals), strict=True)
            for name, value in read.items()
        }
        return replace(self, constants={name: fresh.get(name, value) for name, value in self.constants.items()})

    def array(self, what: str) -> FloatArray:
        """Return one property of every coordinate, shape (size,)."""
        return np.array([getattr(item, what) for item in self.coordinates], np.float64)

    def instrument(self, theta: FloatArray) -> InstrumentParameters:
        """Return the instrument of a vector."""
        device = self.dataset.instrument
        figures = {
            ours: getattr(device, theirs) * np.exp(self.value(theta, ours))
            for ours, theirs in INSTRUMENT_COORDINATES.items()
        }
        return InstrumentParameters(
            amplifier_limit_v=device.amplifier_limit_v,
            weight_n=self.value(theta, "weight_n"),
            stroke_m=device.stroke_m,
            filter_time_s=device.filter_time_s,
            **figures,
        )

    def tissue_of(self, theta: FloatArray, test: DatasetTest) -> Tissue:
        """Return the tissue, spring or free air of a test."""
        if test.fixture == "air":
            return nothing()
        if test.fixture == "spring":
            nominal = self.dataset.instrument.calibration_spring_n_per_m
            stiffness = nominal * float(np.exp(self.value(theta, "spring_stiffness_ratio")))
            mass, damping = self.value(theta, "spring_mass_kg"), self.value(theta, "spring_damping_n_s_per_m")
            return spring(test.surface_m + self.value(theta, SPRING_SHIFT), stiffness, mass, damping)
        if self.dataset.equivalent is not None:
            if not self.dataset.equivalent.has_spring:
                return nothing()
            rest = test.surface_m + self.value(theta, "rest_m")
            return spring(rest, float(np.exp(self.value(theta, "tissue_stiffness_n_per_m"))))
        values = [
            float(np.exp(self.value(theta, name))) if logarithmic else self.value(theta, name)
            for name, _, _, _, logarithmic, _ in _TISSUE
        ]
        return Tissue(test.surface_m + self.value(theta, SURFACE_SHIFT), *values)

    def acting(self, theta: FloatArray, test: DatasetTest) -> list[ActiveEffect]:
        """Return the effects with their parameters in a test, after the coupling of an equivalent machine."""
        active = [ActiveEffect(effect, self.effect_values(theta, effect, test.number)) for effect in self.effects]
        about = self.dataset.equivalent
        if about is None or not about.has_coupling:
            return active
        values = [float(np.exp(self.value(theta, name))) for name in _COUPLING]
        return [ActiveEffect(COUPLING, np.array([*values, float(about.family == "far_mass")])), *active]

    def fastest(self, theta: FloatArray) -> float:
        """Return the angular frequency of the coupling of an equivalent machine, rad/s; 0 without a coupling."""
        if _COUPLING[0] not in self.index:
            return 0.0
        lighter = min(float(np.exp(self.value(theta, _COUPLING[2]))), 1.0)
        return 2.0 * np.pi * float(np.exp(self.value(theta, _COUPLING[0]))) * float(np.sqrt(1.0 + 1.0 / lighter))

    def effect_values(self, theta: FloatArray, effect: Effect, test: int) -> FloatArray:
        """Return the parameters of an effect in a test, SI, in the order of their declaration."""
        values = np.empty(len(effect.parameters))
        for k, parameter in enumerate(effect.parameters):
            name = f"{effect.name}.{parameter.name}" + (f"@{test}" if parameter.per_test else "")
            if name in self.constants:
                values[k] = self.constants[name]
                continue
            value = self.value(theta, name)
            values[k] = np.exp(value) if parameter.logarithmic else value
        return values

    def irreducible(self, theta: FloatArray, test: int) -> dict[str, float]:
        """Return the standard deviation by channel, SI, that effects leave in a test, however well known they are.

        It includes the error that a saved twin is known to leave.
        """
        squares = {name: std**2 for name, std in self._unmodelled(test).items()}
        for effect in self.effects:
            if effect.irreducible is not None:
                for name, std in effect.irreducible(self.effect_values(theta, effect, test)).items():
                    squares[name] = squares.get(name, 0.0) + std**2
        return {name: float(np.sqrt(square)) for name, square in squares.items()}

    def _unmodelled(self, number: int) -> dict[str, float]:
        test = next((test for test in self.dataset.tests if test.number == number), None)
        if test is None or test.fixture != "tissue":
            return {}
        return {name: share * test.spreads.get(name, 0.0) for name, share in self.dataset.unmodelled.items()}

    def value(self, theta: FloatArray, name: str) -> float:
        """Return a coordinate by name in fitted units; where it is not fitted, its constant value (0 by default)."""
        return float(theta[self.index[name]]) if name in self.index else self.constants.get(name, 0.0)


def starts_of(dataset: Dataset, effect: Effect, predictions: Sequence[Mapping[str, FloatArray]]) -> Starts:
    """Return all starting points of an effect: declared ones, and those from the signals that lie within its bounds."""
    if effect.starts_from is None:
        return effect.starts
    signals = [_signals(test, predicted) for test, predicted in zip(dataset.tests, predictions, strict=True)]
    from_signals = effect.starts_from(signals, dataset.tests[0].sample_rate_hz)
    within = (
        start
        for start in from_signals
        if all(item.low <= value <= item.high for item, value in zip(effect.parameters, start, strict=True))
    )
    return (*effect.starts, *within)


def parametrise(
    dataset: Dataset,
    effects: Sequence[Effect] = (),
    starts: Sequence[Sequence[float]] = (),
    predictions: Sequence[Mapping[str, FloatArray]] = (),
    continued: Parametrisation | None = None,
) -> Parametrisation:
    """Return the coordinates of baseline and effects.

    Args:
        dataset: the tests.
        effects: effects in addition to the baseline.
        starts: starting point of each effect; its first declared one where there is none.
        predictions: predictions of a fitted baseline for each test, where there is one.
        continued: coordinates of a fit that is continued. Its estimates from the record are kept: they must not be
            repeated on a residual that they have already reduced, and they take time.
    """
    coordinates = _of_mass(dataset) if dataset.equivalent is not None else _of_instrument(dataset)
    constants: dict[str, float] = {}
    signals = [_signals(test, predictions[k] if k < len(predictions) else {}) for k, test in enumerate(dataset.tests)]
    for k, effect in enumerate(effects):
        start = starts[k] if k < len(starts) else effect.starts[0]
        has_been_read = continued is not None and effect in continued.effects
        read = [{} for _ in signals] if has_been_read else _estimate_all(dataset.tests, effect, signals)
        for parameter, begin in zip(effect.parameters, start, strict=True):
            _add(dataset, effect, parameter, begin, read, coordinates, constants)
    if any(effect.switches for effect in effects):
        coordinates = [replace(item, step=WIDER * item.step) for item in coordinates]
    coordinates = [_with_prior(item, dataset.priors) for item in coordinates]
    constants |= {name: held.value for name, held in dataset.priors.items() if name in constants and "@" not in name}
    if continued is not None:
        both = {effect.name for effect in effects} & {effect.name for effect in continued.effects}
        constants |= {name: value for name, value in continued.constants.items() if name.partition(".")[0] in both}
    index = {item.name: k for k, item in enumerate(coordinates)}
    return Parametrisation(dataset, tuple(effects), tuple(coordinates), index, constants)


def _with_prior(item: Coordinate, priors: Mapping[str, Prior]) -> Coordinate:
    """Return a coordinate with the value of a saved twin, as a prior where the twin holds its uncertainty."""
    held = priors.get(item.name)
    if held is None:
        return item
    start = min(max(held.value, item.low), item.high)
    if held.std is None:
        return replace(item, start=start)
    return replace(item, start=start, prior=start, prior_std=min(held.std, item.prior_std))


def _of_instrument(dataset: Dataset) -> list[Coordinate]:
    """Return the coordinates of instrument, tissue and fixture."""
    spread = dataset.instrument.calibration_relative_uncertainty
    wide = WITHIN_STDS * spread
    driven = {test.driven_by for test in dataset.tests}
    left_out = _WITHOUT_INFLUENCE if driven == {"current"} else ("amplifier_gain",) if "command" not in driven else ()
    coordinates = [
        Coordinate(ours, 0.0, -wide, wide, 1e-4, wide, 0.0, spread)
        for ours in INSTRUMENT_COORDINATES
        if ours not in left_out
    ]
    weight = dataset.instrument.moving_mass_kg * STANDARD_GRAVITY
    along, uncertainty = dataset.gravity_m_s2
    likely = dataset.instrument.moving_mass_kg * along
    std = float(np.hypot(dataset.instrument.moving_mass_kg * uncertainty, spread * likely))
    coordinates.append(Coordinate("weight_n", likely, -1.1 * weight, 1.1 * weight, 1e-3, weight, likely, std))
    if any(test.fixture == "tissue" for test in dataset.tests):
        coordinates += [_scaled(*item) for item in _TISSUE]
    if any(test.fixture == "spring" for test in dataset.tests):
        coordinates += [_scaled(*item) for item in _SPRING]
    for fixture, name in (("tissue", SURFACE_SHIFT), ("spring", SPRING_SHIFT)):
        if any(test.fixture == fixture and not test.starts_at_surface for test in dataset.tests):
            coordinates.append(Coordinate(name, 0.0, -1e-3, 1e-3, 1e-6, SURFACE_STD_M, 0.0, SURFACE_STD_M))
    return coordinates


def _of_mass(dataset: Dataset) -> list[Coordinate]:
    """Return the coordinates of an equivalent machine, its rest position, and the delay of the input."""
    about = dataset.equivalent
    assert about is not None
    rate = dataset.tests[0].sample_rate_hz
    stiffness = float(np.log(about.stiffness_n_per_m))
    late = MOST_DELAY_SAMPLES / rate
    coordinates = [
        Coordinate("moving_mass_kg", 0.0, -_WIDE, _WIDE, 1e-4, 0.3),
        Coordinate("bearing_damping_n_s_per_m", 0.0, -_WIDE, _WIDE, 1e-3, 0.5),
        Coordinate("weight_n", 0.0, -3.0 * FORCE_N, 3.0 * FORCE_N, 1e-3, FORCE_N, 0.0, FORCE_N),
        Coordinate(DELAY, about.delay_s, about.delay_s - late, about.delay_s + late, 1e-3 / rate, 0.2 / rate),
    ]
    if about.has_spring:
        coordinates[2:2] = [
            Coordinate("tissue_stiffness_n_per_m", stiffness, stiffness - _WIDE, stiffness + _WIDE, 1e-4, 0.3)
        ]
        coordinates[4:4] = [Coordinate("rest_m", 0.0, -5.0 * _REST_M, 5.0 * _REST_M, 1e-6, _REST_M, 0.0, _REST_M)]
    if about.has_coupling:
        for name, start, wide in zip(_COUPLING, about.coupling, _COUPLING_RANGES, strict=True):
            at = float(np.log(start))
            coordinates.append(Coordinate(name, at, at - wide, at + wide, 1e-3, 0.3))
    return coordinates


def _signals(test: DatasetTest, predicted: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    return {
        "command": test.command,
        **test.signals,
        **{f"predicted_{name}": values for name, values in predicted.items()},
    }


def _scaled(name: str, likely: float, low: float, high: float, logarithmic: bool, std: float) -> Coordinate:
    if logarithmic:
        return Coordinate(name, np.log(likely), np.log(low), np.log(high), 1e-3, std, np.log(likely), std)
    return Coordinate(name, likely, low, high, 1e-3 * std, std, likely, std)


def _estimate(effect: Effect, signals: Mapping[str, FloatArray], sample_rate_hz: float) -> Mapping[str, float]:
    if effect.estimate_from_record is None or not effect.needs <= set(signals):
        return {}
    return effect.estimate_from_record(signals, sample_rate_hz)


def _estimate_all(
    tests: Sequence[DatasetTest], effect: Effect, signals: Sequence[Mapping[str, FloatArray]]
) -> list[Mapping[str, float]]:
    if effect.estimate_from_records is None:
        return [
            _estimate(effect, test_signals, test.sample_rate_hz)
            for test, test_signals in zip(tests, signals, strict=True)
        ]
    acts = [
        k
        for k, test in enumerate(tests)
        if (test.fixture == "tissue" or effect.on_spring) and effect.needs <= set(signals[k])
    ]
    estimates: list[Mapping[str, float]] = [{} for _ in tests]
    used = [_used(tests[k], signals[k]) for k in acts]
    for k, values in zip(acts, effect.estimate_from_records(used, tests[0].sample_rate_hz), strict=True):
        estimates[k] = values
    return estimates


def _used(test: DatasetTest, signals: Mapping[str, FloatArray]) -> Mapping[str, FloatArray]:
    # Without values that are not used, for instance after the end of contact.
    used = test.purpose != Purpose.NOTHING
    recorded = {name: np.where(used, values, np.nan) for name, values in test.signals.items()}
    return {**signals, **recorded}


def _add(
    dataset: Dataset,
    effect: Effect,
    parameter: Parameter,
    begin: float,
    read: Sequence[Mapping[str, float]],
    coordinates: list[Coordinate],
    constants: dict[str, float],
) -> None:
    # Coordinates of one parameter, one in all or one a test; or its constants.
    name = f"{effect.name}.{parameter.name}"
    if not parameter.per_test:
        if parameter.fixed:
            constants[name] = begin
        else:
            coordinates.append(_coordinate(name, parameter, begin, None))
        return
    for test, values in zip(dataset.tests, read, strict=True):
        at = values.get(parameter.name, begin)
        # A test that is held out completely is not fitted: its own parameters keep their estimates.
        if parameter.fixed or not test.serving(Purpose.FIT).any():
            constants[f"{name}@{test.number}"] = at
        else:
            coordinates.append(_coordinate(f"{name}@{test.number}", parameter, at, test.number))


def _coordinate(name: str, parameter: Parameter, begin: float, test: int | None) -> Coordinate:
    low, high, prior = parameter.low, parameter.high, parameter.prior
    begin = min(max(begin, low), high)
    if parameter.logarithmic:
        low, high, begin = float(np.log(low)), float(np.log(high)), float(np.log(begin))
        prior = None if prior is None else float(np.log(prior))
    std = np.inf if parameter.prior_std is None else parameter.prior_std
    # Step of a derivative: 1/5000 of the range, or 1/1000 of the value where the logarithm is fitted.
    step = 1e-3 if parameter.logarithmic else 2e-4 * (high - low)
    reach = 0.7 if parameter.logarithmic else 0.1 * (high - low)
    return Coordinate(name, begin, low, high, step, reach, begin if prior is None else prior, std, test)
