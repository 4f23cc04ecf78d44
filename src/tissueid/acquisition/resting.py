"""Rest between repeats: how long the coil needs by calculation, and keeping the line alive meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.playing import POLL_S, never
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError
from tissueid.instrument import Instrument
from tissueid.instrument.thermal import PLAUSIBLE_C, Winding

MOST_REST_S = 600.0
_STEP_S = 5.0
_MARGIN_K = 6.0
"""The instrument calculates as well, and after a restart takes its coil to be 5 K warmer than the sensor says."""
_POLLS = 40


@dataclass(frozen=True)
class Foreseen:
    """What repeats make of the coil by calculation.

    ``temperatures_c``, one a test, are those at its end. ``rest_s`` is the rest between two tests that keeps all of
    them below the limit: 0 where none is needed, None where none is long enough.
    """

    temperatures_c: tuple[float, ...]
    limit_c: float
    rest_s: float | None

    @property
    def first_too_warm(self) -> int | None:
        """The first test, from 1, that the limit may end; None where there is none."""
        hot = (n for n, value in enumerate(self.temperatures_c, start=1) if value + _MARGIN_K > self.limit_c)
        return next(hot, None)

    @property
    def words(self) -> str:
        """One line for who is about to begin; empty where all goes well."""
        first = self.first_too_warm
        if first is None:
            return ""
        count = len(self.temperatures_c)
        need = (
            "ask for less force, or shorter tests"
            if self.rest_s is None
            else f"--rest {self.rest_s:.0f} keeps it below"
        )
        return (
            f"by calculation test {first} of {count} warms the coil to some "
            f"{self.temperatures_c[first - 1] + _MARGIN_K:.0f} °C; the limit is {self.limit_c:g} °C, and ends it: "
            f"{need}"
        )


def foresee(
    command_v: NDArray[np.float64],
    device: DeviceDescription,
    *,
    repeats: int,
    rest_s: float,
    begin_c: float,
    limit_c: float,
) -> Foreseen:
    """How warm a coil of ``begin_c`` gets from one command, shape (n,), V, repeated with ``rest_s`` in between."""
    current = command_v * device.amplifier_gain / device.coil_resistance_ohm

    def ends(rest: float) -> tuple[float, ...]:
        winding = Winding(device)
        winding.take(np.zeros(0), np.array([begin_c]), 0.0)
        nothing = np.full(current.size, np.nan)  # no sensor yet
        found = []
        for repeat in range(repeats):
            if repeat:
                winding.rest(rest)
            winding.take(current, nothing, 0.0)
            found.append(winding.temperature_c)
        return tuple(found)

    def holds(steps: int) -> bool:
        return max(ends(steps * _STEP_S)) + _MARGIN_K <= limit_c

    low, high = -1, round(MOST_REST_S / _STEP_S)
    needed: float | None = None
    if holds(high):
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if holds(middle) else (middle, high)
        needed = high * _STEP_S
    return Foreseen(ends(rest_s), limit_c, needed)


def temperature_c(instrument: Instrument) -> float:
    """What the coil's sensor says now, degC; NaN where it says nothing that can be.

    Raises:
        InstrumentError: as ``poll`` says.
    """
    for _ in range(_POLLS):
        values = instrument.poll(POLL_S)["temperature"]
        values = values[(values >= PLAUSIBLE_C[0]) & (values <= PLAUSIBLE_C[1])]
        if values.size:
            return float(values.mean())
    return float("nan")


def rest(
    instrument: Instrument,
    seconds: float,
    *,
    progress: Callable[[float], None] = lambda _: None,
    cancelled: Callable[[], bool] = never,
) -> None:
    """Leave the coil free for so long by the instrument's clock, and read on.

    Raises:
        CancelledError: ``cancelled`` said so.
        InstrumentError: as ``poll`` says.
    """
    wanted = round(seconds * instrument.device.sample_rate_hz)
    first: int | None = None
    passed = 0
    while passed < wanted:
        if cancelled():
            raise CancelledError("cancelled between two tests; the coil is free and what was recorded is kept")
        index = instrument.poll(POLL_S)["index"]
        if index.size:
            first = int(index[0]) if first is None else first
            passed = int(index[-1]) + 1 - first
            progress(min(1.0, passed / wanted))
