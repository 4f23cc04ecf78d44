"""Search for instruments and read how each is calibrated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from tissueid.app.calibration_state import CalibrationState, calibration_state
from tissueid.formatting import clean
from tissueid.instrument import FoundInstrument, Instrument
from tissueid.instrument.discovery import IN_PROCESS
from tissueid.messages import Message, Verbatim, translated
from tissueid.procedures.instrument_queries import survey_instruments

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


def survey(
    finder: Callable[..., list[FoundInstrument]],
    opener: Callable[[str], Instrument],
    calibrate: Callable[[Instrument], object],
) -> Survey:
    """Ask every port, and read the calibration of each instrument that answers.

    Raises:
        TissueIDError, OSError: the ports cannot be listed.
    """
    asked = survey_instruments(finder, opener, calibrate)
    calibrations = {url: calibration_state(device) for url, device in asked.devices.items()}
    return Survey(asked.found, calibrations, dict(asked.forces_n))
