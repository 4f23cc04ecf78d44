"""Creation of a session from a journal: at the end of every sitting, and after a crash of the host."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.journal import (
    RECOVER,
    ClosedContent,
    Damage,
    Entry,
    EventContent,
    JournalError,
    SittingContent,
    TestContent,
    TestEndContent,
    content_of,
    journal_path,
    lock,
    read_entries,
)
from tissueid.acquisition.quality import QualityGate, quality_of
from tissueid.atomic_write import remove_leftovers
from tissueid.audit import AuditTrail
from tissueid.device import DeviceDescription
from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.instrument import SAMPLE, SIGNALS, Run, is_not_played, join_blocks, trim_at_release
from tissueid.instrument.force_profile import force_notes, recorded_force
from tissueid.messages import Listing, Message
from tissueid.sessions import (
    MAX_NUMBERS,
    Session,
    Test,
    read_own_session,
    read_session,
    read_session_head,
    write_session,
)

SPARSE_SAMPLES = 500_000
"""Length in samples (250 s at 2 kHz) up to which tests are recovered regardless of the number of existing samples."""
SPARSE_SHARE = 0.05
"""Minimum share of existing samples of longer tests; it bounds memory in proportion to the journal."""
MAX_EVENTS_TEXT = 500_000
"""Maximum length of the events of a test, characters: half of the longest text in a session."""
_MAX_UNASSIGNED_BYTES = 16 * 1024 * 1024
"""Maximum bytes of samples after a damage that are kept until the header of their test is repeated (once a second)."""

_Entries = Iterable[tuple[Entry, bytes]]


class _CutOffError(UnusableInputError):
    """The first entry of a journal is truncated: nothing was recorded."""


@dataclass
class OpenTest:
    """Test that is being assembled from its entries."""

    head: Test
    """The test without signals, as it began."""
    run: Run
    status: str = "recovered"
    notes: dict[str, str | float] = field(default_factory=dict)
    blocks: list[NDArray[np.void]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    received: int = 0
    received_length: int = 0
    """Number of samples from the beginning to the last received one."""
    ended: bool = False

    @property
    def number(self) -> int:
        """Number of the test."""
        return self.head.number

    def take(self, payload: bytes, *, keep: bool) -> None:
        """Add recorded samples; samples outside the run are ignored."""
        samples = np.frombuffer(payload, SAMPLE)
        first = self.run.first_index
        inside = samples[(samples["index"] >= first) & (samples["index"] < first + self.run.samples)]
        played = inside[~is_not_played(inside)]
        self.received += played.size
        if played.size:
            self.received_length = max(self.received_length, int(played["index"].max()) - first + 1)
        if keep:
            self.blocks.append(inside)

    def end(self, status: str, notes: dict[str, str | float], samples: int | None) -> None:
        """Mark the end of the test, after fewer samples than planned if ``samples`` is given.

        Raises:
            UnusableInputError: more samples than planned, or none.
        """
        if samples is not None:
            if not 0 < samples <= self.run.samples:
                raise UnusableInputError(
                    "recovery.wrong_length",
                    "the journal has a test of {planned} samples that played {played}",
                    planned=self.run.samples,
                    played=samples,
                )
            self.run = Run(self.run.first_index, samples)
        self.status, self.notes, self.ended = status, notes, True

    @property
    def length(self) -> int:
        """Number of samples of the finished test; a test that ended early ends with its last received sample."""
        return self.run.samples if self.status == "completed" else min(self.received_length, self.run.samples)

    def close(self, device: DeviceDescription) -> Test | None:
        """Return the finished test, up to the release of the coil; None if no sample was received."""
        samples = join_blocks(self.blocks)
        index = samples["index"].astype(np.int64) - self.run.first_index
        inside = (index >= 0) & (index < self.run.samples)  # a test that ended early has fewer than planned
        played = trim_at_release(samples[inside])
        after_release = int(np.count_nonzero(is_not_played(samples[inside][played.size :])))
        samples, index = played, index[inside][: played.size]
        if not samples.size:
            return None
        # A test that ended early ends with its last received sample; gaps stay NaN.
        length = self.run.samples if self.status == "completed" else int(index.max()) + 1
        signals = {}
        for name in SIGNALS:
            signals[name] = np.full(length, np.nan)
            signals[name][index] = samples[name]
        signals["force"] = np.full(length, np.nan)
        signals["force"][index] = recorded_force(samples, device)
        notes = force_notes(device) | self.head.notes | self.notes
        if missing := int(np.isnan(signals["position"]).sum()):
            notes["samples_lost"] = missing
        if after_release:
            notes["samples_after_release"] = float(after_release)
        if self.events:
            notes["events"] = _events_text(self.events)
        return replace(self.head, signals=signals, status=self.status, notes=notes)


def _events_text(events: list[dict[str, Any]]) -> str:
    """Return events as JSON; beyond the limit, only the number of the remaining ones."""
    kept: list[str] = []
    size = 2
    for event in events:
        size += len(text := json.dumps(event)) + 2
        if size > MAX_EVENTS_TEXT:
            kept.append(json.dumps({"kind": "more", "count": len(events) - len(kept)}))
            break
        kept.append(text)
    return f"[{', '.join(kept)}]"


class _TestReader:
    """Assembles the tests of a journal one by one from its entries.

    Invalid entries are skipped and counted as damage. With ``keep`` the tests include their samples.
    """

    def __init__(self, damage: Damage, *, keep: bool) -> None:
        self._damage = damage
        self._keep = keep
        self._places = damage.places
        self._test: OpenTest | None = None
        self._seen: set[int] = set()
        self._unassigned: list[bytes] | None = None
        """Samples after a damage that may belong to a test whose repeated head follows; None without a damage."""

    def tests(self, entries: _Entries) -> Iterator[OpenTest]:
        """Yield each test after its last entry."""
        for kind, payload in entries:
            if self._damage.places > self._places:
                self._unassigned = []
            if kind is Entry.TEST:
                if (finished := self._begin(payload)) is not None:
                    yield finished
            elif kind is Entry.SAMPLES:
                self._take(payload)
            elif kind is Entry.EVENT:
                event = content_of(EventContent, payload, self._damage)
                if event is not None and self._test is not None and event.test in (None, self._test.number):
                    self._test.events.append(event.as_note())
            elif kind is Entry.TEST_END:
                self._end(payload)
            self._places = self._damage.places
        if self._test is not None:
            yield self._test

    def _begin(self, payload: bytes) -> OpenTest | None:
        """Begin a test; return the previous test if this is a different one."""
        content = content_of(TestContent, payload, self._damage)
        before = self._test
        if content is not None and before is not None and content.number == before.number:
            self._unassigned = None
            return None  # a copy or a repetition
        self._test = None
        if content is not None and content.number in self._seen:
            self._damage.add(len(payload))
        elif content is not None:
            self._seen.add(content.number)
            run = Run(content.run.first_index, content.run.samples)
            self._test = OpenTest(content.test, run)
            if content.again:
                for stray in self._unassigned or ():
                    self._test.take(stray, keep=self._keep)
        self._unassigned = None
        return before

    def _take(self, payload: bytes) -> None:
        if len(payload) % SAMPLE.itemsize:
            self._damage.add(len(payload))
            return
        if self._test is not None and not self._test.ended:
            self._test.take(payload, keep=self._keep)
        if self._unassigned is not None:
            self._unassigned.append(payload)
            if sum(map(len, self._unassigned)) > _MAX_UNASSIGNED_BYTES:
                self._unassigned = None

    def _end(self, payload: bytes) -> None:
        content = content_of(TestEndContent, payload, self._damage)
        if content is None or self._test is None or content.test not in (None, self._test.number):
            return  # the end of another test, whose header is damaged
        try:
            self._test.end(content.status, dict(content.notes), content.samples)
        except UnusableInputError:
            self._damage.add(len(payload))


def _open_tests(entries: _Entries, damage: Damage, *, keep: bool) -> Iterator[OpenTest]:
    """Yield the tests with enough samples."""
    length = received = 0
    for test in _TestReader(damage, keep=keep).tests(entries):
        received += test.received
        if not test.received:
            continue
        if length + test.length > max(SPARSE_SAMPLES, received / SPARSE_SHARE):
            damage.leave_out(
                Message(
                    "recovery.sparse",
                    "test {number} has only {received} of its {samples} samples",
                    number=test.number,
                    received=test.received,
                    samples=test.length,
                )
            )
            continue
        length += test.length
        yield test


def _sitting(entries: _Entries, damage: Damage) -> tuple[Session, int]:
    """Return the session of the entries without its tests, and its number of tests.

    Raises:
        UnusableInputError: no header of a sitting is intact, or the session would be too large to be read.
    """
    sitting: SittingContent | None = None
    head = ""

    def others() -> Iterator[tuple[Entry, bytes]]:
        nonlocal sitting, head
        for kind, payload in entries:
            if kind is Entry.SITTING:
                content = content_of(SittingContent, payload, damage)
                if content is not None and sitting is None:
                    sitting, head = content, content.audit_head
            elif kind is Entry.CLOSED:
                closed = content_of(ClosedContent, payload, damage)
                if closed is not None and closed.audit_head is not None:
                    head = closed.audit_head
            else:
                yield kind, payload

    tests = samples = 0
    for test in _open_tests(others(), damage, keep=False):
        tests += 1
        samples += test.length
    if sitting is None:
        raise _CutOffError("recovery.cut_off", "the journal ends before anything was recorded")
    if samples * (len(SIGNALS) + 2) > MAX_NUMBERS:
        raise UnusableInputError(
            "recovery.too_large", "the journal has {samples} samples: too many for a session", samples=samples
        )
    session = Session(
        instrument=sitting.device,
        subject=sitting.subject,
        session_id=sitting.session_id,
        created=sitting.created,
        audit_head=head,
    )
    return session, tests


def _tests(entries: _Entries, device: DeviceDescription, damage: Damage) -> Iterator[Test]:
    """Yield the tests of the entries. A test without an end entry is marked recovered."""
    for item in _open_tests(entries, damage, keep=True):
        if (test := item.close(device)) is not None:
            yield test


def _with_quality(tests: Iterator[Test], device: DeviceDescription) -> Iterator[Test]:
    """Judge the tests that were not judged before the crash, each against those before it."""
    gate = QualityGate(device)
    for test in tests:
        quality = gate.judge(test)
        yield test if quality_of(test) is not None else replace(test, notes=test.notes | quality.as_notes())


def session_from_entries(entries: _Entries) -> Session:
    """Return the session of the entries of a journal, in memory.

    Raises:
        UnusableInputError: no header of a sitting is intact, or the session would be too large.
    """
    entries = tuple(entries)
    session, _ = _sitting(entries, Damage())
    return replace(session, tests=tuple(_tests(entries, session.instrument, Damage())))


def write_journal_session(path: Path, journal: Path, samples: int) -> None:
    """Write the session of a journal that must contain all ``samples`` recorded samples, one test at a time.

    Raises:
        JournalError: the journal is incomplete or damaged; it is kept unchanged.
        SessionFormatError, OSError: the session cannot be written; no file is left.
    """
    try:
        damage, again = Damage(), Damage()
        session, _ = _sitting(_complete_entries(journal, samples, damage), damage)
        if damage.left_out:
            raise UnusableInputError(_shortened(damage.left_out))
        tests = _tests(_complete_entries(journal, samples, again), session.instrument, again)
        write_session(path, session, tests=tests)
    except SessionFormatError:
        raise  # the session could not be written; the journal is intact
    except UnusableInputError as error:
        raise JournalError(
            "recovery.incomplete",
            "{path} is incomplete: {reason}. It is kept; {action} makes a session of what can be read",
            path=str(journal),
            reason=error.message,
            action=RECOVER,
        ) from error


def _shortened(left_out: Sequence[str]) -> Message:
    return Message("recovery.left_out", "{tests}", tests=Listing(tuple(left_out[:3]), "; ", "; "))


def _complete_entries(journal: Path, samples: int, damage: Damage) -> Iterator[tuple[Entry, bytes]]:
    """Yield the entries of a journal that must be intact and contain ``samples`` samples.

    Raises:
        JournalError: after the last entry, if it is not complete.
    """
    received = 0
    for kind, payload in read_entries(journal, damage):
        received += len(payload) // SAMPLE.itemsize if kind is Entry.SAMPLES else 0
        yield kind, payload
    # An interrupt between writing and counting an entry can leave more samples than counted.
    if damage.places or received < samples:
        raise JournalError(
            "recovery.damaged",
            "{path} was damaged on the disk: {received} of {samples} samples can be read. It is kept; {action} "
            "makes a session of what can be read",
            path=str(journal),
            received=received,
            samples=samples,
            action=RECOVER,
        )


def recover(
    path: Path,
    out: Path | None = None,
    *,
    trail: AuditTrail | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> tuple[Path, Session]:
    """Create the session of an unfinished journal. ``path`` is the journal or the session that it belongs to.

    ``out`` is the session file, if it cannot be written next to the journal. A failing audit log does not prevent the
    recovery: see ``trail.problem``. A damaged journal is kept under another name, and ``report`` receives a message
    about it; samples that cannot be read are NaN in the session.

    Returns:
        The session file and the session.

    Raises:
        UnusableInputError: there is nothing to recover.
        JournalError: the test is still running.
        OSError: the session cannot be written; the journal is kept unchanged.
    """
    journal = path if path.name.endswith(".journal") else journal_path(path)
    target = out or journal.with_name(journal.name.removesuffix(".journal"))
    if not journal.is_file():
        if path.exists():
            raise UnusableInputError("recovery.no_journal", "nothing to recover: {path} has no journal", path=str(path))
        raise UnusableInputError("recovery.no_file", "nothing to recover: there is no {path}", path=str(journal))
    damage = Damage()
    with journal.open("rb") as held:
        lock(held)
        empty = os.fstat(held.fileno()).st_size == 0
    if empty:
        journal.unlink()
        raise UnusableInputError(
            "recovery.empty", "{path} was empty: nothing had been recorded. It has been removed", path=str(journal)
        )
    with journal.open("rb") as held:
        lock(held)
        try:
            session, tests = _sitting(read_entries(journal, damage), damage)
        except UnusableInputError as error:
            if damage.places:
                raise UnusableInputError(
                    "recovery.unreadable",
                    "{path} is damaged, and no session can be made from it: {reason}",
                    path=str(journal),
                    reason=error.message,
                ) from error
            if isinstance(error, _CutOffError):
                raise UnusableInputError(
                    "recovery.delete", "{reason}; delete {path}", reason=error.message, path=str(journal)
                ) from error
            raise
        if not (written := not target.exists()):
            # The host crashed between the rename and the removal of the journal.
            if read_session_head(target).session_id != session.session_id:
                raise UnusableInputError(
                    "recovery.other_session", "{path} is another session; move it away first", path=str(target)
                )
        elif not tests:
            if damage.left_out:
                message = Message(
                    "recovery.too_few",
                    "{path} is damaged, and there is nothing to save: {tests}",
                    path=str(journal),
                    tests=_shortened(damage.left_out),
                )
            elif damage.places:
                message = Message(
                    "recovery.nothing_damaged",
                    "{path} is damaged, and there is nothing to save: it holds no sample of any test",
                    path=str(journal),
                )
            else:
                message = Message(
                    "recovery.nothing",
                    "{path} holds no sample of any test: there is nothing to save; delete it",
                    path=str(journal),
                )
            raise UnusableInputError(message)
        else:
            again = Damage()
            tests_again = _tests(read_entries(journal, again), session.instrument, again)
            write_session(target, session, tests=_with_quality(tests_again, session.instrument))
    for session_file in {target, journal.with_name(journal.name.removesuffix(".journal"))}:
        remove_leftovers(session_file)
    recovered = read_own_session(target) if written else read_session(target)
    if damage.places:
        report(_keep_damaged(journal, damage))
    else:
        with contextlib.suppress(OSError):  # a read-only folder: the session was made elsewhere
            journal.unlink()
    if trail is not None:
        samples = sum(test.samples for test in recovered.tests)
        new = {"tests": len(recovered.tests), "samples": samples}
        if damage.places:
            new["damaged_bytes"] = damage.bytes
        trail.note("session.recovered", subject=recovered.session_id, new=new)
        trail.settle()
    return target, recovered


def _keep_damaged(journal: Path, damage: Damage) -> str:
    """Rename a damaged journal, so that it is not offered for recovery again; return a message about the damage."""
    names = (f"{journal.name}.damaged{number}" for number in itertools.count(2))
    places = map(journal.with_name, itertools.chain([f"{journal.name}.damaged"], names))
    kept = next(path for path in places if not path.exists())
    try:
        journal.rename(kept)
    except OSError:
        kept = journal  # a read-only folder
    values = {"places": damage.places, "bytes": damage.bytes, "path": str(kept)}
    if damage.left_out:
        return Message(
            "recovery.damage_left_out",
            "the journal was damaged ({places} places, {bytes} bytes); the session has everything else, without: "
            "{tests}. The journal is kept as {path}",
            **values,
            tests=Listing(tuple(damage.left_out[:10]), "; ", "; "),
        )
    return Message(
        "recovery.damage",
        "the journal was damaged ({places} places, {bytes} bytes); the session has everything else. The journal is "
        "kept as {path}",
        **values,
    )
