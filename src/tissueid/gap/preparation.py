"""Preparation of a session for the diagnosis: the tests used, the part of each, and the purpose of each sample."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid.device import GRAVITY_M_S2
from tissueid.errors import UnusableInputError
from tissueid.gap.dataset import (
    AT_SURFACE_M,
    LEAST_SAMPLES,
    Dataset,
    DatasetTest,
    ExcitedTest,
    Fixture,
    Purpose,
    as_oscillator,
    excitation_of,
    input_output_names,
    known_instrument,
)
from tissueid.gap.noise import channel_noise
from tissueid.messages import Message
from tissueid.sessions import Session, Test

T = TypeVar("T")

_SLOW = Message(
    "gap.slow",
    "slow ramps and holds show stiffness and relaxation alone: dynamic effects need a test with noise or steps",
)
BLOCK_S = 0.1
"""Length of the blocks that alternate between fit, choice and check, s: several times the memory of the chain."""
SETTLING_S = 0.010
"""Time at the start of a test that is left out of every score, s: the coil's state before it is not recorded."""
OFF_TISSUE_M = 2e-3
"""Distance above the surface from which the probe counts as off the tissue, m."""
RETURN_S = 0.1
"""Time after the probe met the skin again in which the error of its flight decays, s."""
SHORTEST_S = 0.5
"""Least duration of a test in addition to twice its preload, s: every purpose needs a part of the stimulus."""
MOST_FITTED = 32_768
"""Most samples of a test that are fitted: more add time and little information."""
MOST_FITTED_BARE = 16_384
"""The same for an input-output record."""
MOST_HELD_OUT = 65_536
"""Most samples of a test that is held out."""
BARE_NOISE = 2e-3
"""Least noise of an input-output record as a share of its deviation: its sampling and filters are unknown."""
GRAVITY_STD_M_S2 = 0.15
"""Standard deviation of gravity as measured by the accelerometer of the instrument, m/s^2: 1.5 % of its scale."""
_MEMORIES = 4.0
"""Length of the blocks of an input-output record, in settling times."""
_LEAST_BLOCKS = 16
"""Least number of blocks of a test."""


def prepare(session: Session, fit: Sequence[int] = (), check: Sequence[int] = ()) -> Dataset:
    """Prepare a session for the diagnosis.

    Without ``fit`` and ``check``, blocks of a tenth of a second alternate: every second one is fitted, every fourth
    is used for the choice of candidates and every fourth for the check; a stochastic test of another amplitude and seed
    is held out completely. With them, whole tests are fitted and held out.

    Raises:
        UnusableInputError: the session has no test with a position and an excitation, or the named tests do not exist.
    """
    numbers = {test.number for test in session.tests}
    for number in (*fit, *check):
        if number not in numbers:
            raise UnusableInputError(
                "gap.no_such_test",
                "the session has no test {number}; it has {others}",
                number=number,
                others=", ".join(map(str, sorted(numbers))),
            )
    remarks: list[Message] = []
    chosen = [test for test in session.tests if not fit or test.number in (*fit, *check)]
    if check and all(test.number in check and test.number not in fit for test in chosen):
        raise UnusableInputError(
            "gap.nothing_to_fit", "every test is held out and none is left to be fitted: name one to fit as well"
        )
    if known_instrument(session.instrument):
        tests = _usable(chosen, remarks, lambda test: excitation_of(test, session.instrument))
        other = None if (fit or check) else _other_amplitude([item.test for item in tests])
        seen = tuple(_dataset_test(item, fit, check, remarks, held_out=item.test is other) for item in tests)
        noise = channel_noise(seen)
        seen = _on_one_surface(seen)
        return Dataset(
            session.instrument, seen, noise, tuple(remarks), gravity_m_s2=_gravity([item.test for item in tests])
        )
    alike = [test for test, names in _usable(chosen, remarks, lambda test: (test, input_output_names(test))) if names]
    fitting = [
        test
        for test in alike
        if input_output_names(test) == input_output_names(alike[0]) and test.sample_rate_hz == alike[0].sample_rate_hz
    ]
    remarks += [
        Message(
            "gap.other_signals",
            "test {number} is left out: its signals or its sample rate differ from those of the first test",
            number=test.number,
        )
        for test in alike
        if all(test is not other for other in fitting)
    ]
    alike = fitting
    other = None if (fit or check) else _other_amplitude(alike)
    held_out = [test.number for test in alike if test is other or (test.number in check and test.number not in fit)]
    about, items = as_oscillator(alike, [test for test in alike if test.number not in held_out] or alike)
    seen = tuple(
        _dataset_test(item, fit, check, remarks, held_out=item.test is other, settling_s=about.settling_s)
        for item in items
    )
    remarks.append(about.remark)
    if all(test.kind in ("slow_ramp", "step_hold") for test in alike):
        remarks.append(_SLOW)
    deviation = float(np.sqrt(np.mean([np.nanvar(test.signals["position"]) for test in seen])))
    noise = {name: max(level, BARE_NOISE * deviation) for name, level in channel_noise(seen).items()}
    return Dataset(about.device(alike[0].sample_rate_hz), seen, noise, tuple(remarks), equivalent=about)


def _on_one_surface(tests: Sequence[DatasetTest]) -> tuple[DatasetTest, ...]:
    """Return the tests with surfaces that differ as the positions at which the probe rests before each stimulus do.

    Every test finds the surface again, to a few tenths of a millimetre. Where the positions at rest agree better than
    these surfaces, the probe rests at one depth, the median of all tests; positions within ``AT_SURFACE_M`` are one.
    """
    resting = [test for test in tests if test.fixture == "tissue" and not test.starts_at_surface]
    starts = np.array([test.starting_position_m for test in resting])
    surfaces = np.array([test.surface_m for test in resting])
    if len(resting) < 2 or np.ptp(starts) >= np.ptp(surfaces):
        return tuple(tests)
    depth = float(np.median(starts - surfaces))
    if np.ptp(starts) <= AT_SURFACE_M:
        starts[:] = np.median(starts)
    new_surfaces = {test.number: float(start) - depth for test, start in zip(resting, starts, strict=True)}
    return tuple(replace(test, surface_m=new_surfaces.get(test.number, test.surface_m)) for test in tests)


def _gravity(tests: Sequence[Test]) -> tuple[float, float]:
    """Return gravity along the stroke and its standard deviation, m/s^2, as measured before the tests.

    Where it was not measured, or changed between the tests, any orientation is possible.
    """
    measured = [
        test.notes.get("gravity_along_stroke_m_s2") for test in tests if "gravity_across_stroke_m_s2" in test.notes
    ]
    finite = [value for value in measured if isinstance(value, float) and np.isfinite(value)]
    if len(finite) < len(tests) or np.ptp(finite) > 2.0 * GRAVITY_STD_M_S2:
        return 0.0, GRAVITY_M_S2
    return float(np.mean(finite)), GRAVITY_STD_M_S2


def _usable(tests: Sequence[Test], remarks: list[Message], take: Callable[[Test], T]) -> list[T]:
    """Return the result of ``take`` for each usable test; add a remark for each test that ``take`` refuses.

    Raises:
        UnusableInputError: no test is usable.
    """
    results = []
    for test in tests:
        try:
            if test.samples < max((SHORTEST_S + 2.0 * test.preload_s) * test.sample_rate_hz, LEAST_SAMPLES):
                raise UnusableInputError(
                    "gap.too_short",
                    "{seconds:.2g} s are too short for a diagnosis",
                    seconds=test.samples / test.sample_rate_hz,
                )
            results.append(take(test))
        except UnusableInputError as error:
            remarks.append(
                Message(
                    "gap.test_left_out", "test {number} is left out: {reason}", number=test.number, reason=error.message
                )
            )
    if not results:
        reason = remarks[0] if remarks else Message("gap.no_tests", "it holds no tests")
        raise UnusableInputError("gap.not_usable", "the session cannot be diagnosed: {reason}", reason=reason)
    return results


def _other_amplitude(tests: Sequence[Test]) -> Test | None:
    stochastic = [test for test in tests if test.kind == "stochastic" and test.repeat_of is None]
    return stochastic[-1] if len(stochastic) > 1 else None


def _dataset_test(
    item: ExcitedTest,
    fit: Sequence[int],
    check: Sequence[int],
    remarks: list[Message],
    *,
    held_out: bool,
    settling_s: float = 0.0,
) -> DatasetTest:
    test, rate = item.test, item.test.sample_rate_hz
    only_held_out = (test.number in check and test.number not in fit) or held_out
    most = MOST_FITTED_BARE if item.by == "input" else MOST_FITTED
    size = min(test.samples, MOST_HELD_OUT if only_held_out else most)
    if size < test.samples:
        remarks.append(
            Message(
                "gap.shortened",
                "of test {number} the first {used:.3g} s of {whole:.3g} s are used",
                number=test.number,
                used=size / rate,
                whole=test.samples / rate,
            )
        )
    signals = {name: values[:size] for name, values in item.signals.items()}
    purpose = _alternating_purposes(size, rate, settling_s, only_held_out, not check or test.number in check)
    fixture: Fixture = {"spring": "spring", "free_air": "air"}.get(test.kind, "tissue")  # type: ignore[assignment]
    surface = test.surface_position_m
    if item.by == "input":
        fixture, surface = "tissue", 0.0
    elif not np.isfinite(surface):
        surface = float(np.nanmedian(signals["position"][: max(3, round(0.002 * rate))]))
    if fixture == "tissue" and item.by != "input":
        off = _off_the_skin(signals["position"], surface, rate)
        purpose[off] = Purpose.NOTHING
        if off.any():
            remarks.append(
                Message(
                    "gap.off_skin",
                    "of test {number} {seconds:.2g} s are not used: the probe is off the skin or just back on it",
                    number=test.number,
                    seconds=off.sum() / rate,
                )
            )
    return DatasetTest(
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


def _alternating_purposes(
    size: int, rate_hz: float, settling_s: float, only_held_out: bool, also_held_out: bool
) -> NDArray[np.int8]:
    # Purposes of the alternating blocks, shape (size,).
    stretch = min(max(BLOCK_S, _MEMORIES * settling_s) * rate_hz, max(size / _LEAST_BLOCKS, BLOCK_S * rate_hz))
    turn = (np.arange(size) / max(min(stretch, size / 4), 1.0)).astype(np.int64) % 4
    purpose = np.full(size, Purpose.FIT, np.int8)
    if only_held_out:
        purpose[:] = np.where(turn % 2 == 0, Purpose.CHOICE, Purpose.CHECK)
    elif also_held_out:
        purpose[turn == 1] = Purpose.CHOICE
        purpose[turn == 3] = Purpose.CHECK
    purpose[: round(max(SETTLING_S, min(settling_s, 0.1 * size / rate_hz)) * rate_hz)] = Purpose.NOTHING
    return purpose


def _off_the_skin(position: NDArray[np.float64], surface_m: float, rate_hz: float) -> NDArray[np.bool_]:
    # The samples from where the probe is far off the skin, drifting freely, until ``RETURN_S`` after it met the skin
    # again, shape (n,). None where it is off from the beginning.
    depth = np.nan_to_num(position, nan=surface_m) - surface_m
    away = depth < -OFF_TISSUE_M
    off = np.zeros(depth.size, np.bool_)
    if not away.size or away[0]:
        return off
    end = 0
    for begin in map(int, np.flatnonzero(away[1:] & ~away[:-1]) + 1):
        if begin >= end:
            on_skin = np.flatnonzero(depth[begin:] >= 0.0)
            end = begin + int(on_skin[0]) if on_skin.size else depth.size
        off[begin : end + round(RETURN_S * rate_hz)] = True
    return off
