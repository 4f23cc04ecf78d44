"""What was observed: the tests of a session as the diagnosis uses them, and which samples serve which purpose."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, welch

from tissueid.device import DeviceDescription
from tissueid.errors import UnusableInputError
from tissueid.gap.driving import (
    LEAST_SAMPLES,
    UPSTREAM,
    Driven,
    DrivenBy,
    as_equivalent,
    bare,
    bridged,
    driven,
    known_instrument,
)
from tissueid.gap.equivalent import Equivalent
from tissueid.sessions import Session, Test

FloatArray = NDArray[np.float64]
Fixture = Literal["tissue", "spring", "air"]
T = TypeVar("T")

CHANNELS = ("voltage", "current", "position")
"""Recorded signals that the chain predicts, downstream in this order."""

BLOCK_S = 0.25
"""Length of the stretches that take turns in serving fit, choice and check: some times the chain's memory."""
SETTLING_S = 0.010
"""Left out of every score at the start of a test: the coil's state before it is not recorded."""
AT_SURFACE_M = 1e-4
LEFT_BEHIND_M = 2e-3
"""A probe that is further than this off the surface is not on the tissue."""
ALIKE = 1.25
"""Estimates of one noise lie within this ratio."""
COARSE_M = 2e-6
"""Steps of a position reading that are coarser than this are an effect; finer ones are the converter's."""
_LAGS = 6
"""Samples over which a channel follows the signal upstream of it, as far as its noise is concerned."""
_STRETCH = 256
"""Samples of a stretch over which a spectrum is taken."""
_LEAST_NOISE = {"voltage": 1e-4, "current": 1e-5, "position": 1e-8}
"""SI; of a channel that shows none, since no converter is finer."""
_MIDDLE_HALF = 0.693
"""Mean size of the middle half of a normal variable's sizes, in standard deviations."""
SHORTEST_S = 0.5
"""With less than this of a test, and twice its preload, nothing is told: every purpose needs some of the stimulus."""
MOST_FITTED = 32_768
"""So many samples of a test at most are fitted: more tell next to nothing more, and take as much longer."""
MOST_FITTED_BARE = 16_384
MOST_HELD_OUT = 65_536
BARE_NOISE = 2e-3
"""No bare record is trusted beyond this share of its deviation: how it was sampled and filtered, nobody says."""
_MEMORIES = 4.0
"""A stretch of a bare record lasts so many times what it takes to settle."""
_LEAST_BLOCKS = 16


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
    driven_by: DrivenBy = "command"
    """Whether ``command`` holds the command (V), or what was recorded in its stead: the voltage (V) across the coil,
    the current (A) through it, or a bare input as the force (N) on an equivalent mass."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Recorded signals downstream of what drives the test: those that the chain predicts."""
        return tuple(name for name in CHANNELS if name in self.signals and name not in UPSTREAM[self.driven_by])

    @property
    def quiet(self) -> bool:
        """Whether nothing was asked of the coil."""
        return self.kind == "quiet"

    @property
    def starts_at_surface(self) -> bool:
        """Whether the probe rests at the surface as the test begins; otherwise where that lies is less certain."""
        position = self.signals["position"]
        first = position[np.isfinite(position)][:3]
        return bool(first.size) and abs(float(np.median(first)) - self.surface_m) < AT_SURFACE_M

    def serving(self, purpose: Purpose) -> NDArray[np.bool_]:
        """True where a sample serves that purpose, shape (n,)."""
        return np.asarray(self.purpose == purpose)


@dataclass(frozen=True)
class Belief:
    """What is believed of a coordinate, as it is fitted; without ``std`` it is no more than where to start."""

    value: float
    std: float | None = None


@dataclass(frozen=True)
class Observed:
    """All tests of a session that the diagnosis uses, the nominal instrument and the noise of each channel.

    ``noise`` is the standard deviation of each channel's sensor noise, SI.
    """

    instrument: DeviceDescription
    tests: tuple[ObservedTest, ...]
    noise: dict[str, float]
    remarks: tuple[str, ...] = ()
    beliefs: Mapping[str, Belief] = field(default_factory=dict)
    """What a saved twin holds of coordinates, by their names."""
    equivalent: Equivalent | None = None
    """How bare records of input and output became force and motion; None where the instrument is known."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that are predicted in every test."""
        return tuple(name for name in CHANNELS if all(name in test.channels for test in self.tests))

    @property
    def recorded(self) -> tuple[str, ...]:
        """Channels that every test has, whether they are predicted or drive it."""
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
    chosen = [test for test in session.tests if not fit or test.number in (*fit, *check)]
    if check and all(test.number in check and test.number not in fit for test in chosen):
        raise UnusableInputError("every test is held out and none is left to be fitted: name one for that as well")
    if known_instrument(session.instrument):
        tests = _usable(chosen, remarks, lambda test: driven(test, session.instrument))
        other = None if (fit or check) else _other_amplitude([item.test for item in tests])
        seen = tuple(_observed(item, fit, check, remarks, held_out=item.test is other) for item in tests)
        return Observed(session.instrument, seen, channel_noise(seen), tuple(remarks))
    alike = [test for test, names in _usable(chosen, remarks, _bare_test) if names]
    fitting = [
        test for test in alike if bare(test) == bare(alike[0]) and test.sample_rate_hz == alike[0].sample_rate_hz
    ]
    remarks += [
        f"test {test.number} is left out: its signals or its rate are not those of the first"
        for test in alike
        if all(test is not other for other in fitting)
    ]
    alike = fitting
    other = None if (fit or check) else _other_amplitude(alike)
    held_out = [test.number for test in alike if test is other or (test.number in check and test.number not in fit)]
    about, items = as_equivalent(alike, [test for test in alike if test.number not in held_out] or alike)
    seen = tuple(
        _observed(item, fit, check, remarks, held_out=item.test is other, settling_s=about.settling_s) for item in items
    )
    remarks.append(about.words)
    deviation = float(np.sqrt(np.mean([np.nanvar(test.signals["position"]) for test in seen])))
    noise = {name: max(level, BARE_NOISE * deviation) for name, level in channel_noise(seen).items()}
    return Observed(about.device(alike[0].sample_rate_hz), seen, noise, tuple(remarks), equivalent=about)


def _bare_test(test: Test) -> tuple[Test, tuple[str, str]]:
    return test, bare(test)


def _usable(tests: Sequence[Test], remarks: list[str], take: Callable[[Test], T]) -> list[T]:
    """What ``take`` makes of the tests that can be used; the others are remarked upon.

    Raises:
        UnusableInputError: none can.
    """
    found = []
    for test in tests:
        try:
            if test.samples < max((SHORTEST_S + 2.0 * test.preload_s) * test.sample_rate_hz, LEAST_SAMPLES):
                raise UnusableInputError(f"{test.samples / test.sample_rate_hz:.2g} s are too short to tell anything")
            found.append(take(test))
        except UnusableInputError as error:
            remarks.append(f"test {test.number} is left out: {error}")
    if not found:
        why = remarks[0] if remarks else "it holds no tests"
        raise UnusableInputError(f"the session cannot be diagnosed: {why}")
    return found


def _other_amplitude(tests: Sequence[Test]) -> Test | None:
    stochastic = [test for test in tests if test.kind == "stochastic" and test.repeat_of is None]
    return stochastic[-1] if len(stochastic) > 1 else None


def _observed(
    item: Driven,
    fit: Sequence[int],
    check: Sequence[int],
    remarks: list[str],
    *,
    held_out: bool,
    settling_s: float = 0.0,
) -> ObservedTest:
    test, rate = item.test, item.test.sample_rate_hz
    only_held_out = (test.number in check and test.number not in fit) or held_out
    most = MOST_FITTED_BARE if item.by == "input" else MOST_FITTED
    size = min(test.samples, MOST_HELD_OUT if only_held_out else most)
    if size < test.samples:
        remarks.append(f"of test {test.number} the first {size / rate:.3g} s of {test.samples / rate:.3g} s are used")
    signals = {name: values[:size] for name, values in item.signals.items()}
    stretch = min(max(BLOCK_S * rate, _MEMORIES * settling_s * rate), max(size / _LEAST_BLOCKS, BLOCK_S * rate))
    stretch = min(stretch, size / 4)
    turn = (np.arange(size) / max(stretch, 1.0)).astype(np.int64) % 4
    purpose = np.full(size, Purpose.FIT, np.int8)
    if only_held_out:
        purpose[:] = np.where(turn % 2 == 0, Purpose.CHOICE, Purpose.CHECK)
    elif not check or test.number in check:
        purpose[turn == 1] = Purpose.CHOICE
        purpose[turn == 3] = Purpose.CHECK
    purpose[: round(max(SETTLING_S, min(settling_s, 0.1 * size / rate)) * rate)] = Purpose.NOTHING
    fixture: Fixture = {"spring": "spring", "free_air": "air"}.get(test.kind, "tissue")  # type: ignore[assignment]
    surface = test.surface_position_m
    if item.by == "input":
        fixture, surface = "tissue", 0.0
    elif not np.isfinite(surface):
        surface = float(np.nanmedian(signals["position"][: max(3, round(0.002 * rate))]))
    if fixture == "tissue" and item.by != "input":
        # Far off the skin nothing holds the probe: where it drifts to says nothing, and errors grow without end.
        away = np.nan_to_num(signals["position"], nan=surface) < surface - LEFT_BEHIND_M
        if away.any() and not away[0]:
            purpose[np.argmax(away) :] = Purpose.NOTHING
            remarks.append(
                f"test {test.number} is used as far as the probe left the skin, {np.argmax(away) / rate:.2g} s"
            )
    return ObservedTest(
        test.number,
        test.kind,
        fixture,
        item.command[:size],
        signals,
        purpose,
        rate,
        surface,
        test.repeat_of,
        item.by,
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
        if not levels and any(name in test.signals for test in tests):
            noise[name] = _LEAST_NOISE[name]
        if levels:
            # Each is a little uncertain, so that the least of many would be too low; what is higher is no noise alone.
            noise[name] = float(np.mean([level for level in levels if level <= ALIKE * min(levels)]))
    if "position" in noise:
        # Coarse steps make noise of their own, which is no noise of the sensor.
        steps = max(_coarse_step(test.signals["position"]) for test in tests)
        noise["position"] = max(np.sqrt(max(noise["position"] ** 2 - steps**2 / 12.0, 0.0)), 0.05 * steps)
    return noise


def _without_upstream(test: ObservedTest, name: str) -> list[FloatArray]:
    if name not in test.signals:
        return []
    values = test.signals[name]
    upstream = {
        "voltage": [test.command],
        "current": [test.signals.get("voltage", test.command)],
        "position": [],
    }[name]
    columns = [np.roll(source, lag) for source in upstream for lag in range(_LAGS)]
    if name == "current":
        # The back-EMF, from motion without the position's noise.
        motion = _smooth(test.signals["position"])
        columns += [np.roll(motion, lag) for lag in range(-_LAGS // 2, _LAGS // 2 + 1)]
    if not columns:
        return [values]
    known = np.isfinite(values) & np.all([np.isfinite(column) for column in columns], axis=0)
    known[:_LAGS] = False
    known[-_LAGS:] = False
    if known.sum() < 256:
        return []
    design = np.stack([column[known] for column in columns] + [np.ones(int(known.sum()))], axis=1)
    design /= np.linalg.norm(design, axis=0) + np.finfo(np.float64).tiny
    found, *_ = np.linalg.lstsq(design, values[known], rcond=1e-10)
    return [values, values[known] - design @ found]


def _smooth(values: FloatArray) -> FloatArray:
    # Below a third of half the sample rate; both ends go on by odd reflection.
    kernel = firwin(41, 0.35)
    whole = bridged(values)
    before, after = 2.0 * whole[0] - whole[20:0:-1], 2.0 * whole[-1] - whole[-2:-22:-1]
    return np.convolve(np.concatenate([before, whole, after]), kernel, "valid")


def _coarse_step(values: FloatArray) -> float:
    # Least distance of two values that occur; 0 where that is finer than the noise of a good sensor.
    distances = np.diff(np.unique(values[np.isfinite(values)]))
    step = float(np.min(distances[distances > 1e-7], initial=np.inf))
    return step if COARSE_M < step < np.inf else 0.0


def _level_by_neighbours(test: ObservedTest) -> float:
    # A voltage that is any static function of the command, however bent, is straight over three neighbouring commands.
    known = np.isfinite(test.signals["voltage"])
    order = np.argsort(test.command[known], kind="stable")
    at, values = test.command[known][order], test.signals["voltage"][known][order]
    apart = at[2:] - at[:-2]
    share = np.where(apart > 0.0, (at[1:-1] - at[:-2]) / np.where(apart > 0.0, apart, 1.0), 0.5)
    bend = values[1:-1] - (1.0 - share) * values[:-2] - share * values[2:]
    size = np.sort(np.abs(bend) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2))
    if size.size < 256 or not np.ptp(test.command) > 0.0:
        return 0.0
    # The mean of the middle half: a median would be one of the converter's few steps.
    return float(np.mean(size[size.size // 4 : 3 * size.size // 4])) / _MIDDLE_HALF


def _level(values: FloatArray) -> float:
    if np.isfinite(values).sum() < _STRETCH:
        return 0.0
    known = bridged(values)[values.size // 10 :]
    if known.size < _STRETCH:
        return 0.0
    # The median over stretches passes by jumps, where a stimulus begins or samples were lost.
    _, density = welch(known, 1.0, nperseg=_STRETCH, average="median")
    return float(np.sqrt(0.5 * np.mean(density[round(0.84 * density.size) :])))
