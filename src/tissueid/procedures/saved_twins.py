"""Saved twins: list and read them, and accept diagnosed effects into one."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Annotated

from tissueid.audit import AuditTrail
from tissueid.errors import UnusableInputError
from tissueid.gap import executor
from tissueid.gap.twin_export import NamedEffects, accept_named
from tissueid.instrument.twin_file import TwinFile, check_twin_name, check_twin_writable, read_twin, write_twin
from tissueid.plan_options import Option, Plan
from tissueid.procedures.audit_queries import audit_note
from tissueid.procedures.control import Control
from tissueid.procedures.diagnosis import SearchDisplay
from tissueid.procedures.gap_plans import AcceptPlan
from tissueid.procedures.separate_process import run_in_process


class TwinPlan(Plan):
    """A saved twin."""

    file: Annotated[Path, Option(argument=True, metavar="TWIN.toml", help="a saved twin")]


class TwinFolderPlan(Plan):
    """A folder with saved twins."""

    folder: Annotated[Path, Option(argument=True, metavar="DIR", help="folder; default: the current one")] = Path()


def saved_twin(plan: TwinPlan) -> TwinFile:
    """Read a twin.

    Raises:
        UnusableInputError: the file is not a twin.
    """
    from tissueid.instrument.twin_file import read_twin

    return read_twin(plan.file)


def saved_twins(plan: TwinFolderPlan) -> dict[Path, TwinFile]:
    """Read the twins of a folder, by file name; other files are left out.

    Raises:
        UnusableInputError: the folder does not exist.
    """
    from tissueid.instrument.twin_file import read_twin
    from tissueid.instrument.twin_list import SUFFIX

    if not plan.folder.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(plan.folder))
    found = {}
    for path in sorted(plan.folder.glob(f"*{SUFFIX}")):
        try:
            found[path] = read_twin(path)
        except UnusableInputError:
            continue
    return found


def accept_effects(
    plan: AcceptPlan,
    control: Control,
    trail: AuditTrail,
    named: NamedEffects | None = None,
    *,
    separate_process: bool = False,
) -> TwinFile:
    """Save a twin with effects of a session, log it and return its content.

    Args:
        plan: with the chosen effects; none accepts those of ``named``.
        control: progress and cancellation.
        trail: of the audit log.
        named: what a diagnosis names; another choice of effects is fitted to the session. Its baseline twin counts
            instead of that of the plan.
        separate_process: fit in another process.

    Raises:
        UnusableInputError: there is nothing to accept, or the session, the twin, its name or an effect cannot be used.
        CancelledError: it was cancelled; nothing was written.
    """
    check_twin_writable(plan.out)
    baseline = None if named is None else named.baseline
    if named is None and plan.twin is not None:
        baseline = read_twin(plan.twin)
    name = plan.name or (plan.out.stem if baseline is None else baseline.name)
    check_twin_name(name)
    if named is not None and set(plan.effects or named.effects) == set(named.effects):
        content = named.twin_called(name)
    elif not plan.effects:
        raise UnusableInputError("gap.accept_none", "There is nothing to accept: no effect is chosen.")
    else:
        fitted = functools.partial(_fitted, plan, name, baseline)
        content = run_in_process(fitted, control) if separate_process else fitted(control)
    write_twin(plan.out, content)
    new = {"file": plan.out.name, "name": content.name, "version": content.version}
    new |= {"effects": [item.name for item in content.effects]}
    audit_note(trail, control, "twin.accepted", subject=content.source.session_id, new=new)
    return content


def _fitted(plan: AcceptPlan, name: str, baseline: TwinFile | None, control: Control) -> TwinFile:
    display = SearchDisplay(control)
    with executor(plan.workers) as pool:
        return accept_named(
            plan.session, plan.effects, name, baseline, pool, display, plan.fit, plan.check, control.check
        )
