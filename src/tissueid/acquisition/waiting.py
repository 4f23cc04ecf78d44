"""Work that takes seconds, done while the line to the instrument is kept alive."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

from tissueid.errors import CancelledError
from tissueid.instrument import Instrument, SimulatedInstrument

_REST_S = 0.02
"""Between two reads: a pseudo-terminal holds a tenth of a second of samples."""

_Result = TypeVar("_Result")


def meanwhile(
    instrument: Instrument, work: Callable[[], _Result], cancelled: Callable[[], bool] = lambda: False
) -> _Result:
    """Return what ``work`` returns, and read the instrument while it lasts; nothing is played.

    A device that streams to a host which does not read takes it for dead. A simulation in this process has no clock of
    its own and waits.

    Raises:
        CancelledError: ``cancelled`` said so; the work is left to itself.
        InstrumentError: as ``poll`` says, and whatever the work raises.
    """
    if isinstance(instrument, SimulatedInstrument):
        return work()
    done: Future[_Result] = Future()

    def run() -> None:
        try:
            done.set_result(work())
        except BaseException as error:  # noqa: BLE001 - raised where the result is asked for
            done.set_exception(error)

    # Not waited for when it is not wanted any more, and no reason for the program to stay.
    threading.Thread(target=run, name="work beside the instrument", daemon=True).start()
    try:
        while wait((done,), _REST_S).not_done:
            if cancelled():
                raise CancelledError("cancelled between two tests; the coil is free and what was recorded is kept")
            instrument.poll(0.0)
    except BaseException:
        instrument.release()  # the soft end of the run before may not be over
        raise
    return done.result()
