"""Communication between the window and the calibration thread: plan, progress, prompts to the person, result."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from tissueid.app.calibration_state import CalibrationState
from tissueid.app.emergency import EmergencyStop
from tissueid.app.plan import NO_INSTRUMENT
from tissueid.calibration.file import Calibration
from tissueid.errors import UnusableInputError

Kind = Literal["static", "sweep"]
_WAIT_S = 0.1


@dataclass(frozen=True)
class CalibrationPlan:
    """Which calibration of which instrument. ``ambient_c`` is the measured temperature of the room, or None.

    With ``push_only`` the probe leans on the spring and is not fixed to it.
    """

    url: str
    kind: Kind
    folder: Path
    ambient_c: float | None = None
    push_only: bool = False

    def check(self) -> None:
        """Raise an error for a plan that is wrong before an instrument is opened.

        Raises:
            UnusableInputError: no instrument is chosen.
        """
        if not self.url:
            raise UnusableInputError(NO_INSTRUMENT)


@dataclass(frozen=True)
class CalibrationOutcome:
    """The result. ``remarks`` are further messages, ``state`` is the new state of the instrument's calibration.

    ``report`` is None if it could not be written; the calibration is valid without it.
    """

    calibration: Calibration
    path: Path
    report: Path | None
    remarks: tuple[str, ...]
    state: CalibrationState = field(default_factory=CalibrationState)


@dataclass(frozen=True)
class PromptState:
    """State of a running calibration: its step, the fraction done, and the instruction to the person.

    With ``answer`` the person has to confirm that it is done; otherwise the instrument detects it.
    """

    step: str = ""
    fraction: float = 0.0
    instruction: str = ""
    answer: bool = False


class OperatorPrompts:
    """Passes progress and instructions from the calibration thread to the window, and confirmations back."""

    def __init__(self, stop: EmergencyStop) -> None:
        self._stop = stop
        self._prompts = PromptState()
        self._done = threading.Event()

    def show(self, step: str, fraction: float) -> None:
        """Show the fraction of a step that is done."""
        self._prompts = PromptState(step, fraction)

    def prompt_and_wait(self, words: str) -> None:
        """Show an instruction; return when the person confirms that it is done, or when the stop is triggered."""
        self._done.clear()
        self._prompts = replace(self._prompts, instruction=words, answer=True)
        while not self._done.wait(_WAIT_S) and not self._stop.is_set():
            pass
        self.prompt("")

    def prompt(self, words: str, step: str | None = None) -> None:
        """Show an instruction that needs no confirmation; empty ``words`` remove it."""
        shown = self._prompts.step if step is None else step
        self._prompts = replace(self._prompts, step=shown, instruction=words, answer=False)

    def answer(self) -> None:
        """Confirm that the instruction was carried out."""
        self._done.set()

    @property
    def stopped(self) -> bool:
        """Whether the calibration is being stopped."""
        return self._stop.is_set()

    def snapshot(self) -> PromptState:
        """Return the current state."""
        return self._prompts
