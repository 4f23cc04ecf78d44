"""Conformance of a device to the protocol: what is confirmed, the run of the clauses, and the page."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from tissueid.errors import UnusableInputError
from tissueid.messages import Message, Verbatim
from tissueid.plan_options import Option, Plan
from tissueid.procedures.control import Control, counted
from tissueid.procedures.output_files import HTML, check_output

if TYPE_CHECKING:  # each takes long to import
    from tissueid.audit import AuditTrail
    from tissueid.instrument import Link
    from tissueid_lab.conformance.clause import Clause
    from tissueid_lab.conformance.exchange import Act
    from tissueid_lab.conformance.suite import Conformance

Attached = Literal["coil-dummy", "free-coil"]

_ACT_S = 15.0
"""Time that a person has for an act at the device, s."""


class ConformancePlan(Plan):
    """A device, what is attached to it, and the largest force and temperature that a person has confirmed."""

    device: Annotated[str, Option("--device", metavar="URL", help="port of the device; see 'tissueid devices'")]
    attached: Annotated[
        Attached | None,
        Option(
            "--confirm",
            metavar="WHAT",
            help="confirm what is attached: coil-dummy or free-coil; never a coil on a person",
        ),
    ] = None
    force_n: Annotated[
        float, Option("--force", metavar="N", help="largest force of the runs"), Field(gt=0.0, le=2.0)
    ] = 1.0
    temperature_c: Annotated[
        float, Option("--temperature", metavar="DEGC", help="temperature limit of the runs"), Field(ge=20.0, le=85.0)
    ] = 60.0
    clauses: Annotated[
        tuple[str, ...], Option("--clauses", metavar="IDS", separator=",", help="such as 2a,5.2a; default: all")
    ] = ()
    attended: Annotated[
        bool, Option("--attended", help="also test the clauses that need a person at the instrument")
    ] = False
    out: Annotated[Path | None, Option("--out", metavar="PAGE", help="write the result as one HTML page")] = None


class _Person:
    """The person at the device, who is instructed by the control."""

    def __init__(self, control: Control) -> None:
        self._control = control

    def perform(self, act: Act) -> float:
        self._control.notice(Message("conformance.act", "{act}, within {seconds:.0f} s", act=act.value, seconds=_ACT_S))
        return _ACT_S


def run_conformance(
    plan: ConformancePlan,
    control: Control,
    trail: AuditTrail,
    opener: Callable[[str], Link] | None = None,
) -> Conformance:
    """Test the clauses of the protocol on a device; nothing is sent before a person has confirmed what is attached.

    Args:
        plan: device, confirmation and limits.
        control: progress, cancellation, and instructions to a person.
        trail: gets the audit entries.
        opener: opens the port; by default a serial port or socket.

    Raises:
        UnusableInputError: what is attached is not confirmed, a clause is unknown, or the page cannot be written.
        InstrumentError: the port cannot be opened.
        CancelledError: it was cancelled; the coil is released.
    """
    from tissueid.instrument import SerialLink
    from tissueid_lab.conformance.clause import CLAUSES
    from tissueid_lab.conformance.device import Confirmed, DeviceUnderTest
    from tissueid_lab.conformance.exchange import LinkLine, Unattended
    from tissueid_lab.conformance.suite import Conformance, in_order, run_suite

    if plan.attached is None:
        raise UnusableInputError(
            "conformance.unconfirmed",
            "nothing was sent: the test moves the coil. Attach a coil dummy or leave the coil free, no person near "
            "it, and confirm with {option} coil-dummy or {option} free-coil",
            option=Verbatim("--confirm"),
        )
    for identity in plan.clauses:
        if identity not in CLAUSES:
            raise UnusableInputError(
                "conformance.unknown_clause",
                "there is no clause {name}; there are: {known}",
                name=Verbatim(repr(identity)),
                known=Verbatim(", ".join(item.id for item in in_order())),
            )
    check_output(plan.out, HTML)

    def progress(share: float, clause: Clause) -> None:
        done = round(share * (len(plan.clauses) or len(CLAUSES)))
        control.progress(
            share, counted(Message("conformance.step", "Clauses"), done, len(plan.clauses) or len(CLAUSES))
        )

    link = (opener or SerialLink)(plan.device)
    try:
        trail.record("conformance.begun", subject=plan.device, new=plan.attached)
        device = DeviceUnderTest(
            LinkLine(link),
            Confirmed(plan.attached, plan.force_n, plan.temperature_c),
            _Person(control) if plan.attended else Unattended(),
            control.check,
        )
        results = run_suite(device, plan.clauses or None, progress)
    finally:
        link.close()
    body = None if device.handshake is None else device.handshake.device
    conformance = Conformance(
        plan.device,
        "" if body is None else f"{body.model}, {body.serial_number}",
        "" if body is None else body.firmware_version,
        plan.attached,
        plan.force_n,
        results,
    )
    trail.record("conformance.tested", subject=plan.device, new=str(conformance.headline))
    if plan.out is not None:
        from tissueid_lab.conformance.page import conformance_report

        conformance_report(conformance).write(plan.out)
    return conformance
