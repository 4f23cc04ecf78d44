"""What passes between the window and the thread that calibrates: what is wanted, how far it is, what came of it."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from tissueid.app.calibration_state import CalibrationState
from tissueid.app.emergency import EmergencyStop
from tissueid.calibration.file import Calibration
from tissueid.errors import UnusableInputError
from tissueid.language import _

Kind = Literal["static", "sweep"]
_WAIT_S = 0.1


@dataclass(frozen=True)
class CalibrationPlan:
    """Which calibration of which instrument; ``ambient_c`` is the room's temperature where somebody read it.

    With ``push_only`` the probe is not fixed to the spring and no more than leans on it.
    """

    url: str
    kind: Kind
    folder: Path
    ambient_c: float | None = None
    push_only: bool = False

    def check(self) -> None:
        """Refuse what can be seen to be wrong before an instrument is touched.

        Raises:
            UnusableInputError: no instrument is chosen.
        """
        if not self.url:
            raise UnusableInputError(_("choose an instrument, or type its address"))


@dataclass(frozen=True)
class CalibrationOutcome:
    """What came of it. ``remarks`` is what else is worth saying, ``state`` how the instrument is calibrated now.

    ``report`` is None where it could not be written; the calibration holds without it.
    """

    calibration: Calibration
    path: Path
    report: Path | None
    remarks: tuple[str, ...]
    state: CalibrationState = field(default_factory=CalibrationState)


@dataclass(frozen=True)
class Talk:
    """A calibration at one moment: its step, how much of it is done, what a person is wanted for.

    ``answer`` is whether the person has to say that it is done; otherwise it is seen.
    """

    step: str = ""
    fraction: float = 0.0
    wanted: str = ""
    answer: bool = False


class Conversation:
    """Between the thread that calibrates and the window: progress one way, questions and answers both ways."""

    def __init__(self, stop: EmergencyStop) -> None:
        self._stop = stop
        self._talk = Talk()
        self._done = threading.Event()

    def show(self, step: str, fraction: float) -> None:
        """How far a step is."""
        self._talk = Talk(step, fraction)

    def ask(self, words: str) -> None:
        """Have the person do something; returns when it is done, or when everything is stopped."""
        self._done.clear()
        self._talk = replace(self._talk, wanted=words, answer=True)
        while not self._done.wait(_WAIT_S) and not self._stop.is_set():
            pass
        self.want("")

    def want(self, words: str, step: str | None = None) -> None:
        """Have the person do something that is seen when it is done; no words: nothing is wanted any more."""
        shown = self._talk.step if step is None else step
        self._talk = replace(self._talk, step=shown, wanted=words, answer=False)

    def answer(self) -> None:
        """The person says that it is done."""
        self._done.set()

    @property
    def stopped(self) -> bool:
        """Whether it is being stopped."""
        return self._stop.is_set()

    def look(self) -> Talk:
        """What there is to see."""
        return self._talk
