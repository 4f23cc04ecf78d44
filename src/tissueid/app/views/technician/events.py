"""The audit log as far as it is read, and faults and ends of tests from it and from sessions, with advice."""

from __future__ import annotations

import csv
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tissueid.app.words import sentence
from tissueid.atomic_write import atomic_file
from tissueid.audit import LogLine
from tissueid.audit.line import MAX_LINE, read_line
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.formatting import cell_text, clean, grouped, plain_text
from tissueid.instrument.replies import FAULT_TEXTS
from tissueid.language import _, marked
from tissueid.messages import Message, translated
from tissueid.sessions import read_outline
from tissueid.sessions.model import reason_codes

MOST_BYTES = 96 * 1024 * 1024
MOST_LINES = 200_000
_LOOK = 500
_LONGEST_VALUE = 600
COLUMNS = ("number", "time", "role", "who", "what", "subject", "old", "new", "software", "previous", "hash")
"""Of the file for a spreadsheet."""


@dataclass(frozen=True)
class LogPage:
    """The newest lines of a log, newest first. ``remarks`` are what is to be said of the rest."""

    lines: tuple[LogLine, ...] = ()
    remarks: tuple[str, ...] = ()


def read_log(path: Path, cancelled: Callable[[], object], most_bytes: int = MOST_BYTES) -> LogPage:
    """Return the newest lines within a number of bytes. Lines with a wrong hash are counted and left out.

    Raises:
        UnusableInputError: it is no file.
        OSError: it cannot be read.
    """
    if not path.exists():
        return LogPage(
            (), (_("There is no audit log {path}: nothing has been logged yet, or it was moved.").format(path=path),)
        )
    if not path.is_file():
        raise UnusableInputError(
            "audit.not_a_file", "the audit log {path} is not a file: name another with TISSUEID_AUDIT", path=str(path)
        )
    size = path.stat().st_size
    kept: deque[LogLine] = deque(maxlen=MOST_LINES)
    whole = damaged = 0
    with path.open("rb") as file:
        if size > most_bytes:
            file.seek(size - most_bytes)
            file.readline(MAX_LINE)
        while raw := file.readline(MAX_LINE):
            if (whole + damaged) % _LOOK == 0:
                cancelled()
            if (line := read_line(raw.removesuffix(b"\n"))) is None:
                damaged += 1
            else:
                whole += 1
                kept.append(line)
    remarks = []
    if size > most_bytes or whole > MOST_LINES:
        remarks.append(
            _("Only the newest {count} lines are shown; the file holds all of them.").format(count=grouped(len(kept)))
        )
    if damaged:
        single = Message("audit.table.piece", "1 incomplete line is not shown: press Verify for details.")
        several = Message(
            "audit.table.pieces",
            "{count} incomplete lines are not shown: press Verify for details.",
            count=grouped(damaged),
        )
        remarks.append(translated(single if damaged == 1 else several))
    return LogPage(tuple(reversed(kept)), tuple(remarks))


def people_and_sites(lines: Sequence[LogLine]) -> dict[str, str]:
    """Return pseudonyms by session and sites by test, as ``about`` takes them."""
    names = {}
    for line in lines:
        key = {"session.begun": "pseudonym", "test.begun": "site"}.get(str(line.what))
        if key is not None and isinstance(line.new, dict) and isinstance(name := line.new.get(key), str):
            names[str(line.subject)] = name
    return names


def about(line: LogLine, names: Mapping[str, str]) -> str:
    """Return what a line is about: test, site and pseudonym where they are known, else its subject."""
    subject = shown(line.subject)
    if not subject and isinstance(line.new, dict):  # a test whose recording had not begun
        parts = [line.new.get("site"), line.new.get("pseudonym")]
    else:
        session, is_test, number = subject.partition(" test ")
        parts = [names.get(subject) if is_test else None, names.get(session)]
        if is_test and any(parts):
            parts.insert(0, _("Test {number}").format(number=number))
    return clean(", ".join(str(item) for item in parts if item))[:_LONGEST_VALUE] or subject


def shown(value: Any) -> str:
    """An old or new value as one line of a table."""
    if value is None:
        return ""
    text = clean(value[: _LONGEST_VALUE + 1]) if isinstance(value, str) else plain_text(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}…"


def haystack(line: LogLine) -> str:
    """Return the searchable text of a line."""
    parts = (line.time, line.role, line.who, line.what, line.subject, line.old, line.new)
    return " ".join(str(part) for part in parts if part is not None).casefold()


def write_csv(path: Path, log: Path, lines: Sequence[LogLine], cancelled: Callable[[], object]) -> int:
    """Write lines of ``log``, as they are given, for a spreadsheet, whole or not at all; returns their number.

    What a spreadsheet would take for a formula gets an apostrophe before it.

    Raises:
        UnusableInputError: it cannot be written there, or that is the log itself.
    """
    if path.exists() and log.exists() and path.samefile(log):
        raise UnusableInputError(
            "audit.export_itself", "{path} is the audit log itself: name another file", path=str(path)
        )
    if path.is_dir() or not path.parent.is_dir():
        raise UnusableInputError(
            "audit.export_folder", "{path} is no file in an existing folder: name one", path=str(path)
        )
    try:
        with atomic_file(path) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            table = csv.writer(file)
            table.writerow(COLUMNS)
            for number, line in enumerate(lines):
                if number % _LOOK == 0:
                    cancelled()
                fields = asdict(line)
                table.writerow([_cell(fields[name]) for name in COLUMNS])
    except OSError as error:
        raise UnusableInputError(
            "audit.export_failed",
            "cannot write {path}: {problem}",
            path=str(path),
            problem=error.strerror or str(error),
        ) from error
    return len(lines)


def _cell(value: Any) -> str:
    return "" if value is None else cell_text(clean(value) if isinstance(value, str) else plain_text(value))


MOST_FILES = 2000
"""Largest number of sessions that are read, newest first."""
_LONGEST = 400
FAULT, BROKEN, STOPPED, RECOVERED, COMPLETED = (
    marked("Fault"),
    marked("Interrupted"),
    marked("Stopped"),
    marked("Recovered"),
    marked("Completed"),
)
FAILED, UNREADABLE = marked("Calibration failed"), marked("Unreadable file")
KINDS = (FAULT, BROKEN, STOPPED, RECOVERED, FAILED, UNREADABLE, COMPLETED)
LEVELS = {FAULT: "poor", BROKEN: "check", RECOVERED: "check", FAILED: "poor", UNREADABLE: "check"}
"""The level of a colour by kind; what a person stopped and what was completed has none."""

_LOGGED = {
    "test.fault": FAULT,
    "test.aborted": BROKEN,
    "test.stopped": STOPPED,
    "test.completed": COMPLETED,
    "session.broken_off": BROKEN,
    "session.recovered": RECOVERED,
    "calibration.broken_off": BROKEN,
    "calibration.stopped": STOPPED,
}
_ENDS_OF_TESTS = ("test.fault", "test.aborted", "test.stopped")
_BY_A_PERSON = frozenset({"stop.button", "stop.key"})
"""Codes in the reason of a test that was stopped by a person."""
_RELEASED = "instrument.released"
"""Code in the reason of a test that the instrument ended because of a fault."""
_BY_STATUS = {"completed": COMPLETED, "aborted": BROKEN, "recovered": RECOVERED}
_BY_KIND = {
    STOPPED: marked("Nothing to mend: a person stopped it. What was recorded is kept."),
    RECOVERED: marked(
        "The computer or the program died while it ran. What was recorded is kept; find out why it died."
    ),
    FAILED: marked("See its problems under Calibrations, mend them, and calibrate again."),
    UNREADABLE: marked("Fetch a copy of the file from where it was kept, or take it away."),
}
_ADVICE = {text.condition.code: text.remedy for text in FAULT_TEXTS.values()} | {
    "limit.force": marked("Choose a weaker stimulus, and see that nothing pulls at the probe."),
    "limit.position": marked("Place the probe nearer to the middle of its stroke."),
    "instrument.restarted": marked("Check the power supply and its plug; connect again."),
    "link.unusable": marked("Check the cable and the power, and connect again."),
    "link.silent": marked("Check the cable and the power, and connect again."),
    "link.broken": marked("Check the cable, and connect again."),
}
"""What to do by a code in the reason of a test."""


@dataclass(frozen=True)
class Event:
    """``time`` as people read it, UTC; ``subject`` what it was about; ``path`` the session, where there is one."""

    time: str
    kind: str
    subject: str
    reason: str
    advice: str
    path: Path | None = None

    @property
    def level(self) -> str:
        """Level of its colour."""
        return LEVELS.get(self.kind, "")

    @property
    def text(self) -> str:
        """The searchable text."""
        name = self.path.name if self.path else ""
        return f"{self.time} {self.kind} {_(self.kind)} {self.subject} {self.reason} {self.advice} {name}".casefold()


@dataclass(frozen=True)
class Events:
    """Events, newest first. ``remarks`` say what could not be read."""

    entries: tuple[Event, ...]
    remarks: tuple[str, ...] = ()

    @property
    def newest_fault(self) -> Event | None:
        """The end of the newest test if it was a fault, else None."""
        ends = (FAULT, BROKEN, STOPPED, COMPLETED)
        newest = next((event for event in self.entries if event.kind in ends), None)
        return newest if newest is not None and newest.kind == FAULT else None


def read_events(files: list[Path], log: LogPage, cancelled: Callable[[], object]) -> Events:
    """All that the log and the newest of these sessions, newest first, tell; each end once.

    Raises:
        CancelledError: by ``cancelled``.
    """
    by_subject: dict[str, Event] = {}
    names = people_and_sites(log.lines)
    in_calibrations = _of_failed_calibrations(log.lines)
    reported = {str(line.subject).partition(" test ")[0] for line in log.lines if line.what in _ENDS_OF_TESTS}
    for number, line in enumerate(log.lines):
        if number % 1000 == 0:
            cancelled()
        if number in in_calibrations or (line.what == "session.broken_off" and line.subject in reported):
            continue  # its test, or its calibration, says so, and whether it was a person
        if (event := _of_line(line, names)) is not None:
            subject = _short(line.subject)
            by_subject.setdefault(subject if "test " in subject else f"{line.what} {line.number}", event)
    for path in files[:MOST_FILES]:
        cancelled()
        for subject, event in _of_session(path):
            logged = by_subject.get(subject)
            if logged is not None:  # the session has the reason as a message, which is translated
                event = replace(logged, path=path, subject=event.subject, reason=event.reason or logged.reason)
            by_subject[subject] = event
    remarks = [*log.remarks]
    if len(files) > MOST_FILES:
        remarks.append(
            _("Only the newest {most} of {count} sessions were looked through.").format(
                most=MOST_FILES, count=len(files)
            )
        )
    events = sorted(by_subject.values(), key=lambda event: event.time, reverse=True)
    return Events(tuple(events), tuple(remarks))


def _of_failed_calibrations(lines: Sequence[LogLine]) -> set[int]:
    """Return the places of the lines, newest first, that are written by a calibration whose failure has its own line.

    They lie between its end and its beginning.
    """
    inside: set[int] = set()
    calibrated: object = None
    for number, line in enumerate(lines):
        if line.what in ("calibration.broken_off", "calibration.stopped"):
            calibrated = line.subject
        elif line.what == "calibration.begun":
            calibrated = None
        elif calibrated is not None:
            inside.add(number)
    return inside


def _of_line(line: LogLine, names: Mapping[str, str]) -> Event | None:
    what = line.what if isinstance(line.what, str) else ""
    kind = _LOGGED.get(what)
    new = line.new if isinstance(line.new, dict) else {}
    reason = new.get("reason", line.new if isinstance(line.new, str) else "")
    if what == "calibration.made" and new.get("verdict") == "failed":
        kind, reason = (
            FAILED,
            _("{kind} calibration, {file}").format(kind=_(str(new.get("kind", ""))), file=new.get("file", "")),
        )
    if kind is None:
        return None
    subject = about(line, names)
    codes = _texts(new.get("codes"))
    return Event(moment(line.time), kind, subject, _said(reason), advice(kind, str(reason), codes))


def _of_session(path: Path) -> Iterable[tuple[str, Event]]:
    try:
        outline = read_outline(path)
    except (TissueIDError, OSError) as error:
        when = datetime.fromtimestamp(_changed(path), UTC).isoformat()
        reason = _said(translated(_message(error)).replace(f"{path}:", "").replace(str(path), _("The file")))
        yield str(path), Event(moment(when), UNREADABLE, path.name, reason, _(_BY_KIND[UNREADABLE]), path)
        return
    head = outline.head
    for item in outline.tests:
        test = item.test
        reason = test.reason
        kind = _BY_STATUS[test.status]
        codes = reason_codes(reason)
        if kind is BROKEN and _RELEASED in codes:
            kind = FAULT
        elif kind is BROKEN and not _BY_A_PERSON.isdisjoint(codes):
            kind = STOPPED
        site = f", {clean(test.site)[:60]}" if test.site else ""
        who = f", {clean(head.subject.pseudonym)[:60]}" if head.subject.pseudonym else ""
        subject = _("Test {number}{site}").format(number=test.number, site=site) + who
        yield (
            f"{head.session_id} test {test.number}",
            Event(moment(head.created), kind, subject, _said(translated(reason)), advice(kind, reason, codes), path),
        )


def _message(error: TissueIDError | OSError) -> str:
    return error.message if isinstance(error, TissueIDError) else str(error)


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0


def advice(kind: str, reason: str, codes: Collection[str]) -> str:
    """Return the advice for an end of this kind and reason, which has ``codes``; without a known one, its own."""
    if kind in _BY_KIND:
        return _(_BY_KIND[kind])
    if kind == COMPLETED:
        return ""
    for code, message in _ADVICE.items():
        if code in codes:
            return sentence(translated(message))
    _cause, colon, remedy = reason.rpartition(": ")
    usual = _("Measure again; if it happens again, check the instrument.")
    return sentence(clean(remedy)[:_LONGEST]) if colon else usual


def _texts(value: object) -> list[str]:
    """Return the texts of a list from the log; empty if it is no list."""
    return [item for item in value if isinstance(item, str)] if isinstance(value, list) else []


def moment(time: object) -> str:
    """Return a time in UTC to the second; a text that is no time is returned unchanged."""
    text = _short(time)
    try:
        parsed = datetime.fromisoformat(text)
    except ValueError:
        return text[:30]
    aware = parsed if parsed.tzinfo else parsed.replace(tzinfo=UTC)
    try:
        return aware.astimezone(UTC).strftime("%Y-%m-%d %H:%M:%S")
    except (ValueError, OverflowError):
        return text[:30]


def _said(reason: object) -> str:
    return sentence(_short(reason))


def _short(value: object) -> str:
    text = value if isinstance(value, str) else plain_text(value)
    return clean(text[: _LONGEST + 1]) if len(text) <= _LONGEST else f"{clean(text[:_LONGEST])}…"
