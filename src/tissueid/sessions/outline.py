"""A session without its signals, for lists of many sessions."""

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
        """Length of the test, s."""
        return self.samples / self.test.sample_rate_hz


@dataclass(frozen=True)
class Outline:
    """A session without its tests (``head``), and the outlines of the tests in the order of their numbers."""

    head: Session
    tests: tuple[TestOutline, ...]
