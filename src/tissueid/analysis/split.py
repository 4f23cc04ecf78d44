"""Fitted and held-out parts of the tests of a session."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypedDict

import numpy as np

from tissueid.configuration import has_depth, spring_of
from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.identification.depth_levels import localized_levels
from tissueid.identification.depth_profile import DepthProfile
from tissueid.identification.preparation import band_filtered, detrended
from tissueid.identification.validation.scores import above_noise
from tissueid.language import marked
from tissueid.messages import Listing, Message
from tissueid.records import Estimate, Record, joined
from tissueid.sessions import Session, Test
from tissueid.test_settings import placement

NOMINAL_RELATIVE_STD = 0.08
"""Relative standard deviation of nominal mass and damping: even distributions over 60 to 80 g and 3 to 4 N s/m, the
ranges of Chen 2010, Table 2.1."""

TISSUE_NAMES = {
    "mass_kg": "tissue_mass_kg",
    "damping_n_s_per_m": "tissue_damping_n_s_per_m",
    "damping_in_n_s_per_m": "tissue_damping_in_n_s_per_m",
    "damping_out_n_s_per_m": "tissue_damping_out_n_s_per_m",
}
"""Parameters of coil and tissue together, and the names of their remainders. The actuator has no stiffness."""


@dataclass(frozen=True)
class Actuator:
    """Moving mass, kg, and bearing damping, N s/m; ``calibrated`` if both are from a calibration sweep."""

    mass: Estimate
    damping: Estimate
    calibrated: bool

    @classmethod
    def of(cls, device: DeviceDescription) -> Actuator:
        """Return the actuator of a device, with the deviations of its sweep or of a nominal description."""

        calibrated = all(
            f"{name}_std" in device.calibration for name in ("moving_mass_kg", "bearing_damping_n_s_per_m")
        )
        return cls(
            _calibrated(device, "moving_mass_kg", NOMINAL_RELATIVE_STD),
            _calibrated(device, "bearing_damping_n_s_per_m", NOMINAL_RELATIVE_STD),
            calibrated,
        )

    def remainders(self, parameters: Mapping[str, Estimate]) -> dict[str, Estimate]:
        """Return mass and damping of the tissue alone by their names in ``TISSUE_NAMES``.

        The deviation combines those of the fit and of the actuator, which are independent; None without that of the
        fit.
        """
        remainders = {}
        for name, new in TISSUE_NAMES.items():
            if name in parameters:
                total, own = parameters[name], self.mass if name == "mass_kg" else self.damping
                std = None if total.std is None else math.hypot(total.std, own.std or 0.0)
                remainders[new] = Estimate(total.value - own.value, std)
        return remainders

    def without(self, profile: DepthProfile) -> DepthProfile:
        """Return a depth profile with mass and damping of the tissue alone."""
        return replace(
            profile,
            mass=profile.mass - self.mass.value,
            mass_std=np.hypot(profile.mass_std, self.mass.std or 0.0),
            damping=profile.damping - self.damping.value,
            damping_std=np.hypot(profile.damping_std, self.damping.std or 0.0),
        )


@dataclass(frozen=True)
class Coil:
    """Resistance, ohm, and force constant, N/A, of the coil."""

    resistance: Estimate
    force_constant: Estimate

    @classmethod
    def of(cls, device: DeviceDescription) -> Coil | None:
        """Return the coil of a device; None where the session does not hold its resistance or its force constant."""
        relative_std = device.calibration_relative_uncertainty
        figures = [
            _calibrated(device, name, relative_std) for name in ("coil_resistance_ohm", "force_constant_n_per_a")
        ]
        return cls(*figures) if all(figure.value > 0.0 for figure in figures) else None


def _calibrated(device: DeviceDescription, name: str, relative_std: float) -> Estimate:
    """Return a figure of a device with the deviation of its calibration, or else a relative one; None if NaN."""
    number = getattr(device, name)
    std = device.calibration.get(f"{name}_std")
    if isinstance(std, float) and math.isfinite(std):
        return Estimate(number, std)
    return Estimate(number, relative_std * abs(number) if math.isfinite(relative_std) else None)


QUARTERS = 4
_STRETCHES = 16
"""Stretches of a ramp or a hold, of each of which a quarter is held out."""
_LEAST_VARIANCE = 0.05
"""Least variance of a held-out quarter relative to that of the record: with less, every stretch has a held-out part."""
FIT_SHARE = 1.0 - 1.0 / QUARTERS
"""Share of each test that is fitted, from its start; the rest is held out unless another test is."""

SURFACE_KNOWN_TO_M = 0.3e-3
"""Difference between the surfaces of two tests, m, up to which they count as the same."""

_GRAVITY_NOTE = "gravity_along_stroke_m_s2"
_MEASURED_NOTE = "gravity_across_stroke_m_s2"
"""Note of a test whose orientation was measured and not assumed."""

_LARGEST_GRAVITY = 1.1
"""Largest plausible component of gravity along the stroke, relative to g."""

_SAME_GRAVITY_M_S2 = 0.3
"""Difference of gravity along the stroke, m/s^2, up to which two tests have the same orientation: twice its error."""


@dataclass(frozen=True, eq=False)
class Split:
    """Fitted and held-out samples. ``fit_part`` and ``held_out`` index ``record`` and ``held_out_record``.

    ``tests`` are the numbers of the fitted tests. ``records`` are their whole records where a part of each test is
    held out, and empty where another test is held out, whose number is ``validated``. ``external_spring_n_per_m`` is
    the stiffness of the external spring parallel to the tissue in all of them; 0 unless the record is force and
    position. ``surface_position_m`` is the position of the tissue surface, and ``weight_n`` the weight of the moving
    part along the stroke, N into the tissue, which the signal force does not include; None unless the tests know it.
    ``actuator`` is the moving part of the instrument where the tissue alone is to be reported; ``coil`` is its coil
    where the input is the voltage and the output the position.

    Several tests are joined with a gap between each two; no engine uses samples across a gap. Their held-out parts are
    separate stretches: ``held_out_record`` then holds the whole input, which a free run needs, and NaN for every
    output that was fitted.
    """

    record: Record
    fit_part: slice
    held_out_record: Record
    held_out: slice
    tests: tuple[int, ...]
    validated_on: str
    records: tuple[Record, ...] = ()
    validated: int | None = None
    external_spring_n_per_m: float = 0.0
    configuration: str = "indentation"
    surface_position_m: float | None = None
    weight_n: float | None = None
    actuator: Actuator | None = None
    coil: Coil | None = None

    @property
    def fitted(self) -> Record:
        """The fitted part of the record."""
        return self.record[self.fit_part]

    @property
    def unseen(self) -> Record:
        """The held-out record, with NaN for every output that is not held out."""
        output = np.full(len(self.held_out_record), np.nan)
        output[self.held_out] = self.held_out_record.output[self.held_out]
        return replace(self.held_out_record, output=output)

    @property
    def scorable(self) -> bool:
        """Whether the held-out output varies above its noise: a score relative to noise alone says nothing."""
        return above_noise(self.unseen.output, self.fitted.output)

    @property
    def other_quarters(self) -> tuple[Split, ...]:
        """The splits that hold out each of the first three quarters of each test; empty where another test is held out.

        Every ``held_out_record`` is as long as this one's, so that errors on all quarters can be joined.
        """
        return tuple(_hold_out(self.records, quarter, self.tests) for quarter in range(QUARTERS - 1) if self.records)


class Selection(TypedDict, total=False):
    """Tests and signals of an analysis, as keyword arguments of :func:`split`."""

    test: int | None
    also: Sequence[int]
    validate: int | None
    input_name: str
    output_name: str
    detrend: bool
    band_hz: tuple[float | None, float | None]


def split(
    session: Session,
    *,
    test: int | None = None,
    also: Sequence[int] = (),
    validate: int | None = None,
    input_name: str = "force",
    output_name: str = "position",
    detrend: bool = False,
    band_hz: tuple[float | None, float | None] = (None, None),
) -> Split:
    """Split tests of a session into fitted and held-out data.

    Args:
        session: the session that holds the tests.
        test: number of the fitted test; by default the first stochastic one.
        also: numbers of tests that are fitted together with it.
        validate: number of the test that is held out; by default the last quarter of every fitted test is.
        input_name: signal that is the input.
        output_name: signal that is the output.
        detrend: subtract the linear drift of each test's output.
        band_hz: edges of a band filter for input and output of each test, both fitted and held out.

    Raises:
        UnusableInputError: no such test or signal, a test given twice, or tests of different configurations or with
            different external springs.
    """
    if input_name == output_name:
        raise UnusableInputError(
            "split.same_signal", "input and output are the same signal, '{signal}'", signal=input_name
        )
    first = session.test(test)
    tests = [first, *map(session.test, also)]
    numbers = tuple(t.number for t in tests)
    for number in numbers:
        if numbers.count(number) > 1:
            raise UnusableInputError(
                "split.repeated_test", "test {number} is given twice among the tests to fit", number=number
            )
    if validate in numbers:
        raise UnusableInputError(
            "split.validates_fitted_test",
            "test {number} is fitted, so it cannot be held out: validate on another test, or on none",
            number=validate,
        )
    spring = _common_spring(tests if validate is None else [*tests, session.test(validate)])
    if (input_name, output_name) != ("force", "position"):
        spring = 0.0

    def record_of(test: Test) -> Record:
        record = test.record(input_name, output_name)
        return band_filtered(detrended(record) if detrend else record, *band_hz)

    records = tuple(map(record_of, tests))
    if validate is not None:
        record = joined(records)
        other = record_of(session.test(validate))
        whole = slice(0, len(record)), slice(0, len(other))
        parts = Split(
            record,
            whole[0],
            other,
            whole[1],
            numbers,
            Message("split.test", "test {number}", number=validate),
            validated=validate,
        )
    else:
        parts = split_records(records, numbers)
    mechanical = (input_name, output_name) == ("force", "position") and {"force", "position"} <= first.signals.keys()
    return replace(
        parts,
        external_spring_n_per_m=spring,
        configuration=first.configuration,
        surface_position_m=_common_surface(tests) if mechanical else None,
        weight_n=_common_weight(tests, session.instrument) if mechanical else None,
        coil=Coil.of(session.instrument) if (input_name, output_name) == ("voltage", "position") else None,
    )


def _common_surface(tests: Sequence[Test]) -> float | None:
    """Return the mean position of the tissue surface in tests, m; None if one does not know it or they differ."""
    surfaces = [test.surface_position_m for test in tests]
    if not all(has_depth(test.configuration) for test in tests) or not np.all(np.isfinite(surfaces)):
        return None
    return float(np.mean(surfaces)) if np.ptp(surfaces) <= SURFACE_KNOWN_TO_M else None


def _common_weight(tests: Sequence[Test], device: DeviceDescription) -> float | None:
    """Return the mean weight of the moving part along the stroke in tests, N; None if its direction was not measured
    in one of them, or differs.
    """
    along = [test.notes.get(_GRAVITY_NOTE) for test in tests if _MEASURED_NOTE in test.notes]
    measured = [value for value in along if isinstance(value, float) and abs(value) < _LARGEST_GRAVITY * GRAVITY_M_S2]
    if len(measured) < len(tests) or np.ptp(measured) > _SAME_GRAVITY_M_S2:
        return None
    return device.weight_n(float(np.mean(measured)))


def _common_spring(tests: Sequence[Test]) -> float:
    """Return the stiffness of the external spring that all tests share, N/m.

    Raises:
        UnusableInputError: the tests differ in it, or in their configuration.
    """
    springs = [spring_of(test.notes) for test in tests]
    for test, spring in zip(tests, springs, strict=True):
        if test.configuration != tests[0].configuration:
            raise UnusableInputError(
                "split.different_configurations",
                "tests {first} and {second} have different configurations, {one} and {other}: analyse them one by one",
                first=tests[0].number,
                second=test.number,
                one=tests[0].configuration,
                other=test.configuration,
            )
        if spring != springs[0]:
            raise UnusableInputError(
                "split.different_springs",
                "tests {first} and {second} had external springs of {one:g} and {other:g} N/m: analyse them one by one",
                first=tests[0].number,
                second=test.number,
                one=springs[0],
                other=spring,
            )
        if placement(test.notes) != placement(tests[0].notes):
            raise UnusableInputError(
                "split.different_placements",
                "tests {first} and {second} differ in coupling, orientation, initial length or normal preload: "
                "analyse them one by one",
                first=tests[0].number,
                second=test.number,
            )
    return springs[0]


def split_records(records: Sequence[Record], tests: tuple[int, ...] = (1,)) -> Split:
    """Hold out the last quarter of every record; ``tests`` are the numbers of their tests.

    Of a localized test, it is the last quarter at every level, as the last quarter of the test lacks the other levels.
    Of a ramp and hold, it is the last quarter of each of several stretches, as the hold alone does not vary.

    Raises:
        UnusableInputError: there is no record, or they differ in sample rate, signals or units.
    """
    if len(records) != 1 or len(_stretches(records[0])) > 1:
        return _hold_out(records, QUARTERS - 1, tests)
    record, cut = records[0], round(FIT_SHARE * len(records[0]))
    whole = tuple(records)
    return Split(record, slice(0, cut), record, slice(cut, len(record)), tests, _quarter_of(tests), whole)


def _hold_out(records: Sequence[Record], quarter: int, tests: tuple[int, ...]) -> Split:
    """Hold out the quarter ``quarter`` (0 to 3) of every record, and join the rest."""
    kept: list[Record] = []
    unseen: list[Record] = []
    parts = 1
    for record in records:
        hidden = np.zeros(len(record), dtype=np.bool_)
        stretches = _stretches(record)
        quarters = tuple(_quarter_within(stretch, quarter) for stretch in stretches)
        for first, end in quarters:
            hidden[first:end] = True
        if len(stretches) > 1:  # stays in one piece: the engines see by which steps its levels were reached
            kept.append(replace(record, output=np.where(hidden, np.nan, record.output), withheld=quarters))
            parts = max(parts, len(stretches))
        else:
            first, end = quarters[0]
            kept += [record[part] for part in (slice(0, first), slice(end, len(record))) if part.start < part.stop]
        unseen.append(replace(record, output=np.where(hidden, record.output, np.nan)))
    fitted, held_out = joined(kept), joined(unseen)
    whole = slice(0, len(fitted)), slice(0, len(held_out))
    said = _quarter_of(tests, quarter, parts)
    return Split(fitted, whole[0], held_out, whole[1], tests, said, tuple(records))


def _stretches(record: Record) -> list[tuple[int, int]]:
    """Return first sample and end of the stretches of a record of each of which a quarter is held out.

    They are the levels of a localized test, and equal parts of a record whose quarters vary little, such as a ramp and
    hold; else the whole record.
    """
    whole = [(0, len(record))]
    stretches = [(level.first, level.end) for level in localized_levels(record)] or whole
    held_out = np.concatenate([record.output[slice(*_quarter_within(stretch, QUARTERS - 1))] for stretch in stretches])
    if np.isfinite(held_out).any() and np.nanvar(held_out) < _LEAST_VARIANCE * np.nanvar(record.output):
        edges = np.linspace(0, len(record), _STRETCHES + 1).round().astype(int).tolist()
        return list(pairwise(edges))
    return stretches


def _quarter_within(stretch: tuple[int, int], quarter: int) -> tuple[int, int]:
    begin, stop = stretch
    step = (stop - begin) / QUARTERS
    return begin + round(quarter * step), begin + round((quarter + 1) * step)


def _quarter_of(tests: Sequence[int], quarter: int = QUARTERS - 1, parts: int = 1) -> str:
    percent = 100.0 / QUARTERS
    which = (marked("first"), marked("second"), marked("third"), marked("last"))[quarter]
    if parts == _STRETCHES and len(tests) == 1:
        return Message(
            "split.part_of_stretches",
            "the {which} {percent:.0f} % of each of {parts} parts of test {number}",
            which=which,
            percent=percent,
            parts=parts,
            number=tests[0],
        )
    if parts > 1 and len(tests) == 1:
        return Message(
            "split.part_of_levels",
            "the {which} {percent:.0f} % at each level of test {number}",
            which=which,
            percent=percent,
            number=tests[0],
        )
    if len(tests) == 1:
        return Message(
            "split.part_of_test",
            "the {which} {percent:.0f} % of test {number}",
            which=which,
            percent=percent,
            number=tests[0],
        )
    return Message(
        "split.part_of_tests",
        "the {which} {percent:.0f} % of each of the tests {numbers}",
        which=which,
        percent=percent,
        numbers=Listing(tuple(map(str, tests)), marked(" and ")),
    )
