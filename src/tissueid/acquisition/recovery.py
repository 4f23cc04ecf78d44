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

from tissueid.acquisition.journal import Damage, Entry, JournalError, journal_path, lock, read_entries
from tissueid.audit import Trail
from tissueid.device import DeviceDescription
from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.instrument import SAMPLE, SIGNALS, Run, force
from tissueid.sessions import Session, Subject, Test, read_session, read_session_head, write_session
from tissueid.whole_file import remove_leftovers

MAX_RUN_SAMPLES = 20_000_000

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

    def take(self, payload: bytes, *, keep: bool) -> None:
        """Samples as they were recorded; those outside the run are left out."""
        samples = np.frombuffer(payload, SAMPLE)
        first = self.run.first_index
        inside = samples[(samples["index"] >= first) & (samples["index"] < first + self.run.samples)]
        self.received += inside.size
        if keep:
            self.blocks.append(inside)

    def end(self, status: str, notes: dict[str, str | float], samples: int | None) -> None:
        """It is over, after fewer samples than planned when ``samples`` says so.

        Raises:
            UnusableInputError: more samples than planned, or none.
        """
        self.status, self.notes = status, notes
        if samples is not None:
            if not 0 < samples <= self.run.samples:
                raise UnusableInputError(f"the journal has a test of {self.run.samples} samples that played {samples}")
            self.run = Run(self.run.first_index, samples)

    def close(self, device: DeviceDescription) -> Test | None:
        """The finished test, or None when no sample of it was received."""
        samples = np.concatenate([*self.blocks, np.zeros(0, SAMPLE)])
        place = samples["index"].astype(np.int64) - self.run.first_index
        inside = (place >= 0) & (place < self.run.samples)  # one that ended early has fewer than were planned
        samples, place = samples[inside], place[inside]
        if not samples.size:
            return None
        # A test that ended early is as long as what was received of it; holes inside it stay NaN.
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
        if self.events:
            notes["events"] = json.dumps(self.events)
        return Test(number=self.number, signals=signals, status=self.status, notes=notes, **attributes)


def _open_tests(entries: _Entries, *, keep: bool) -> Iterator[OpenTest]:
    """The tests that entries tell of, each when all of it has come by; their samples only where they are to be kept.

    Raises:
        UnusableInputError: a test that cannot be.
        KeyError, TypeError, ValueError: the entries make no sense.
    """
    test: OpenTest | None = None
    for kind, payload in entries:
        match kind:
            case Entry.TEST:
                value = json.loads(payload)
                if test is not None:
                    if value["number"] == test.number:
                        continue  # the other copy
                    yield test
                run = Run(**value["run"])
                if not 0 < run.samples <= MAX_RUN_SAMPLES:
                    raise UnusableInputError(f"the journal has a test of {run.samples} samples")
                test = OpenTest(value["number"], run, value["attributes"])
            case Entry.SAMPLES if test is not None:
                test.take(payload, keep=keep)
            case Entry.EVENT if test is not None:
                value = json.loads(payload)
                if value.pop("test", test.number) == test.number:  # else the beginning of its own is damaged
                    test.events.append(value)
            case Entry.TEST_END if test is not None:
                value = json.loads(payload)
                if value.get("test", test.number) == test.number:
                    test.end(value["status"], value["notes"], value.get("samples"))
    if test is not None:
        yield test


def _sitting(entries: _Entries) -> tuple[Session, int]:
    """The session that entries tell of, without its tests, and how many tests it will have.

    Raises:
        UnusableInputError: not even the first entry is whole, or the entries make no sense.
    """
    sitting: dict[str, Any] | None = None
    head = ""

    def others() -> Iterator[tuple[Entry, bytes]]:
        nonlocal sitting, head
        for kind, payload in entries:
            if kind is Entry.SITTING:
                sitting = json.loads(payload)
                if sitting["sample_fields"] != [list(item) for item in SAMPLE.descr]:
                    raise UnusableInputError("the journal's samples have a layout this software does not know")
                head = sitting.get("audit_head", "")
            elif kind is Entry.CLOSED:
                head = json.loads(payload).get("audit_head", head)
            else:
                yield kind, payload

    with _sense():
        tests = sum(test.received > 0 for test in _open_tests(others(), keep=False))
        if sitting is None:
            raise _CutOffError("the journal was cut off before anything was recorded")
        session = Session(
            instrument=DeviceDescription(**sitting["device"]),
            subject=Subject(**sitting["subject"]),
            session_id=sitting["session_id"],
            created=sitting["created"],
            audit_head=str(head),
        )
    return session, tests


def _tests(entries: _Entries, device: DeviceDescription) -> Iterator[Test]:
    """The tests that entries tell of, one by one. A test without an end is marked recovered.

    Raises:
        UnusableInputError: the entries make no sense.
    """
    with _sense():
        for item in _open_tests(entries, keep=True):
            if (test := item.close(device)) is not None:
                yield test


@contextlib.contextmanager
def _sense() -> Iterator[None]:
    """Tell whoever made the entries that they make no sense.

    Raises:
        UnusableInputError: they do not.
    """
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise UnusableInputError(f"the journal's entries make no sense: {error}") from error


def session_from_entries(entries: _Entries) -> Session:
    """The session that a journal's entries tell, all of it in memory.

    Raises:
        UnusableInputError: not even the first entry is whole, or the entries make no sense.
    """
    entries = tuple(entries)
    session, _ = _sitting(entries)
    return replace(session, tests=tuple(_tests(entries, session.instrument)))


def session_into(path: Path, journal: Path, samples: int) -> None:
    """Write the session of a journal, one test at a time, when it still holds all that went into it.

    ``samples`` is how many that were.

    Raises:
        JournalError: the journal does not hold them, or is damaged, or makes no sense; it stays as it is.
        SessionFormatError, OSError: it cannot be written; nothing is left behind.
    """
    try:
        session, _ = _sitting(_whole(journal, samples))
        write_session(path, session, tests=_tests(_whole(journal, samples), session.instrument))
    except SessionFormatError:
        raise  # the session could not be written: that says nothing of the journal
    except UnusableInputError as error:
        raise JournalError(
            f"{journal} does not hold what went into it: {error}. It is kept; 'tissueid recover' makes a session of "
            "what can still be read"
        ) from error


def _whole(journal: Path, samples: int) -> Iterator[tuple[Entry, bytes]]:
    """The entries of a journal that must be whole and hold so many samples.

    Raises:
        JournalError: at its end, when it was not so.
    """
    damage, received = Damage(), 0
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
            session, tests = _sitting(read_entries(journal, damage))
        except UnusableInputError as error:
            if damage.places:
                raise UnusableInputError(f"{journal} is damaged, and no session can be made of it: {error}") from error
            if isinstance(error, _CutOffError):
                raise UnusableInputError(f"{error}; delete {journal} if it is in the way") from error
            raise
        if target.exists():
            # The host died between the rename and the removal of the journal.
            if read_session_head(target).session_id != session.session_id:
                raise UnusableInputError(f"{target} is another session; move it away first")
        elif not tests:
            advice = "it is damaged, and" if damage.places else "delete it if it is in the way:"
            raise UnusableInputError(f"{journal} holds no sample of any test; {advice} there is nothing to save")
        else:
            write_session(target, session, tests=_tests(read_entries(journal), session.instrument))
    for session_file in {target, journal.with_name(journal.name.removesuffix(".journal"))}:
        remove_leftovers(session_file)
    recovered = read_session(target)
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
    return (
        f"the journal was damaged at {places}, {damage.bytes} bytes in all: what was recorded there is missing from "
        f"the session, and everything else is in it. The journal is kept as {kept}"
    )
