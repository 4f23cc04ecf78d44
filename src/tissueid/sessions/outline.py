"""What a session says of itself before its signals are read: enough for a list of a thousand."""

from __future__ import annotations

from dataclasses import dataclass

from tissueid.sessions.model import Session, Test


@dataclass(frozen=True)
class TestOutline:
    """A test without its signals: ``test.signals`` is empty. ``signals`` are their names, ``samples`` their length."""

    __test__ = False

    test: Test
    samples: int
    signals: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """How long the test is, s."""
        return self.samples / self.test.sample_rate_hz


@dataclass(frozen=True)
class Outline:
    """A session without its tests, which are outlined beside it in the order of their numbers."""

    head: Session
    tests: tuple[TestOutline, ...]
