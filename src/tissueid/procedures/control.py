"""Progress, cancellation and prompts of a procedure: the one interface to the program that runs it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from tissueid.errors import CANCELLED, CancelledError
from tissueid.messages import Message

if TYPE_CHECKING:  # takes long to import
    from tissueid.instrument import Instrument

COUNTED = "procedure.counted"
"""Code of a step with the number of its items that are done."""

BY_KEY = Message("stop.key", "stopped by key")
"""Reason of a stop by a key, at a terminal or in the window."""


def counted(step: str, done: int, total: int) -> Message:
    """Return a step with the number of its items that are done."""
    return Message(COUNTED, "{step}: {done} of {total}", step=step, done=done, total=total)


class RemainingTime:
    """Remaining time of long work, extrapolated from the completed share.

    Args:
        clock: returns seconds.
    """

    FIRST_S = 3.0
    """Time from which the remaining time is stated, s."""
    LEAST_SHARE = 0.03
    """Completed share from which it is stated."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._began = clock()

    def added_to(self, step: Message, share: float) -> Message:
        """Return a step of ``counted`` with the remaining time, if that can be estimated already."""
        passed = self._clock() - self._began
        if passed < self.FIRST_S or not self.LEAST_SHARE <= share < 1.0:
            return step
        remaining_s = passed * (1.0 - share) / share
        if remaining_s < 90.0:
            return Message(
                "procedure.seconds_left", "{step}, about {seconds:.0f} s left", step=step, seconds=remaining_s
            )
        return Message(
            "procedure.minutes_left", "{step}, about {minutes:.0f} min left", step=step, minutes=remaining_s / 60.0
        )


class CountedProgress:
    """Reports the completed items of long work with the remaining time; called with each completed item.

    Args:
        control: of the procedure.
        step: what is done with the items.
        total: number of items.
    """

    def __init__(self, control: Control, step: str, total: int) -> None:
        self._control, self._step, self._total = control, step, total
        self._done, self._remaining = 0, RemainingTime()
        control.progress(0.0, counted(step, 0, total))

    def __call__(self, _item: object) -> None:
        """Count a completed item."""
        self._done += 1
        share = self._done / self._total
        text = counted(self._step, self._done, self._total)
        self._control.progress(share, self._remaining.added_to(text, share))


class Control:
    """What a procedure reports and asks; this one shows nothing, is never cancelled and has no person.

    The command line and the window override the methods that they need. All may be called from the thread of the
    procedure only, except ``cancelled``.
    """

    def progress(self, fraction: float | None, step: str) -> None:
        """Show a step, usually a ``Message``, and its completed share from 0 to 1; None where that is not known."""

    def follow(self, step: str, share: float) -> None:
        """Show a step and its completed share; the ``progress`` callback of ``analysis``.

        Raises:
            CancelledError: the procedure was cancelled.
        """
        self.progress(share, step)
        self.check()

    def notice(self, message: str) -> None:
        """Show a message that does not end the procedure: a warning, or what it chose by itself."""

    def finished(self, part: object) -> None:
        """Show a part of the result that is ready; it belongs to the whole result too."""

    def instruct(self, prompt: str) -> None:
        """Show an instruction that needs no confirmation; "" removes it."""

    def opened(self, instrument: Instrument) -> None:
        """Take the instrument that a procedure has opened, to follow its samples."""

    @property
    def attended(self) -> bool:
        """Whether ``ask`` reaches a person."""
        return False

    def ask(self, prompt: str) -> None:
        """Show an instruction, and return when a person has confirmed that it is done.

        Raises:
            CancelledError: there is no person, or the procedure was cancelled meanwhile.
        """
        raise CancelledError(prompt)

    def cancelled(self) -> bool:
        """Return whether the procedure should end."""
        return False

    @property
    def reason(self) -> str:
        """Why the procedure was cancelled: the text of the error that ``check`` raises."""
        return CANCELLED

    def check(self) -> bool:
        """Return False, or raise if the procedure was cancelled; the ``cancelled`` callback of ``acquisition``.

        Raises:
            CancelledError: it was cancelled.
        """
        if self.cancelled():
            raise CancelledError(self.reason)
        return False
