"""Execution of slow work in a thread while the connection to the instrument is kept alive."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.playback import CANCELLED_BETWEEN, POLL_S, never_stop
from tissueid.device import DeviceDescription
from tissueid.errors import CancelledError
from tissueid.instrument import Instrument, SimulatedInstrument
from tissueid.instrument.thermal import PLAUSIBLE_C, WindingTemperature
from tissueid.messages import Message

_REST_S = 0.02
"""Time between two polls, s; a pseudo-terminal buffers a tenth of a second of samples."""

_Result = TypeVar("_Result")


def run_while_polling(
    instrument: Instrument, work: Callable[[], _Result], cancelled: Callable[[], bool] = lambda: False
) -> _Result:
    """Run ``work`` in a thread, poll the instrument meanwhile, and return the result of ``work``.

    The watchdog of a real instrument needs the polls. An in-process simulation is not polled: it only advances by
    polls, and their number would change the noise of the following test.

    Raises:
        CancelledError: ``cancelled`` returned True; the thread is not stopped, its result is discarded.
        InstrumentError: see ``poll``; also any exception of ``work``.
    """
    if isinstance(instrument, SimulatedInstrument):
        return work()
    done: Future[_Result] = Future()
    # A daemon thread: cancelled work does not keep the program alive.
    threading.Thread(target=_run, args=(work, done), name="background work", daemon=True).start()
    try:
        while wait((done,), _REST_S).not_done:
            if cancelled():
                raise CancelledError(CANCELLED_BETWEEN)
            instrument.poll(0.0)
    except BaseException:
        instrument.release()  # the soft end of the previous run may not be over
        raise
    try:
        return done.result()
    finally:
        del done  # it holds the error, whose frames hold this one: the instrument would stay until a collection


def _run(work: Callable[[], _Result], done: Future[_Result]) -> None:
    try:
        done.set_result(work())
    except BaseException as error:  # noqa: BLE001 - raised by ``done.result()``
        done.set_exception(error)
    finally:
        del work, done  # the error holds this frame


MAX_REST_S = 600.0
"""Maximum proposed rest period, s."""
_RESOLUTION_S = 5.0
"""Resolution of the proposed rest period, s."""
_MARGIN_K = 6.0
"""Safety margin, K: after a restart the instrument assumes its coil to be 5 K warmer than the sensor reads."""
_POLLS = 40
"""Maximum number of polls until the sensor gives a temperature."""


@dataclass(frozen=True)
class HeatingForecast:
    """Predicted coil temperatures of repeated tests.

    ``temperatures_c`` are those at the end of each test, degC. ``rest_s`` is the rest period between two tests that
    keeps all of them below ``limit_c``: 0 if none is needed, None if none is long enough.
    """

    temperatures_c: tuple[float, ...]
    limit_c: float
    rest_s: float | None

    @property
    def first_too_hot(self) -> int | None:
        """Number, from 1, of the first test that may reach the limit; None without one."""
        hot = (n for n, value in enumerate(self.temperatures_c, start=1) if value + _MARGIN_K > self.limit_c)
        return next(hot, None)

    @property
    def warning(self) -> str:
        """Message for the operator before the first test; "" if no test gets too hot."""
        first = self.first_too_hot
        if first is None:
            return ""
        values = {
            "test": first,
            "count": len(self.temperatures_c),
            "reached": self.temperatures_c[first - 1] + _MARGIN_K,
            "limit": self.limit_c,
        }
        if self.rest_s is None:
            return Message(
                "test.too_warm",
                "test {test} of {count} is predicted to heat the coil to {reached:.0f} °C and to end at the limit of "
                "{limit:g} °C: use less force or shorter tests",
                **values,
            )
        return Message(
            "test.needs_rest",
            "test {test} of {count} is predicted to heat the coil to {reached:.0f} °C and to end at the limit of "
            "{limit:g} °C: --rest {rest:.0f} keeps it below",
            **values,
            rest=self.rest_s,
        )


def predict_heating(
    command_v: NDArray[np.float64],
    device: DeviceDescription,
    *,
    repeats: int,
    rest_s: float,
    begin_c: float,
    limit_c: float,
) -> HeatingForecast:
    """Predict the coil temperatures, degC, when one command, shape (n,), V, is repeated with ``rest_s`` in between."""
    current = command_v * device.amplifier_gain / device.coil_resistance_ohm

    def ends(rest: float) -> tuple[float, ...]:
        winding = WindingTemperature(device)
        winding.take(np.zeros(0), np.array([begin_c]), 0.0)
        unknown = np.full(current.size, np.nan)  # no sensor yet
        temperatures = []
        for repeat in range(repeats):
            if repeat:
                winding.cool(rest)
            winding.take(current, unknown, 0.0)
            temperatures.append(winding.temperature_c)
        return tuple(temperatures)

    def holds(steps: int) -> bool:
        return max(ends(steps * _RESOLUTION_S)) + _MARGIN_K <= limit_c

    low, high = -1, round(MAX_REST_S / _RESOLUTION_S)
    needed: float | None = None
    if holds(high):
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if holds(middle) else (middle, high)
        needed = high * _RESOLUTION_S
    return HeatingForecast(ends(rest_s), limit_c, needed)


def temperature_c(instrument: Instrument, cancelled: Callable[[], bool] = never_stop) -> float:
    """Return the temperature of the coil's sensor, degC; NaN if it gives no plausible value.

    Raises:
        CancelledError: ``cancelled`` returned True.
        InstrumentError: as ``poll``.
    """
    for _ in range(_POLLS):
        if cancelled():
            raise CancelledError(CANCELLED_BETWEEN)
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
    cancelled: Callable[[], bool] = never_stop,
) -> None:
    """Keep the coil free for ``seconds`` of the instrument's clock while polling.

    Raises:
        CancelledError: ``cancelled`` returned True.
        InstrumentError: see ``poll``.
    """
    wanted = round(seconds * instrument.device.sample_rate_hz)
    first: int | None = None
    passed = 0
    while passed < wanted:
        if cancelled():
            raise CancelledError(CANCELLED_BETWEEN)
        index = instrument.poll(POLL_S)["index"]
        if index.size:
            first = int(index[0]) if first is None else first
            passed = int(index[-1]) + 1 - first
            progress(min(1.0, passed / wanted))
