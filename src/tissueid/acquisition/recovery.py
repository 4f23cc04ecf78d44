"""From the entries of a journal to a session: at the end of every sitting, and after a host that died."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.entry_contents import (
    ClosedContent,
    EventContent,
    SittingContent,
    TestContent,
    TestEndContent,
    content_of,
)
from tissueid.acquisition.journal import Damage, Entry, JournalError, journal_path, lock, read_entries
from tissueid.acquisition.quality import QualityGate, quality_of
from tissueid.audit import Trail
from tissueid.device import DeviceDescription
from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.instrument import SAMPLE, SIGNALS, Run, force, not_played, until_released
from tissueid.sessions import (
    MAX_NUMBERS,
    Session,
    Subject,
    Test,
    read_own_session,
    read_session,
    read_session_head,
    write_session,
)
from tissueid.whole_file import remove_leftovers

SPARSE_SAMPLES = 500_000
"""Samples that the tests of a journal may be spread over however few of them are in it: 250 s at 2 kHz."""
SPARSE_SHARE = 0.05
"""Beyond that, the least share that is in it: the memory that recovery takes stays in proportion to the journal."""
MAX_EVENTS_TEXT = 500_000
"""Characters of the events that are kept with a test, half of the longest text that a session may hold."""
_MAX_STRAYS = 16 * 1024 * 1024
"""Bytes of samples after a damage that wait for the repeated beginning of their test; it is repeated every second."""

_Entries = Iterable[tuple[Entry, bytes]]


class _CutOffError(UnusableInputError):
    """The first entry of a journal is not whole: nothing was recorded yet."""


@dataclass
class OpenTest:
    """A test as its entries come by."""

    number: int
    run: Run
    attributes: dict[str, Any]
    status: str = "recovered"
    notes: dict[str, str | float] = field(default_factory=dict)
    blocks: list[NDArray[np.void]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)
    received: int = 0
    reach: int = 0
    """Samples from the beginning to the last one received."""
    ended: bool = False

    def take(self, payload: bytes, *, keep: bool) -> None:
        """Samples as they were recorded; those outside the run are left out."""
        samples = np.frombuffer(payload, SAMPLE)
        first = self.run.first_index
        inside = samples[(samples["index"] >= first) & (samples["index"] < first + self.run.samples)]
        played = inside[~not_played(inside)]
        self.received += played.size
        if played.size:
            self.reach = max(self.reach, int(played["index"].max()) - first + 1)
        if keep:
            self.blocks.append(inside)

    def end(self, status: str, notes: dict[str, str | float], samples: int | None) -> None:
        """It is over, after fewer samples than planned when ``samples`` says so.

        Raises:
            UnusableInputError: more samples than planned, or none.
        """
        if samples is not None:
            if not 0 < samples <= self.run.samples:
                raise UnusableInputError(f"the journal has a test of {self.run.samples} samples that played {samples}")
            self.run = Run(self.run.first_index, samples)
        self.status, self.notes, self.ended = status, notes, True

    @property
    def length(self) -> int:
        """Samples that the finished test has: one that ended early is as long as what was received of it."""
        return self.run.samples if self.status == "completed" else min(self.reach, self.run.samples)

    def close(self, device: DeviceDescription) -> Test | None:
        """The finished test, up to the release of the coil, or None when no sample of it was received."""
        samples = np.concatenate([*self.blocks, np.zeros(0, SAMPLE)])
        place = samples["index"].astype(np.int64) - self.run.first_index
        inside = (place >= 0) & (place < self.run.samples)  # one that ended early has fewer than were planned
        played = until_released(samples[inside])
        after_release = int(np.count_nonzero(not_played(samples[inside][played.size :])))
        samples, place = played, place[inside][: played.size]
        if not samples.size:
            return None
        # A test that ended early is as long as what was received and played of it; holes inside it stay NaN.
        length = self.run.samples if self.status == "completed" else int(place.max()) + 1
        signals = {}
        for name in SIGNALS:
            signals[name] = np.full(length, np.nan)
            signals[name][place] = samples[name]
        signals["force"] = np.full(length, np.nan)
        signals["force"][place] = force(samples, device)
        attributes = dict(self.attributes)
        notes = attributes.pop("notes", {}) | self.notes
        if missing := int(np.isnan(signals["position"]).sum()):
            notes["samples_lost"] = missing
        if after_release:
            notes["samples_after_release"] = float(after_release)
        if self.events:
            notes["events"] = _events_text(self.events)
        return Test(number=self.number, signals=signals, status=self.status, notes=notes, **attributes)


def _events_text(events: list[dict[str, Any]]) -> str:
    """Events as JSON; of a flood of them the first, and how many more there were."""
    kept: list[str] = []
    size = 2
    for event in events:
        size += len(text := json.dumps(event)) + 2
        if size > MAX_EVENTS_TEXT:
            kept.append(json.dumps({"kind": "more", "count": len(events) - len(kept)}))
            break
        kept.append(text)
    return f"[{', '.join(kept)}]"


class _Reading:
    """The tests that the entries of a journal tell of, one by one as they come by.

    What makes no sense is passed over and counted as damage. With ``keep`` the tests have their samples.
    """

    def __init__(self, damage: Damage, *, keep: bool) -> None:
        self._damage = damage
        self._keep = keep
        self._places = damage.places
        self._test: OpenTest | None = None
        self._seen: set[int] = set()
        self._strays: list[bytes] | None = None
        """Samples after a damage, which the repeated beginning of their test may claim; None where there was none."""

    def tests(self, entries: _Entries) -> Iterator[OpenTest]:
        """Each test when all of it has come by."""
        for kind, payload in entries:
            if self._damage.places > self._places:
                self._strays = []
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
        """Take the beginning of a test; returns the one before, when it is another."""
        content = content_of(TestContent, payload, self._damage)
        before = self._test
        if content is not None and before is not None and content.number == before.number:
            self._strays = None
            return None  # the other copy, or a repetition
        self._test = None
        if content is not None and content.number in self._seen:
            self._damage.add(len(payload))
        elif content is not None:
            self._seen.add(content.number)
            run = Run(content.run.first_index, content.run.samples)
            self._test = OpenTest(content.number, run, content.attributes.model_dump(exclude_unset=True))
            if content.again:
                for stray in self._strays or ():
                    self._test.take(stray, keep=self._keep)
        self._strays = None
        return before

    def _take(self, payload: bytes) -> None:
        if len(payload) % SAMPLE.itemsize:
            self._damage.add(len(payload))
            return
        if self._test is not None and not self._test.ended:
            self._test.take(payload, keep=self._keep)
        if self._strays is not None:
            self._strays.append(payload)
            if sum(map(len, self._strays)) > _MAX_STRAYS:
                self._strays = None

    def _end(self, payload: bytes) -> None:
        content = content_of(TestEndContent, payload, self._damage)
        if content is None or self._test is None or content.test not in (None, self._test.number):
            return  # of another one, the beginning of which is damaged
        try:
            self._test.end(content.status, dict(content.notes), content.samples)
        except UnusableInputError:
            self._damage.add(len(payload))


def _open_tests(entries: _Entries, damage: Damage, *, keep: bool) -> Iterator[OpenTest]:
    """The tests of which enough is in the journal to make something of them."""
    length = received = 0
    for test in _Reading(damage, keep=keep).tests(entries):
        received += test.received
        if not test.received:
            continue
        if length + test.length > max(SPARSE_SAMPLES, received / SPARSE_SHARE):
            damage.leave_out(f"test {test.number}: {test.received} of its {test.length} samples are there")
            continue
        length += test.length
        yield test


def _sitting(entries: _Entries, damage: Damage) -> tuple[Session, int]:
    """The session that entries tell of, without its tests, and how many tests it will have.

    Raises:
        UnusableInputError: no beginning of a sitting is whole, or the session would be too large to be read again.
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
        raise _CutOffError("the journal was cut off before anything was recorded")
    if samples * (len(SIGNALS) + 2) > MAX_NUMBERS:
        raise UnusableInputError(f"the journal has {samples} samples: more than a session may hold")
    session = Session(
        instrument=sitting.device,
        subject=Subject(sitting.subject.pseudonym, dict(sitting.subject.demographics)),
        session_id=sitting.session_id,
        created=sitting.created,
        audit_head=head,
    )
    return session, tests


def _tests(entries: _Entries, device: DeviceDescription, damage: Damage) -> Iterator[Test]:
    """The tests that entries tell of, one by one. A test without an end is marked recovered."""
    for item in _open_tests(entries, damage, keep=True):
        if (test := item.close(device)) is not None:
            yield test


def _judged(tests: Iterator[Test], device: DeviceDescription) -> Iterator[Test]:
    """Judge the tests that the host died before it could judge, each against those before it."""
    gate = QualityGate(device)
    for test in tests:
        found = gate.judge(test)
        yield test if quality_of(test) is not None else replace(test, notes=test.notes | found.as_notes())


def session_from_entries(entries: _Entries) -> Session:
    """The session that a journal's entries tell, all of it in memory.

    Raises:
        UnusableInputError: no beginning of a sitting is whole, or the session would be too large.
    """
    entries = tuple(entries)
    session, _ = _sitting(entries, Damage())
    return replace(session, tests=tuple(_tests(entries, session.instrument, Damage())))


def session_into(path: Path, journal: Path, samples: int) -> None:
    """Write the session of a journal, one test at a time, when it still holds all that went into it.

    ``samples`` is how many that were.

    Raises:
        JournalError: the journal does not hold them, or is damaged; it stays as it is.
        SessionFormatError, OSError: it cannot be written; nothing is left behind.
    """
    try:
        damage = Damage()
        damage, again = Damage(), Damage()
        session, _ = _sitting(_whole(journal, samples, damage), damage)
        if damage.left_out:
            raise UnusableInputError("; ".join(damage.left_out[:3]))
        tests = _tests(_whole(journal, samples, again), session.instrument, again)
        write_session(path, session, tests=tests)
    except SessionFormatError:
        raise  # the session could not be written: that says nothing of the journal
    except UnusableInputError as error:
        raise JournalError(
            f"{journal} does not hold what went into it: {error}. It is kept; 'tissueid recover' makes a session of "
            "what can still be read"
        ) from error


def _whole(journal: Path, samples: int, damage: Damage) -> Iterator[tuple[Entry, bytes]]:
    """The entries of a journal that must be whole and hold so many samples.

    Raises:
        JournalError: at its end, when it was not so.
    """
    received = 0
    for kind, payload in read_entries(journal, damage):
        received += len(payload) // SAMPLE.itemsize if kind is Entry.SAMPLES else 0
        yield kind, payload
    # An interrupt may fall between an entry and its being counted: then there are more than were counted.
    if damage.places or received < samples:
        raise JournalError(
            f"{journal} was damaged on its disk: {received} of {samples} samples can be read again. It is kept; "
            "'tissueid recover' makes a session of what can still be read"
        )


def recover(
    path: Path,
    out: Path | None = None,
    *,
    trail: Trail | None = None,
    told: Callable[[str], None] = lambda _: None,
) -> tuple[Path, Session]:
    """Finish what a dead host left. ``path`` is the journal or the session that it belongs to.

    ``out`` is where the session goes when there is no room beside the journal. A log that cannot be written does not
    keep anything from being recovered: see ``trail.problem``. A journal that was damaged before its end is not removed
    but kept under another name, and ``told`` is given a line that says so: what can be read of it is in the session,
    the rest is NaN there.

    Returns the session file and what it holds.

    Raises:
        UnusableInputError: there is nothing to recover, or nothing in it.
        JournalError: the test still runs.
        OSError: the session cannot be written; the journal stays as it was.
    """
    journal = path if path.name.endswith(".journal") else journal_path(path)
    target = out or journal.with_name(journal.name.removesuffix(".journal"))
    if not journal.is_file():
        where = f"{path} has no journal beside it" if path.exists() else f"there is no {journal}"
        raise UnusableInputError(f"nothing to recover: {where}")
    damage = Damage()
    with journal.open("rb") as held:
        lock(held)
        empty = os.fstat(held.fileno()).st_size == 0
    if empty:
        journal.unlink()
        raise UnusableInputError(
            f"{journal} was empty: nothing had been recorded. It is removed, and not in the way any more"
        )
    with journal.open("rb") as held:
        lock(held)
        try:
            session, tests = _sitting(read_entries(journal, damage), damage)
        except UnusableInputError as error:
            if damage.places:
                raise UnusableInputError(f"{journal} is damaged, and no session can be made of it: {error}") from error
            if isinstance(error, _CutOffError):
                raise UnusableInputError(f"{error}; delete {journal} if it is in the way") from error
            raise
        if not (written := not target.exists()):
            # The host died between the rename and the removal of the journal.
            if read_session_head(target).session_id != session.session_id:
                raise UnusableInputError(f"{target} is another session; move it away first")
        elif not tests:
            advice = "it is damaged, and" if damage.places else "delete it if it is in the way:"
            holds = "; ".join(damage.left_out[:3]) or "no sample of any test"
            raise UnusableInputError(f"{journal} holds {holds}; {advice} there is nothing to save")
        else:
            again = Damage()
            tests_again = _judged(_tests(read_entries(journal, again), session.instrument, again), session.instrument)
            write_session(target, session, tests=tests_again)
    for session_file in {target, journal.with_name(journal.name.removesuffix(".journal"))}:
        remove_leftovers(session_file)
    recovered = read_own_session(target) if written else read_session(target)
    if damage.places:
        told(_keep_damaged(journal, damage))
    else:
        with contextlib.suppress(OSError):  # a folder that cannot be written: the session is made, elsewhere
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
    """Keep a journal under a name that nothing else asks for; returns what to say of it."""
    kept = journal.with_name(journal.name + ".damaged")
    number = 1
    while kept.exists():
        number += 1
        kept = journal.with_name(f"{journal.name}.damaged{number}")
    try:
        journal.rename(kept)
    except OSError:
        kept = journal  # a folder that cannot be written: it stays where it is
    places = "1 place" if damage.places == 1 else f"{damage.places} places"
    left_out = "".join(f"; {words}, and it is left out" for words in damage.left_out[:10])
    return (
        f"the journal was damaged at {places}, {damage.bytes} bytes in all: what was recorded there is missing from "
        f"the session, and everything else is in it{left_out}. The journal is kept as {kept}"
    )
