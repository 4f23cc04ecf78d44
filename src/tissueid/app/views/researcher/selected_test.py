"""A selected test of a session file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path


@dataclass(frozen=True)
class SelectedTest:
    """A selected test: file, number and label.

    ``site`` and ``pseudonym`` are as the file has them; ``label`` is cleaned and short. ``when`` is the time of the
    session in seconds since 1970, None where it is not known.
    """

    path: Path
    number: int
    site: str
    pseudonym: str
    label: str
    when: float | None = None


def timestamp_of(created: str) -> float | None:
    """Return an ISO date as seconds since 1970, in UTC if it has no zone; None if it is no date."""
    try:
        when = datetime.fromisoformat(created)
        seconds = (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError, OSError):
        return None
    return seconds if math.isfinite(seconds) else None


__all__ = ["SelectedTest", "timestamp_of"]
