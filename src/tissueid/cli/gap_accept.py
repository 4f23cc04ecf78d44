"""``tissueid gap accept``: save a twin with the effects of a diagnosis or with given effects."""

from __future__ import annotations

import sys
from pathlib import Path

from tissueid.cli.output import at_terminal, check_json, console, console_control, human_output
from tissueid.cli.twin_output import print_twin
from tissueid.errors import CancelledError, UnusableInputError
from tissueid.gap import Diagnosis
from tissueid.gap.accepting import NamedEffects
from tissueid.gap.statement import members_of, percent
from tissueid.procedures.accept_effects import accept_effects
from tissueid.procedures.diagnosis import diagnose_session
from tissueid.procedures.gap_plans import AcceptPlan
from tissueid.procedures.instrument_access import audit_trail
from tissueid.procedures.output_files import check_different


def run_accept(plan: AcceptPlan, json_file: Path | None, *, yes: bool = False) -> None:
    """Save the twin with the effects of a diagnosis, or with those of the plan.

    At a terminal the user is asked which members of a combination to accept, except with ``yes``.

    Raises:
        UnusableInputError: the session, the twin, an effect or an option cannot be used, or there is nothing to accept.
        CancelledError: no member was chosen; nothing was written.
    """
    check_json(json_file)
    check_different(plan.out, json_file)
    trail = audit_trail()
    named: NamedEffects | None = None
    if not plan.effects:
        with console_control() as control:
            diagnosed = diagnose_session(plan.diagnosis, control)
        named = diagnosed.named
        for line in _odds(diagnosed.found):
            human_output(json_file).print(line, markup=False)
        chosen = named.effects if yes else _chosen(named.effects)
        plan = plan.model_copy(update={"effects": chosen})
    with console_control() as control:
        content = accept_effects(plan, control, trail, named)
    print_twin(plan.out, content, json_file)


def _odds(found: Diagnosis) -> list[str]:
    """Return a line for each member of the combination: its probability, and the close rivals with theirs."""
    lines = []
    for number, member in enumerate(members_of(found), 1):
        rivals = ", ".join(f"{name} {percent(share)} %" for name, share in member.rivals)
        share = "unknown" if member.probability != member.probability else f"{percent(member.probability)} %"
        lines.append(f"{number}. {member.effect}: probability {share}{f'; rivals: {rivals}' if rivals else ''}")
    return lines


def _chosen(members: tuple[str, ...]) -> tuple[str, ...]:
    """Ask at the terminal which members of a combination to accept; all of them if there is no terminal.

    Raises:
        UnusableInputError: the answer names something else.
        CancelledError: the input ended.
    """
    if len(members) < 2 or not at_terminal():
        return members
    console.print("Which effects should the twin have? Numbers separated by commas; Enter selects all.")
    line = sys.stdin.readline()
    if not line:
        raise CancelledError("cancelled; nothing was written")
    numbers = line.replace(",", " ").split()
    if not all(number.isdecimal() and 1 <= int(number) <= len(members) for number in numbers):
        raise UnusableInputError(f"choose numbers from 1 to {len(members)}, not {line.strip()!r}; nothing was written")
    wanted = {int(number) for number in numbers} or set(range(1, len(members) + 1))
    return tuple(member for place, member in enumerate(members, 1) if place in wanted)
