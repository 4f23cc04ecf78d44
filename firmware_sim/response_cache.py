"""Cache of responses: a repeated request gets the same response and is not executed again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from tissueid.wire import Frame

MOST_ANSWERS = 64
"""Largest number of cached responses; a host repeats only its newest requests."""


class ResponseCache:
    """The newest responses, by type and sequence number of the request."""

    def __init__(self) -> None:
        self._answers: OrderedDict[tuple[int, int], bytes] = OrderedDict()

    def forget(self) -> None:
        """Clear the cache for a new host, which restarts its sequence numbers."""
        self._answers.clear()

    def once(self, frame: Frame, answer: Callable[[], bytes]) -> bytes:
        """Return the cached response to a request, or call ``answer`` if there is none."""
        key = (frame.type, frame.sequence)
        if key not in self._answers:
            self._answers[key] = answer()
            if len(self._answers) > MOST_ANSWERS:
                self._answers.popitem(last=False)
        return self._answers[key]
