"""Import and export of sessions of other programs, and recovery of sessions whose host died, from their journals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from tissueid.atomic_write import open_regular
from tissueid.configuration import CONFIGURATIONS
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message, Verbatim
from tissueid.plan_options import Option, Plan
from tissueid.procedures.audit_queries import audit_note, settle
from tissueid.procedures.control import Control
from tissueid.procedures.test_plan import PseudonymConfirmed, check_subject
from tissueid.untrusted_input import RATES_HZ

if TYPE_CHECKING:  # each takes long to import
    from tissueid.audit import AuditTrail
    from tissueid.sessions import Session
    from tissueid.sessions.imports import Choices, ImportedSession


_T = TypeVar("_T")
_EACH = "; once for all tests, or once for each in order"
_DECIMALS = {"point": ".", "comma": ","}


class ImportPlan(Plan):
    """Which records become which session. Options of tests are given once for all tests, or once for each.

    ``mapping`` holds ROLE=COLUMN:UNIT, ``instrument`` KEY=VALUE. A file may be followed by its rows, @FIRST:LAST.
    """

    files: Annotated[
        tuple[Path, ...],
        Option(
            argument=True,
            metavar="FILE[@FIRST:LAST]...",
            help="CSV, MAT or LVM file, one test each; rows from 0, LAST excluded, negative rows count from the end",
        ),
    ]
    out: Annotated[Path, Option("--out", metavar="SESSION", help="new session file; never overwritten")]
    mapping: Annotated[
        tuple[str, ...],
        Option(
            "--map",
            metavar="ROLE=COLUMN:UNIT",
            help="which column is which signal: time, force, position, command, voltage, current, temperature, "
            "or input and output of another system. COLUMN is a name, or a number from 1; "
            "without UNIT, the file must contain it",
        ),
    ] = ()
    rate_hz: Annotated[float | None, Option("--rate", metavar="HZ", help="sample rate of a file without times")] = None
    resample_hz: Annotated[
        float | None, Option("--resample", metavar="HZ", help="interpolate irregular times to this rate")
    ] = None
    decimal: Annotated[
        str | None,
        Option(
            "--decimal",
            metavar="SIGN",
            help="point or comma: the decimal sign of CSV files where it could separate thousands, as in 1,545",
        ),
    ] = None
    kinds: Annotated[
        tuple[str, ...],
        Option("--kind", metavar="KIND", help=f"stochastic, quiet, slow_ramp, step_hold, spring or free_air{_EACH}"),
    ] = ()
    sites: Annotated[
        tuple[str, ...], Option("--site", metavar="TEXT", help=f"site on the body, or material{_EACH}")
    ] = ()
    configurations: Annotated[
        tuple[str, ...], Option("--configuration", metavar="NAME", help=f"indentation, extension or surface{_EACH}")
    ] = ()
    preloads_s: Annotated[
        tuple[float, ...],
        Option("--preload", metavar="SECONDS", help=f"length of the preload at the beginning{_EACH}"),
    ] = ()
    surfaces_m: Annotated[
        tuple[float, ...], Option("--surface", metavar="METRE", help=f"position of the tissue surface{_EACH}")
    ] = ()
    subject: Annotated[str | None, Option("--subject", metavar="PSEUDONYM", help="pseudonym, never a name")] = None
    pseudonym_confirmed: PseudonymConfirmed = False
    instrument: Annotated[
        tuple[str, ...],
        Option(
            "--instrument",
            metavar="KEY=VALUE",
            help="a value of the instrument in SI units, such as moving_mass_kg=0.06",
        ),
    ] = ()

    def choices(self) -> list[Choices]:
        """Return the options of every test.

        Raises:
            UnusableInputError: their number is wrong, or a value is not valid.
        """
        from tissueid.sessions import KINDS
        from tissueid.sessions.imports import Choices

        for given, allowed in (
            (self.kinds, KINDS),
            (self.configurations, tuple(CONFIGURATIONS)),
            ((self.decimal,) if self.decimal is not None else (), tuple(_DECIMALS)),
        ):
            for word in given:
                if word not in allowed:
                    raise UnusableInputError(
                        "import.unknown",
                        "'{word}' is not known: choose one of {known}",
                        word=Verbatim(word),
                        known=Verbatim(", ".join(allowed)),
                    )
        check_subject(self.subject or "", confirmed=self.pseudonym_confirmed)
        for text in (*self.sites, *self.instrument, self.subject or ""):
            if not text.isprintable():
                shown = "".join(mark if mark.isprintable() else "�" for mark in text)
                raise UnusableInputError(
                    "import.not_printable", "'{text}' contains characters that cannot be printed", text=Verbatim(shown)
                )
        for seconds in self.preloads_s:
            if not 0.0 <= seconds < math.inf:
                raise UnusableInputError(
                    "import.preload", "the preload must be 0 s or more, got {seconds:g}", seconds=seconds
                )
        for metres in self.surfaces_m:
            if not math.isfinite(metres):
                raise UnusableInputError(
                    "import.surface", "the surface must be a position in m, got {metres:g}", metres=metres
                )
        rates_hz = {marked("the sample rate"): self.rate_hz, marked("the rate of resampling"): self.resample_hz}
        for what, rate_hz in rates_hz.items():
            if rate_hz is not None and not RATES_HZ[0] <= rate_hz <= RATES_HZ[1]:
                raise UnusableInputError(
                    "import.rate_range",
                    "{what} must be between {least:g} and {most:g} Hz, got {rate:g} Hz",
                    what=what,
                    least=RATES_HZ[0],
                    most=RATES_HZ[1],
                    rate=rate_hz,
                )
        columns = (
            self._each("--kind", self.kinds),
            self._each("--site", self.sites),
            self._each("--configuration", self.configurations),
            self._each("--preload", self.preloads_s),
            self._each("--surface", self.surfaces_m),
        )
        return [Choices(*row) for row in zip(*columns, strict=True)]

    def _each(self, option: str, values: Sequence[_T]) -> list[_T | None]:
        tests = len(self.files)
        if len(values) not in (0, 1, tests):
            raise UnusableInputError(
                "import.count",
                "{option} is given {count} times: give it once, or once for each of the {tests} tests",
                option=Verbatim(option),
                count=len(values),
                tests=tests,
            )
        return [None] * tests if not values else [values[k if len(values) > 1 else 0] for k in range(tests)]


def run_import(plan: ImportPlan, control: Control, trail: AuditTrail) -> ImportedSession:
    """Read and check all files, write the session, and log it.

    Raises:
        UnusableInputError: an option or a file cannot be used.
        SessionExistsError: the session exists.
        CancelledError: it was cancelled; nothing is written.
        OSError: a file cannot be read or written.
    """
    from tissueid.sessions.imports import Source, import_session, instrument_figures, parse_map

    made = import_session(
        [Source.parsed(str(file)) for file in plan.files],
        parse_map(plan.mapping) if plan.mapping else None,
        plan.choices(),
        plan.out,
        figures=instrument_figures(plan.instrument),
        pseudonym=plan.subject,
        rate_hz=plan.rate_hz,
        resample_hz=plan.resample_hz,
        decimal=None if plan.decimal is None else _DECIMALS[plan.decimal],
        progress=control.follow,
    )
    tests = made.session.tests
    new = {"tests": len(tests), "samples": sum(test.samples for test in tests)}
    audit_note(trail, control, "session.imported", subject=made.session.session_id, new=new)
    return made


class ExportPlan(Plan):
    """Which tests of a session are exported into which folder."""

    session: Annotated[Path, Option(argument=True, metavar="SESSION", help="session file")]
    out: Annotated[Path, Option("--out", metavar="DIR", help="new or empty folder")]
    kind: Annotated[str, Option("--format", metavar="NAME", help="csv, mat or parquet")]
    tests: Annotated[
        tuple[int, ...], Option("--test", metavar="N", help="test to export; may be repeated; default: all")
    ] = ()


def run_export(plan: ExportPlan, control: Control, trail: AuditTrail) -> tuple[Session, list[str]]:
    """Write each test of a session and its attributes into a folder, and log it. The folder is complete or not there.

    Returns:
        The exported tests, in their session, and the names of the files: two for each test.

    Raises:
        UnusableInputError: the session, a test, the folder or the format cannot be used.
        CancelledError: it was cancelled; nothing is written.
        OSError: the disk is full or not writable.
    """
    from tissueid.sessions import read_session, read_session_head, read_test
    from tissueid.sessions.imports import export_session

    if plan.tests:
        tests = tuple(read_test(plan.session, number) for number in plan.tests if not control.check())
        session = replace(read_session_head(plan.session), tests=tests)
    else:
        session = read_session(plan.session)

    control.check()
    files = export_session(session, plan.out, plan.kind, lambda share: control.follow(_EXPORTING, share))
    new = {"tests": len(session.tests), "format": plan.kind}
    audit_note(trail, control, "session.exported", subject=session.session_id, new=new)
    return session, files


_EXPORTING = Message("export.step", "exporting")


class RecoveryPlan(Plan):
    """Which session to recover, and where to."""

    path: Annotated[Path, Option(argument=True, metavar="PATH", help="name of the unfinished session, or its journal")]
    out: Annotated[
        Path | None, Option("--out", metavar="SESSION", help="session file to write; default: next to the journal")
    ] = None


@dataclass(frozen=True)
class RecoveredSession:
    """A recovered session, its file, and warnings about damage of the journal."""

    path: Path
    session: Session
    warnings: tuple[str, ...] = ()


def run_recovery(plan: RecoveryPlan, control: Control, trail: AuditTrail) -> RecoveredSession:
    """Make the session of a journal and log it. All warnings are notices too.

    Raises:
        UnusableInputError: there is nothing to recover.
        JournalError: the test still runs.
        OSError: the session cannot be written; the journal stays as it was.
    """
    from tissueid.acquisition.recovery import recover

    warnings: list[str] = []
    path, session = recover(plan.path, plan.out, trail=trail, report=warnings.append)
    settle(trail, control)
    for warning in warnings:
        control.notice(warning)
    return RecoveredSession(path, session, tuple(warnings))


def unfinished_journals(folder: Path) -> list[Path]:
    """Return the journals of unfinished tests in a folder, without those of running tests."""
    from tissueid.acquisition.journal import JournalError, lock

    journals = []
    for path in sorted(folder.glob("*.journal")):
        try:
            with open_regular(path) as file:
                lock(file)
        except (OSError, JournalError):
            continue
        journals.append(path)
    return journals


def recover_folder(
    folder: Path, control: Control, trail: AuditTrail
) -> tuple[list[RecoveredSession], list[TissueIDError | OSError]]:
    """Recover all unfinished sessions of a folder. A journal that fails does not prevent the others.

    Returns:
        The recovered sessions, and the errors of the others.
    """
    recovered: list[RecoveredSession] = []
    errors: list[TissueIDError | OSError] = []
    for journal in unfinished_journals(folder):
        try:
            recovered.append(run_recovery(RecoveryPlan(path=journal), control, trail))
        except (TissueIDError, OSError) as error:
            errors.append(error)
    return recovered, errors
