"""Conformance of a device to docs/protocol.md: clauses, their checks, and the suite that runs them.

The checks send frames without the driver, so that the limits of the host are not in force: only those of the device
are tested. Nothing stronger is commanded than a person has confirmed.
"""

from tissueid.instrument.conformance import frame_clauses, run_clauses, safety_clauses, setpoint_clauses
from tissueid.instrument.conformance.clause import CLAUSES, Clause, ClauseResult
from tissueid.instrument.conformance.device import Confirmed, DeviceUnderTest
from tissueid.instrument.conformance.line import Act, Attendant, Line, LinkLine, Unattended
from tissueid.instrument.conformance.suite import in_order, passed, run_suite

_MODULES = (frame_clauses, run_clauses, setpoint_clauses, safety_clauses)

__all__ = [
    "CLAUSES",
    "Act",
    "Attendant",
    "Clause",
    "ClauseResult",
    "Confirmed",
    "DeviceUnderTest",
    "Line",
    "LinkLine",
    "Unattended",
    "in_order",
    "passed",
    "run_suite",
]
