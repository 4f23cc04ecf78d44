"""The dataset of a diagnosis: the tests of a session, what drives each, and the purpose of each sample.

The excitation is the recorded signal that drives the chain; the channels that the chain predicts follow from it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
from hashlib import blake2b
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.device import GRAVITY_M_S2, DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.gap.equivalent_oscillator import PEAK_V, Equivalent, equivalent
from tissueid.sessions import Test
from tissueid.twin.simulation import MeasuredSignals

FloatArray = NDArray[np.float64]
DrivenBy = Literal["command", "voltage", "current", "input"]

UPSTREAM: dict[DrivenBy, tuple[str, ...]] = {
    "command": (),
    "voltage": ("voltage",),
    "current": ("voltage", "current"),
    "input": ("voltage", "current"),
}
"""Channels at or upstream of the excitation, which are not predicted."""
LEAST_SAMPLES = 100
"""Least number of samples of a test."""
_FIGURES = (
    "coil_resistance_ohm",
    "coil_inductance_h",
    "force_constant_n_per_a",
    "moving_mass_kg",
    "bearing_damping_n_s_per_m",
    "stroke_m",
    "calibration_relative_uncertainty",
)
_INPUTS = ("input", "force", "current", "voltage", "command")
_OUTPUTS = ("position", "output")
_LEAST_RECEIVED = 0.5
"""Least share of received samples of a signal that is used."""
_MOST_STROKES = 10.0
"""Travel in strokes from which the position is taken to be in another unit than metres."""
_MOST_FORCES = 10.0
"""Force relative to the coil's largest force from which it is taken to be in another unit than newtons."""


@dataclass(frozen=True)
class ExcitedTest:
    """A test with its excitation, shape (n,), without gaps, and its recorded signals, NaN where not received."""

    test: Test
    by: DrivenBy
    command: FloatArray
    signals: dict[str, FloatArray]


def known_instrument(device: DeviceDescription) -> bool:
    """Return whether a session holds the parameters of its instrument, without which the chain has no coil."""
    return all(np.isfinite(getattr(device, name)) and getattr(device, name) > 0.0 for name in _FIGURES)


def excitation_of(test: Test, device: DeviceDescription) -> ExcitedTest:
    """Return the excitation of a test of a known instrument: its command, or the first signal recorded downstream.

    A command is used where it has no gaps and the amplifier is known. A signal without any sample counts as not
    recorded. Gaps of a recorded signal, at most half of it, are interpolated linearly.

    Raises:
        UnusableInputError: there is no usable excitation, or no position.
    """
    signals: dict[str, FloatArray] = {
        name: np.where(np.isfinite(test.signals[name]), test.signals[name], np.nan)
        for name in ("voltage", "current", "position")
        if name in test.signals and (name == "position" or np.isfinite(test.signals[name]).any())
    }
    if "position" not in signals:
        raise UnusableInputError("gap.no_position", "it has no position")
    _check_received("position", signals["position"])
    travel = float(np.nanmax(signals["position"]) - np.nanmin(signals["position"]))
    if travel > _MOST_STROKES * device.stroke_m:
        raise UnusableInputError(
            "gap.travel",
            "its position covers {travel_m:.3g} m, and the stroke is {stroke_m:.3g} m: is it in metres?",
            travel_m=travel,
            stroke_m=device.stroke_m,
        )
    if travel == 0.0 and test.kind != "quiet":
        raise UnusableInputError("gap.constant_position", "its position never changes")
    command = test.signals.get("command")
    amplifier = all(np.isfinite(value) and value > 0.0 for value in (device.amplifier_gain, device.amplifier_limit_v))
    if test.kind == "spring" and not device.calibration_spring_n_per_m > 0.0:
        raise UnusableInputError(
            "gap.unknown_spring", "the session does not hold the stiffness of its calibration spring"
        )
    if command is not None and amplifier and np.isfinite(command).all():
        return ExcitedTest(test, "command", np.ascontiguousarray(command, np.float64), signals)
    if "voltage" in signals and np.isfinite(signals["voltage"]).mean() >= _LEAST_RECEIVED:
        return ExcitedTest(test, "voltage", interpolated(signals["voltage"]), signals)
    if "current" not in signals and "force" in test.signals:
        force = np.where(np.isfinite(test.signals["force"]), test.signals["force"], np.nan)
        most = device.amplifier_limit_v / device.coil_resistance_ohm * device.force_constant_n_per_a
        if amplifier and float(np.nanmax(np.abs(force), initial=0.0)) > _MOST_FORCES * most:
            raise UnusableInputError(
                "gap.force_unit",
                "its force reaches {force_n:.3g} N, and the coil can give {most_n:.3g} N: is it in N?",
                force_n=float(np.nanmax(np.abs(force))),
                most_n=most,
            )
        signals["current"] = force / device.force_constant_n_per_a
    if "current" in signals and np.isfinite(signals["current"]).mean() >= _LEAST_RECEIVED:
        return ExcitedTest(test, "current", interpolated(signals["current"]), signals)
    if command is not None and not amplifier:
        raise UnusableInputError(
            "gap.unknown_amplifier", "the session holds neither gain nor limit of the amplifier of its command"
        )
    if command is not None:
        raise UnusableInputError("gap.command_gaps", "its command has gaps, so that the test cannot be simulated")
    raise UnusableInputError("gap.no_excitation", "it has no command, voltage, current or force that drives it")


def input_output_names(test: Test) -> tuple[str, str]:
    """Return the names of input and output of a test of an unknown instrument.

    Raises:
        UnusableInputError: input or output is missing or constant.
    """
    output = next((name for name in _OUTPUTS if name in test.signals), None)
    given = next((name for name in _INPUTS if name in test.signals), None)
    if output is None:
        raise UnusableInputError("gap.no_output", "it has no position or output")
    if given is None:
        raise UnusableInputError("gap.no_input", "it has no input, force, current or voltage that drives it")
    _check_received(output, test.signals[output])
    _check_received(given, test.signals[given])
    if not float(np.nanstd(test.signals[given])) > 0.0 or not float(np.nanstd(test.signals[output])) > 0.0:
        raise UnusableInputError("gap.constant_signal", "its input or output never changes")
    return given, output


def as_oscillator(tests: Sequence[Test], fitted: Sequence[Test]) -> tuple[Equivalent, list[ExcitedTest]]:
    """Convert input-output tests to force and motion of an equivalent mass on a spring.

    Args:
        tests: tests that ``bare`` accepts, with the same names of signals.
        fitted: the tests from which the oscillator is estimated.
    """
    given, output = input_output_names(tests[0])
    records = [(interpolated(test.signals[given]), interpolated(test.signals[output])) for test in fitted]
    units = tests[0].unit(given), tests[0].unit(output)
    about = equivalent(records, tests[0].sample_rate_hz, (given, output), units)
    peak = max(float(np.max(np.abs(values))) for values, _ in records)
    rest = float(np.mean(np.concatenate([values for _, values in records])))
    middle = float(np.mean(np.concatenate([values for values, _ in records])))
    about = replace(about, input_middle_n=about.input_n * middle, volts_per_newton=PEAK_V / (about.input_n * peak))
    excited = []
    for test in tests:
        force = about.input_n * (interpolated(test.signals[given]) - middle)
        motion = about.output_m * (np.asarray(test.signals[output], np.float64) - rest)
        excited.append(ExcitedTest(test, "input", np.ascontiguousarray(force), {"position": motion}))
    return about, excited


def interpolated(values: FloatArray) -> FloatArray:
    """Return a signal with linear interpolation across missing samples, shape (n,)."""
    finite = np.isfinite(values)
    if finite.all():
        return np.ascontiguousarray(values, np.float64)
    where = np.arange(values.size)
    return np.interp(where, where[finite], values[finite])


def _check_received(name: str, values: FloatArray) -> None:
    received = float(np.isfinite(values).mean())
    if received < _LEAST_RECEIVED:
        raise UnusableInputError(
            "gap.missing_samples",
            "{percent:.0f} % of its {channel} is missing",
            percent=100.0 * (1.0 - received),
            channel=name,
        )


Fixture = Literal["tissue", "spring", "air"]

CHANNELS = ("voltage", "current", "position")
"""Recorded signals that the chain predicts, in downstream order."""
AT_SURFACE_M = 1e-4
LEAST_NOISE = {"voltage": 1e-4, "current": 1e-5, "position": 1e-8}
"""Least noise of a channel, SI: a channel without visible noise would get infinite weight."""


class Purpose(IntEnum):
    """Purpose of a sample. A sample that was not received has none."""

    NOTHING = 0
    FIT = 1
    CHOICE = 2
    """Held out of every fit; candidates are chosen by it."""
    CHECK = 3
    """Held out of fit and choice; the stated closed share is verified on it."""


@dataclass(frozen=True)
class DatasetTest:
    """One test: command and recorded signals, shape (n,), SI.

    ``signals`` holds the recorded ones of ``CHANNELS``, NaN where a sample was not received. ``purpose``, shape (n,),
    is the purpose of each sample.
    """

    number: int
    kind: str
    fixture: Fixture
    command: FloatArray = field(repr=False)
    signals: dict[str, FloatArray] = field(repr=False)
    purpose: NDArray[np.int8] = field(repr=False)
    sample_rate_hz: float
    surface_m: float
    repeat_of: int | None = None
    driven_by: DrivenBy = "command"
    """Kind of signal in ``command``: the command (V), the recorded voltage (V) across the coil, the recorded current
    (A) through it, or an input as the force (N) on an equivalent oscillator."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Recorded signals downstream of the excitation, which the chain predicts."""
        return tuple(name for name in CHANNELS if name in self.signals and name not in UPSTREAM[self.driven_by])

    @cached_property
    def played(self) -> tuple[float, bytes]:
        """Sample rate and hash of the command: equal for a test and its repeats."""
        return self.sample_rate_hz, blake2b(self.command.tobytes(), digest_size=16).digest()

    def excitation(self, tracking_rad_s: float = 0.0) -> MeasuredSignals:
        """Return the excitation if it was measured, and the position for an observer of a bandwidth above 0.

        It is the same object every time.
        """
        if tracking_rad_s not in self._excitations:
            self._excitations[tracking_rad_s] = MeasuredSignals(
                voltage=self.command if self.driven_by == "voltage" else None,
                current=self.command if self.driven_by == "current" else None,
                position=interpolated(self.signals["position"]) if tracking_rad_s > 0.0 else None,
                tracking_rad_s=tracking_rad_s,
            )
        return self._excitations[tracking_rad_s]

    @cached_property
    def _excitations(self) -> dict[float, MeasuredSignals]:
        return {}

    @property
    def quiet(self) -> bool:
        """Whether the test has no stimulus."""
        return self.kind == "quiet"

    @property
    def starts_at_surface(self) -> bool:
        """Whether the probe rests at the surface when the test begins; otherwise the surface is less certain."""
        return bool(np.isfinite(self._first_position_m)) and abs(self._first_position_m - self.surface_m) < AT_SURFACE_M

    @property
    def starting_position_m(self) -> float:
        """Position at which the test begins: the surface, unless the first readings differ."""
        at_surface = self.starts_at_surface or not np.isfinite(self._first_position_m)
        return self.surface_m if at_surface else self._first_position_m

    @cached_property
    def _first_position_m(self) -> float:
        position = self.signals["position"]
        first = position[np.isfinite(position)][:3]
        return float(np.median(first)) if first.size else float("nan")

    @cached_property
    def spreads(self) -> dict[str, float]:
        """Standard deviation of each recorded signal, SI."""
        return {name: float(np.nanstd(values)) for name, values in self.signals.items()}

    def serving(self, purpose: Purpose) -> NDArray[np.bool_]:
        """Return True for samples of a purpose, shape (n,)."""
        return np.asarray(self.purpose == purpose)


@dataclass(frozen=True)
class Prior:
    """Prior of a coordinate in fitted units; without ``std`` a starting value only."""

    value: float
    std: float | None = None


@dataclass(frozen=True)
class Dataset:
    """All tests of a session that the diagnosis uses, the nominal instrument and the noise of each channel.

    ``noise`` is the standard deviation of each channel's sensor noise, SI.
    """

    instrument: DeviceDescription
    tests: tuple[DatasetTest, ...]
    noise: dict[str, float]
    remarks: tuple[str, ...] = ()
    priors: Mapping[str, Prior] = field(default_factory=dict)
    """Priors of coordinates from a saved twin, by name."""
    unmodelled: Mapping[str, float] = field(default_factory=dict)
    """Error that a saved twin is known to leave in tests on tissue, by channel, as a share of the standard deviation of
    the recorded signal."""
    equivalent: Equivalent | None = None
    """Conversion of input-output records to force and motion; None where the instrument is known."""
    gravity_m_s2: tuple[float, float] = (0.0, GRAVITY_M_S2)
    """Gravity along the stroke and its standard deviation; by default the device can have any orientation."""
    tracking_rad_s: float = 0.0
    """Bandwidth of an observer that pulls each simulated motion towards the recorded one; 0 in every result."""
    impulsive: Mapping[str, float] = field(default_factory=dict)
    """Noise with outliers of channels that have outliers; ``noise`` is then without."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that are predicted in every test."""
        return tuple(name for name in CHANNELS if all(name in test.channels for test in self.tests))

    @property
    def recorded(self) -> tuple[str, ...]:
        """Channels that every test has, predicted or used as the excitation."""
        return tuple(name for name in CHANNELS if all(name in test.signals for test in self.tests))

    @property
    def full(self) -> bool:
        """Whether there is more than one kind of test."""
        return len({test.kind for test in self.tests}) > 1
