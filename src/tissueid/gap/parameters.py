"""The parameters of a fit: instrument, tissue, fixture and effects as one vector with bounds and priors.

Positive figures are fitted by their logarithm, within bounds that follow from the calibration's uncertainty; without
bounds a bounded explanation is lost in an unbounded one, and the fit runs away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissueid.gap.observed import Observed, ObservedTest
from tissueid.twin.effect import Effect
from tissueid.twin.figures import STANDARD_GRAVITY, Instrument, Tissue, nothing, spring
from tissueid.twin.simulation import Acting

FloatArray = NDArray[np.float64]

WITHIN_STDS = 3.0
"""Instrument figures are looked for so many calibration uncertainties round the nominal ones."""


@dataclass(frozen=True)
class Coordinate:
    """One fitted number: where it starts, its bounds, its prior and the step of its derivative."""

    name: str
    start: float
    low: float
    high: float
    step: float
    """Of its numerical derivative."""
    reach: float
    """How far one step of the search may take it."""
    prior: float = 0.0
    prior_std: float = np.inf
    test: int | None = None
    """The number of the test that it belongs to; None where all share it."""


_INSTRUMENT = (
    ("amplifier_gain", "amplifier_gain"),
    ("resistance_ohm", "coil_resistance_ohm"),
    ("inductance_h", "coil_inductance_h"),
    ("force_constant_n_per_a", "force_constant_n_per_a"),
    ("moving_mass_kg", "moving_mass_kg"),
    ("bearing_damping_n_s_per_m", "bearing_damping_n_s_per_m"),
)
_TISSUE = (
    # name, likeliest, low, high, logarithmic, std of the prior (of the logarithm where logarithmic)
    ("tissue_mass_kg", 0.012, 1e-4, 0.2, True, 1.5),
    ("tissue_damping_n_s_per_m", 5.0, 0.05, 80.0, True, 1.0),
    ("tissue_damping_growth_per_m", 200.0, -400.0, 1000.0, False, 200.0),
    ("tissue_stiffness_n_per_m", 400.0, 10.0, 20000.0, True, 1.0),
    ("tissue_stiffness_growth_per_m", 200.0, -400.0, 1000.0, False, 200.0),
)
_SPRING = (
    ("spring_mass_kg", 0.004, 0.0, 0.02, False, 0.005),
    ("spring_damping_n_s_per_m", 0.3, 0.0, 5.0, False, 0.5),
    ("spring_stiffness_ratio", 0.0, -0.06, 0.06, False, 0.015),
)


@dataclass(frozen=True)
class Parametrisation:
    """All coordinates of a fit, in order, and how they make a twin of each test."""

    observed: Observed = field(repr=False)
    effects: tuple[Effect, ...]
    coordinates: tuple[Coordinate, ...]
    index: dict[str, int] = field(repr=False)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.coordinates)

    def array(self, what: str) -> FloatArray:
        """One property of every coordinate, shape (size,)."""
        return np.array([getattr(item, what) for item in self.coordinates], np.float64)

    def instrument(self, theta: FloatArray) -> Instrument:
        """The instrument that a vector describes."""
        device = self.observed.instrument
        figures = {ours: getattr(device, theirs) * np.exp(self._at(theta, ours)) for ours, theirs in _INSTRUMENT}
        return Instrument(
            amplifier_limit_v=device.amplifier_limit_v,
            weight_n=self._at(theta, "weight_n"),
            stroke_m=device.stroke_m,
            **figures,
        )

    def met(self, theta: FloatArray, test: ObservedTest) -> Tissue:
        """What the probe meets in a test."""
        if test.fixture == "air":
            return nothing()
        if test.fixture == "spring":
            nominal = self.observed.instrument.calibration_spring_n_per_m
            stiffness = nominal * float(np.exp(self._at(theta, "spring_stiffness_ratio")))
            mass, damping = self._at(theta, "spring_mass_kg"), self._at(theta, "spring_damping_n_s_per_m")
            return spring(test.surface_m, stiffness, mass, damping)
        values = [
            float(np.exp(self._at(theta, name))) if logarithmic else self._at(theta, name)
            for name, _, _, _, logarithmic, _ in _TISSUE
        ]
        return Tissue(test.surface_m, *values)

    def acting(self, theta: FloatArray, test: ObservedTest) -> list[Acting]:
        """The effects with their parameters in a test."""
        return [Acting(effect, self.effect_values(theta, effect, test.number)) for effect in self.effects]

    def effect_values(self, theta: FloatArray, effect: Effect, test: int) -> FloatArray:
        """Parameters of an effect in a test, SI, in the order of their declaration."""
        values = np.empty(len(effect.parameters))
        for k, parameter in enumerate(effect.parameters):
            name = f"{effect.name}.{parameter.name}" + (f"@{test}" if parameter.per_test else "")
            value = self._at(theta, name)
            values[k] = np.exp(value) if parameter.logarithmic else value
        return values

    def _at(self, theta: FloatArray, name: str) -> float:
        return float(theta[self.index[name]])


def parametrise(observed: Observed, effects: Sequence[Effect] = (), starts: Sequence[int] = ()) -> Parametrisation:
    """The coordinates of baseline and effects; ``starts`` chooses one of each effect's starting points."""
    spread = observed.instrument.calibration_relative_uncertainty
    wide = WITHIN_STDS * spread
    found = [Coordinate(ours, 0.0, -wide, wide, 1e-4, wide, 0.0, spread) for ours, _ in _INSTRUMENT]
    weight = observed.instrument.moving_mass_kg * STANDARD_GRAVITY
    # The device may be held at any angle: nothing in a session says which.
    found.append(Coordinate("weight_n", 0.0, -1.1 * weight, 1.1 * weight, 1e-3, weight, 0.0, weight))
    if any(test.fixture == "tissue" for test in observed.tests):
        found += [_scaled(*item) for item in _TISSUE]
    if any(test.fixture == "spring" for test in observed.tests):
        found += [_scaled(*item) for item in _SPRING]
    for k, effect in enumerate(effects):
        found += _of_effect(observed, effect, starts[k] if k < len(starts) else 0)
    index = {item.name: k for k, item in enumerate(found)}
    return Parametrisation(observed, tuple(effects), tuple(found), index)


def _scaled(name: str, likely: float, low: float, high: float, logarithmic: bool, std: float) -> Coordinate:
    if logarithmic:
        return Coordinate(name, np.log(likely), np.log(low), np.log(high), 1e-3, std, np.log(likely), std)
    return Coordinate(name, likely, low, high, 1e-3 * std, std, likely, std)


def _of_effect(observed: Observed, effect: Effect, start: int) -> list[Coordinate]:
    found = []
    for k, parameter in enumerate(effect.parameters):
        low, high, begin = parameter.low, parameter.high, effect.starts[start][k]
        prior, std = parameter.prior, parameter.prior_std
        if parameter.logarithmic:
            low, high, begin = np.log(low), np.log(high), np.log(begin)
            prior = None if prior is None else float(np.log(prior))
        # A derivative by a thousandth of the range, or of the value where a logarithm is fitted.
        step = 1e-3 if parameter.logarithmic else 2e-4 * (high - low)
        reach = 0.7 if parameter.logarithmic else 0.1 * (high - low)
        fitted = Coordinate(
            f"{effect.name}.{parameter.name}",
            begin,
            low,
            high,
            step,
            reach,
            begin if prior is None else prior,
            np.inf if std is None else std,
        )
        if not parameter.per_test:
            found.append(fitted)
            continue
        for test in observed.tests:
            at = fitted.start
            if effect.from_test is not None:
                signals = {"command": test.command, **test.signals}
                read = effect.from_test(signals, test.sample_rate_hz).get(parameter.name, effect.starts[start][k])
                at = float(np.log(read)) if parameter.logarithmic else float(read)
            found.append(
                Coordinate(
                    f"{fitted.name}@{test.number}", at, low, high, step, reach, fitted.prior, fitted.prior_std, test.number
                )
            )
    return found
