"""Execution of slow work in a thread while the connection to the instrument is kept alive."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

from tissueid.acquisition.playback import CANCELLED_BETWEEN
from tissueid.errors import CancelledError
from tissueid.instrument import Instrument, SimulatedInstrument

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
