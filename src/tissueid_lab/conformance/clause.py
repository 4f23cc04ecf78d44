"""A clause of the protocol with its check, the registry of all clauses, and results."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from tissueid.errors import TissueIDError
from tissueid.messages import Verbatim

Check = Callable[[Any], None]
Outcome = Literal["passed", "failed", "not tested"]


class ViolationError(TissueIDError):
    """The device does not do what the clause says."""


class NotTestedError(TissueIDError):
    """The clause cannot be tested here; the message says what it needs."""


@dataclass(frozen=True)
class Clause:
    """A clause of docs/protocol.md: ``id`` begins with the number of its section.

    ``check`` is called with a ``DeviceUnderTest`` and raises ViolationError or NotTestedError. ``drives`` is true if it
    can enable the amplifier, ``person`` if a person must act at the device.
    """

    id: str
    title: str
    drives: bool
    person: bool
    check: Check


@dataclass(frozen=True)
class ClauseResult:
    """Result of one clause. ``reason`` is "" where it passed; ``measured`` are figures of the check, SI, by name."""

    id: str
    title: str
    outcome: Outcome
    reason: str = ""
    measured: dict[str, float] = field(default_factory=dict)


CLAUSES: dict[str, Clause] = {}
"""All clauses by id; the modules of this package add theirs."""


def clause(identity: str, title: str, *, drives: bool = False, person: bool = False) -> Callable[[Check], Check]:
    """Return a decorator that registers a check as the one of a clause."""

    def add(check: Check) -> Check:
        if identity in CLAUSES:
            raise ValueError(f"clause {identity} is registered twice")
        CLAUSES[identity] = Clause(identity, title, drives, person, check)
        return check

    return add


def violated(expected: str, got: object) -> ViolationError:
    """Return the error of a device that did something else."""
    return ViolationError(
        "conformance.expected", "expected {expected}, got {got}", expected=Verbatim(expected), got=Verbatim(str(got))
    )


def require(condition: object, expected: str, got: object) -> None:
    """Raise ViolationError if ``condition`` is false."""
    if not condition:
        raise violated(expected, got)
