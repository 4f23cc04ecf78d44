"""Work that takes seconds, done while the line to the instrument is kept alive."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
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
        CancelledError: ``cancelled`` said so; raised when the work is done.
        InstrumentError: as ``poll`` says, and whatever the work raises.
    """
    if isinstance(instrument, SimulatedInstrument):
        return work()
    with ThreadPoolExecutor(1, "work beside the instrument") as pool:
        done = pool.submit(work)
        try:
            while wait((done,), _REST_S).not_done:
                if cancelled():
                    raise CancelledError("cancelled between two tests; the coil is free and what was recorded is kept")
                instrument.poll(0.0)
        except BaseException:
            instrument.release()  # the soft end of the run before may not be over
            raise
    return done.result()
