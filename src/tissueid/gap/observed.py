"""What was observed: the tests of a session as the diagnosis uses them, and which samples serve which purpose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.sessions import Session, Test

FloatArray = NDArray[np.float64]
Fixture = Literal["tissue", "spring", "air"]

CHANNELS = ("voltage", "current", "position")
"""Recorded signals that the chain predicts, downstream in this order."""

BLOCK_S = 0.25
"""Length of the stretches that take turns in serving fit, choice and check: some times the chain's memory."""
SETTLING_S = 0.010
"""Left out of every score at the start of a test: the coil's state before it is not recorded."""
_LAGS = 6
"""Samples over which a channel follows the signal upstream of it, as far as its noise is concerned."""
SHORTEST_S = 0.5
"""With less than this of a test nothing is told."""


class Purpose(IntEnum):
    """What a sample serves. A sample that was not received serves nothing."""

    NOTHING = 0
    FIT = 1
    CHOICE = 2
    """Held out of every fit; candidates are chosen by it."""
    CHECK = 3
    """Held out of fit and choice; the announced figures are checked on it."""


@dataclass(frozen=True)
class ObservedTest:
    """One test: command and recorded signals, shape (n,), SI.

    ``signals`` holds those of ``CHANNELS`` that were recorded, NaN where a sample was not received. ``purpose``, shape
    (n,), says what each sample serves.
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

    @property
    def quiet(self) -> bool:
        """Whether nothing was asked of the coil."""
        return self.kind == "quiet"

    def serving(self, purpose: Purpose) -> NDArray[np.bool_]:
        """True where a sample serves that purpose, shape (n,)."""
        return np.asarray(self.purpose == purpose)


@dataclass(frozen=True)
class Observed:
    """All tests of a session that the diagnosis uses, the nominal instrument and the noise of each channel.

    ``noise`` is the standard deviation of each channel's sensor noise, SI.
    """

    instrument: DeviceDescription
    tests: tuple[ObservedTest, ...]
    noise: dict[str, float]
    remarks: tuple[str, ...] = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that every test has."""
        return tuple(name for name in CHANNELS if all(name in test.signals for test in self.tests))

    @property
    def full(self) -> bool:
        """Whether there is more than one kind of test."""
        return len({test.kind for test in self.tests}) > 1


def observe(session: Session, fit: Sequence[int] = (), check: Sequence[int] = ()) -> Observed:
    """Prepare a session for the diagnosis.

    Without ``fit`` and ``check`` stretches of a quarter of a second take turns: every second one is fitted, every
    fourth serves the choice of candidates and every fourth the check; a stochastic test of another amplitude and seed
    is not fitted at all. With them, whole tests are fitted and held out.

    Raises:
        UnusableInputError: the session holds no test with a position and something that drives it, or the tests
            named do not exist.
    """
    numbers = {test.number for test in session.tests}
    for number in (*fit, *check):
        if number not in numbers:
            raise UnusableInputError(f"the session has no test {number}; it has {', '.join(map(str, sorted(numbers)))}")
    remarks: list[str] = []
    chosen = [test for test in session.tests if not (fit or check) or test.number in (*fit, *check)]
    usable = [test for test in chosen if _usable(test, remarks)]
    if not usable:
        why = remarks[0] if remarks else "it holds no tests"
        raise UnusableInputError(f"the session cannot be diagnosed: {why}")
    other = None if (fit or check) else _other_amplitude(usable)
    tests = tuple(_observed(test, fit, check, held_out=test is other) for test in usable)
    return Observed(session.instrument, tests, channel_noise(tests), tuple(remarks))


def _usable(test: Test, remarks: list[str]) -> bool:
    def leave_out(why: str) -> bool:
        remarks.append(f"test {test.number} is left out: {why}")
        return False

    if test.samples < SHORTEST_S * test.sample_rate_hz:
        return leave_out(f"{test.samples / test.sample_rate_hz:.2g} s are too short to tell anything")
    if "position" not in test.signals:
        return leave_out("it has no position")
    if "command" not in test.signals:
        return leave_out("it has no command")
    received = np.isfinite(test.signals["position"]).mean()
    if received < 0.5:
        return leave_out(f"{1 - received:.0%} of its position is missing")
    if not np.isfinite(test.signals["command"]).all():
        return leave_out("its command has gaps, so that nothing can be played again")
    return True


def _other_amplitude(tests: Sequence[Test]) -> Test | None:
    stochastic = [test for test in tests if test.kind == "stochastic" and test.repeat_of is None]
    return stochastic[-1] if len(stochastic) > 1 else None


def _observed(test: Test, fit: Sequence[int], check: Sequence[int], *, held_out: bool) -> ObservedTest:
    rate = test.sample_rate_hz
    signals = {name: np.asarray(test.signals[name], np.float64) for name in CHANNELS if name in test.signals}
    if "current" not in signals and "force" in test.signals:
        signals["force"] = np.asarray(test.signals["force"], np.float64)
    size = test.samples
    block = (np.arange(size) / (BLOCK_S * rate)).astype(np.int64)
    turn = block % 4
    purpose = np.full(size, Purpose.FIT, np.int8)
    if (test.number in check and test.number not in fit) or held_out:
        purpose[:] = np.where(turn % 2 == 0, Purpose.CHOICE, Purpose.CHECK)
    elif not check:
        purpose[turn == 1] = Purpose.CHOICE
        purpose[turn == 3] = Purpose.CHECK
    purpose[: round(SETTLING_S * rate)] = Purpose.NOTHING
    fixture: Fixture = {"spring": "spring", "free_air": "air"}.get(test.kind, "tissue")  # type: ignore[assignment]
    surface = test.surface_position_m
    if not np.isfinite(surface):
        surface = float(np.nanmedian(signals["position"][: max(3, round(0.002 * rate))]))
    return ObservedTest(
        test.number,
        test.kind,
        fixture,
        np.ascontiguousarray(test.signals["command"], np.float64),
        signals,
        purpose,
        rate,
        surface,
        test.repeat_of,
    )


def channel_noise(tests: Sequence[ObservedTest]) -> dict[str, float]:
    """Standard deviation of each channel's white noise, SI: the least that any test shows.

    From the uppermost sixth of the spectrum, after what follows linearly from the signal upstream (voltage from the
    command, current from the voltage and the motion) has been taken away there; and, where a test was repeated, from
    half of the repeats' difference.
    """
    noise: dict[str, float] = {}
    for name in CHANNELS:
        levels = [_level_by_neighbours(test) for test in tests if name == "voltage" and name in test.signals]
        levels += [_level(values) for test in tests for values in _without_upstream(test, name)]
        for test in tests:
            for first in tests:
                if test.repeat_of == first.number and name in test.signals and name in first.signals:
                    size = min(test.signals[name].size, first.signals[name].size)
                    levels.append(_level(test.signals[name][:size] - first.signals[name][:size]) / np.sqrt(2.0))
        levels = [level for level in levels if level > 0.0]
        if levels:
            noise[name] = float(min(levels))
    return noise


def _without_upstream(test: ObservedTest, name: str) -> list[FloatArray]:
    if name not in test.signals:
        return []
    values = test.signals[name]
    upstream = {
        "voltage": [test.command],
        "current": [test.signals.get("voltage", test.command), test.signals["position"]],
        "position": [],
    }[name]
    columns = [np.roll(source, lag) for source in upstream for lag in range(_LAGS)]
    if not columns:
        return [values]
    known = np.isfinite(values) & np.all([np.isfinite(column) for column in columns], axis=0)
    known[:_LAGS] = False
    if known.sum() < 256:
        return []
    design = np.stack([column[known] for column in columns] + [np.ones(int(known.sum()))], axis=1)
    found, *_ = np.linalg.lstsq(design, values[known], rcond=1e-10)
    return [values, values[known] - design @ found]


def _level_by_neighbours(test: ObservedTest) -> float:
    # A voltage that is any static function of the command, however bent, is straight over three neighbouring commands.
    known = np.isfinite(test.signals["voltage"])
    order = np.argsort(test.command[known], kind="stable")
    bend = np.diff(test.signals["voltage"][known][order], 2) / np.sqrt(6.0)
    return 1.4826 * float(np.median(np.abs(bend))) if bend.size > 256 and np.ptp(test.command) > 0.0 else 0.0


def _level(values: FloatArray) -> float:
    known = values[np.isfinite(values)][values.size // 10 :]
    if known.size < 256:
        return 0.0
    window = np.hanning(known.size)
    power = np.abs(np.fft.rfft((known - known.mean()) * window)) ** 2 / np.sum(window**2)
    upper = power[round(0.84 * power.size) :]
    return float(np.sqrt(np.median(upper) / np.log(2.0)))
