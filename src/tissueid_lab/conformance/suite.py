"""Run of the clauses on a device, with limits of time whatever the device does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from string import ascii_lowercase

from tissueid.errors import InstrumentError, LinkLostError, TissueIDError
from tissueid.messages import Message, Verbatim, stored
from tissueid.wire import MessageType
from tissueid_lab.conformance import frame_clauses, run_clauses, safety_clauses, setpoint_clauses
from tissueid_lab.conformance.clause import CLAUSES, Clause, ClauseResult, NotTestedError, ViolationError
from tissueid_lab.conformance.device import DeviceUnderTest

_MODULES = (frame_clauses, run_clauses, setpoint_clauses, safety_clauses)
"""Modules whose import registers the clauses."""
CLAUSE_S = 60.0
"""Longest time of one clause, without that of a person."""
ATTENDED_S = 300.0
SUITE_S = 1800.0
_MOST_SILENT = 2
"""Number of consecutive clauses without an answer to HELLO after which the rest is not tested."""

_SILENT = Message("conformance.silent", "not reached: the device does not answer")
_BROKEN = Message("conformance.broken", "not reached: the connection broke")
_UNATTENDED = Message("conformance.unattended", "needs a person at the instrument (--attended)")
_NO_TIME = Message("conformance.no_time", "not reached: the clauses took too long")


def run_suite(
    device: DeviceUnderTest,
    only: Iterable[str] | None = None,
    progress: Callable[[float, Clause], None] = lambda share, clause: None,
) -> tuple[ClauseResult, ...]:
    """Test clauses in their order and return their results; the coil is released before and after each.

    Args:
        device: connected.
        only: ids of the clauses; None for all.
        progress: called with the completed share and the next clause.

    Raises:
        CancelledError: the check of the device was cancelled; the coil is released.
    """
    wanted = None if only is None else set(only)
    chosen = [item for item in in_order() if wanted is None or item.id in wanted]
    begin = device.line.clock()
    results: list[ClauseResult] = []
    silent = 0
    rest: Message | None = None
    try:
        for number, clause in enumerate(chosen):
            progress(number / len(chosen), clause)
            if rest is None and device.line.clock() - begin > SUITE_S:
                rest = _NO_TIME
            if rest is not None:
                results.append(ClauseResult(clause.id, clause.title, "not tested", rest))
                continue
            if clause.person and not device.attended:
                results.append(ClauseResult(clause.id, clause.title, "not tested", _UNATTENDED))
                continue
            result, answered, broken = _tested(device, clause)
            results.append(result)
            silent = 0 if answered else silent + 1
            rest = _BROKEN if broken else _SILENT if silent >= _MOST_SILENT else None
    finally:
        _release_coil(device)
    return tuple(results)


def in_order() -> list[Clause]:
    """Return all clauses in the order of the document."""
    return sorted(CLAUSES.values(), key=_place)


def _place(clause: Clause) -> tuple[int, int, str]:
    """Return the place of a clause in the document: section, subsection, letter."""
    section, _, rest = clause.id.rstrip(ascii_lowercase).partition(".")
    return int(section), int(rest or 0), clause.id[-1]


def _tested(device: DeviceUnderTest, clause: Clause) -> tuple[ClauseResult, bool, bool]:
    """Return the result of a clause, whether the device answered HELLO, and whether the connection broke."""
    answered = False
    try:
        device.begin(CLAUSE_S)
        device.prepare()
        answered = True
        device.begin(ATTENDED_S if device.attended else CLAUSE_S)
        clause.check(device)
    except NotTestedError as error:
        return ClauseResult(clause.id, clause.title, "not tested", error.message, device.measured), answered, False
    except (ViolationError, InstrumentError) as error:
        failed = ClauseResult(clause.id, clause.title, "failed", error.message, device.measured)
        return failed, answered, isinstance(error, LinkLostError)
    except (LookupError, ValueError, TypeError, ArithmeticError) as error:  # of nonsense that no check foresees
        message = Message(
            "conformance.nonsense",
            "what the device sent cannot be evaluated: {kind}: {why}",
            kind=Verbatim(type(error).__name__),
            why=Verbatim(str(error)),
        )
        return ClauseResult(clause.id, clause.title, "failed", message, device.measured), answered, False
    finally:
        device.keep_alive(False)
        _release_coil(device)
    return ClauseResult(clause.id, clause.title, "passed", "", device.measured), answered, False


def _release_coil(device: DeviceUnderTest) -> None:
    """Release the coil without waiting for an answer."""
    with suppress(TissueIDError):
        device.send(MessageType.STOP)
        device.send(MessageType.RELEASE)


@dataclass(frozen=True)
class Conformance:
    """Result of the clauses of a device; ``device`` is its model and serial number, "" if it did not answer."""

    url: str
    device: str
    firmware: str
    attached: str
    force_n: float
    results: tuple[ClauseResult, ...]

    @property
    def passed(self) -> bool:
        """Whether clauses were tested and none failed."""
        outcomes = {item.outcome for item in self.results}
        return "passed" in outcomes and "failed" not in outcomes

    @property
    def headline(self) -> Message:
        """The numbers of clauses that passed, failed and were not tested."""
        counts = Counter(item.outcome for item in self.results)
        return Message(
            "conformance.headline",
            "{passed} clauses passed, {failed} failed, {open} not tested",
            passed=counts["passed"],
            failed=counts["failed"],
            open=counts["not tested"],
        )


def answer_of(conformance: Conformance) -> dict[str, object]:
    """Return the result for JSON."""
    return {
        "device": conformance.url,
        "instrument": conformance.device,
        "firmware_version": conformance.firmware,
        "attached": conformance.attached,
        "force_n": conformance.force_n,
        "passed": conformance.passed,
        "clauses": [
            asdict(item) | {"reason": item.reason, "message": stored(item.reason)} for item in conformance.results
        ],
    }
