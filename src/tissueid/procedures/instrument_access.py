"""Access of a program to instruments and to the audit log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from tissueid.audit import AuditLog, AuditTrail, Role, active_role, default_path
from tissueid.calibration.active import activate_calibration
from tissueid.instrument import FoundInstrument, Instrument, find_instruments, open_instrument


def user_log() -> AuditLog:
    """Return the audit log of this computer."""
    return AuditLog(default_path())


def audit_trail(role: Role = "researcher") -> AuditTrail:
    """Return a trail in the audit log of this computer; ``TISSUEID_ROLE`` overrides ``role``.

    Raises:
        UnusableInputError: ``TISSUEID_ROLE`` is not a role.
    """
    return AuditTrail(user_log(), active_role(role))


def opening_after(ready: Callable[[], None], opener: Callable[[str], Instrument]) -> Callable[[str], Instrument]:
    """Return an opener of instruments that calls ``ready`` first, which waits or raises."""

    def opened(url: str) -> Instrument:
        ready()
        return opener(url)

    return opened


@dataclass(frozen=True)
class InstrumentAccess:
    """How instruments are opened, found and calibrated, and the audit log of what is done; tests replace them.

    ``opener`` opens the instrument at an address, ``finder`` lists instruments, ``calibrate`` activates the newest
    calibration of an instrument.
    """

    opener: Callable[[str], Instrument] = open_instrument
    finder: Callable[..., list[FoundInstrument]] = find_instruments
    calibrate: Callable[[Instrument], object] = activate_calibration
    audit: AuditLog = field(default_factory=user_log)
