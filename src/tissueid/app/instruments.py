"""Search for instruments and read how each is calibrated."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from tissueid.app.calibration_state import CalibrationState, calibration_state
from tissueid.formatting import clean
from tissueid.instrument import RESEARCH, FoundInstrument, Instrument
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.messages import Message, Verbatim, translated

_MOST_NAMED = 4


@dataclass(frozen=True)
class Survey:
    """Found instruments, and calibration and maximum force, N, of those that answered, by address."""

    found: Sequence[FoundInstrument]
    calibrations: dict[str, CalibrationState] = field(default_factory=dict)
    forces_n: dict[str, float] = field(default_factory=dict)

    @property
    def words(self) -> str:
        """Number and names of the instruments that answer."""
        answering = [item for item in self.found if item.answers is True and not item.url.startswith(IN_PROCESS)]
        names = "; ".join(clean(translated(item.name or item.what)) for item in answering[:_MOST_NAMED])
        if len(answering) > 1:
            what = Message(
                "instruments.answer",
                "{count} instruments answer ({names})",
                count=len(answering),
                names=Verbatim(names),
            )
        elif answering:
            what = Message("instruments.one_answers", "One instrument answers ({names})", names=Verbatim(names))
        else:
            what = Message("instruments.none_answers", "No instrument answers")
        return translated(
            Message("instruments.found", "{what}; simulations in this program can always be chosen.", what=what)
        )


def greatest_force_n(instrument: Instrument) -> float:
    """Return the maximum force of an instrument, N in whole tenths, by its amplifier and its own limits."""
    own = math.floor(10.0 * instrument.narrowed(RESEARCH).max_force_n) / 10.0
    return min(instrument.device.greatest_force_n, own)


def survey(
    finder: Callable[..., list[FoundInstrument]],
    opener: Callable[[str], Instrument],
    calibrate: Callable[[Instrument], object],
) -> Survey:
    """Ask every port, and read the calibration of each instrument that answers.

    Raises:
        TissueIDError, OSError: the ports cannot be listed.
    """
    calibrations: dict[str, CalibrationState] = {}
    forces_n: dict[str, float] = {}

    def open_and_ask(url: str) -> Instrument:
        instrument = opener(url)
        try:
            calibrate(instrument)
            forces_n[url] = greatest_force_n(instrument)
        except BaseException:
            instrument.close()
            raise
        calibrations[url] = calibration_state(instrument.device)
        return instrument

    return Survey(finder(probe=True, opener=open_and_ask), calibrations, forces_n)
