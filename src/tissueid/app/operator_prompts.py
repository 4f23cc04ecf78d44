"""Communication between the window and the calibration thread: progress, prompts to the person, result."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field, replace
from pathlib import Path

from tissueid.app.calibration_state import CalibrationState
from tissueid.app.emergency import EmergencyStop
from tissueid.calibration.file import Calibration
from tissueid.procedures.control import Control

_WAIT_S = 0.1


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


class OperatorPrompts(Control):
    """Passes progress and instructions from the calibration thread to the window, and confirmations back.

    ``notices`` are collected for the end.
    """

    def __init__(self, stop: EmergencyStop) -> None:
        self.notices: list[str] = []
        self._stop = stop
        self._prompts = PromptState()
        self._done = threading.Event()

    def progress(self, fraction: float | None, step: str) -> None:
        """Show the fraction of a step that is done."""
        now = self._prompts
        self._prompts = replace(now, step=step, fraction=now.fraction if fraction is None else fraction)

    def notice(self, message: str) -> None:
        """Keep a notice for the end."""
        self.notices.append(message)

    @property
    def attended(self) -> bool:
        """There is a person at the window."""
        return True

    def ask(self, prompt: str) -> None:
        """Show an instruction; return when the person confirms that it is done.

        Raises:
            CancelledError: the stop was triggered.
        """
        self._done.clear()
        self._prompts = replace(self._prompts, instruction=prompt, answer=True)
        while not self._done.wait(_WAIT_S) and not self._stop.is_set():
            pass
        self.instruct("")
        self.check()

    def instruct(self, prompt: str) -> None:
        """Show an instruction that needs no confirmation; "" removes it."""
        self._prompts = replace(self._prompts, instruction=prompt, answer=False)

    def answer(self) -> None:
        """Confirm that the instruction was carried out."""
        self._done.set()

    def cancelled(self) -> bool:
        """Whether the calibration is being stopped."""
        return self._stop.is_set()

    def check(self) -> bool:
        """Return False, or raise if the stop was triggered.

        Raises:
            CancelledError: the stop was triggered; the message says why.
        """
        return self._stop.check()

    def snapshot(self) -> PromptState:
        """Return the current state."""
        return self._prompts
