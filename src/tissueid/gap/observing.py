"""From a session to what the diagnosis uses of it: which tests, how much of each, and what each sample serves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import UnusableInputError
from tissueid.gap.driving import LEAST_SAMPLES, Driven, as_equivalent, bare, driven, known_instrument
from tissueid.gap.noise import channel_noise
from tissueid.gap.observed import Fixture, Observed, ObservedTest, Purpose
from tissueid.sessions import Session, Test

T = TypeVar("T")

BLOCK_S = 0.25
"""Length of the stretches that take turns in serving fit, choice and check: some times the chain's memory."""
SETTLING_S = 0.010
"""Left out of every score at the start of a test: the coil's state before it is not recorded."""
LEFT_BEHIND_M = 2e-3
"""A probe that is further than this off the surface is not on the tissue."""
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
    purpose = _turns(size, rate, settling_s, only_held_out, not check or test.number in check)
    fixture: Fixture = {"spring": "spring", "free_air": "air"}.get(test.kind, "tissue")  # type: ignore[assignment]
    surface = test.surface_position_m
    if item.by == "input":
        fixture, surface = "tissue", 0.0
    elif not np.isfinite(surface):
        surface = float(np.nanmedian(signals["position"][: max(3, round(0.002 * rate))]))
    if fixture == "tissue" and item.by != "input":
        left = _left_the_skin(signals["position"], surface)
        purpose[left:] = Purpose.NOTHING
        if left < size:
            remarks.append(f"test {test.number} is used as far as the probe left the skin, {left / rate:.2g} s")
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


def _turns(size: int, rate_hz: float, settling_s: float, only_held_out: bool, also_held_out: bool) -> NDArray[np.int8]:
    # Stretches take turns; shape (size,).
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


def _left_the_skin(position: NDArray[np.float64], surface_m: float) -> int:
    # The sample from which on the probe is far off the skin, where nothing holds it: where it drifts to says nothing,
    # and errors grow without end. All of them where it never is, or is from the beginning.
    away = np.nan_to_num(position, nan=surface_m) < surface_m - LEFT_BEHIND_M
    return int(np.argmax(away)) if away.any() and not away[0] else position.size
