"""What was answered to whom: a request that is repeated gets the same answer and acts no second time."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from tissueid.wire import Frame

MOST_ANSWERS = 64
"""A host repeats its newest requests alone."""


class Answered:
    """The newest answers, by type and sequence number of the request."""

    def __init__(self) -> None:
        self._answers: OrderedDict[tuple[int, int], bytes] = OrderedDict()

    def forget(self) -> None:
        """A new host counts its requests from the start again."""
        self._answers.clear()

    def once(self, frame: Frame, answer: Callable[[], bytes]) -> bytes:
        """What was answered to this request, or is now for the first time."""
        key = (frame.type, frame.sequence)
        if key not in self._answers:
            self._answers[key] = answer()
            if len(self._answers) > MOST_ANSWERS:
                self._answers.popitem(last=False)
        return self._answers[key]
