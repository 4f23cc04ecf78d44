"""The recorder: takes a sitting into the journal, and turns journals into session files."""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.acquisition.journal import (
    SYNC_S,
    Entry,
    Journal,
    encode_entry,
    encode_json,
    journal_path,
    lock,
    read_entries,
)
from tissueid.device import DeviceDescription
from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.instrument import SAMPLE, SIGNALS, Run, force
from tissueid.sessions import Session, Subject, Test, read_session, write_session

MAX_RUN_SAMPLES = 20_000_000


class SessionRecorder:
    """One sitting being recorded. ``finish`` leaves a session file; a host that dies leaves the journal.

    Raises:
        SessionFormatError: the session file is there already.
        JournalError: an unfinished one is there, or the folder cannot be written.
    """

    def __init__(
        self, path: Path, device: DeviceDescription, subject: Subject | None = None, *, sync_s: float = SYNC_S
    ) -> None:
        if path.is_dir():
            raise SessionFormatError(f"{path} is a folder; name a session file")
        if path.exists():
            raise SessionFormatError(f"{path} is there already; sessions are never overwritten")
        if not path.parent.is_dir():
            raise SessionFormatError(f"there is no folder {path.parent}")
        self.path = path
        self.tests_begun = 0
        self.samples_appended = 0
        self._sample_entries: list[tuple[int, int]] = []
        self._journal = Journal(journal_path(path), sync_s=sync_s)
        sitting = {
            "session_id": str(uuid.uuid4()),
            "created": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
            "device": asdict(device),
            "subject": asdict(subject or Subject()),
            "sample_fields": [list(item) for item in SAMPLE.descr],
        }
        self._journal.append(encode_json(Entry.SITTING, sitting))

    def begin_test(self, run: Run, **attributes: Any) -> int:
        """A test starts; ``attributes`` are those of ``sessions.Test``. Returns its number."""
        self.tests_begun += 1
        entry = {"number": self.tests_begun, "run": asdict(run), "attributes": attributes}
        self._journal.append(encode_json(Entry.TEST, entry))
        return self.tests_begun

    def add(self, samples: NDArray[np.void]) -> None:
        """Samples of the running test, shape (k,) of instrument.SAMPLE."""
        if samples.size:
            number = self._journal.append(encode_entry(Entry.SAMPLES, samples.tobytes()))
            self.samples_appended += samples.size
            self._sample_entries.append((number, self.samples_appended))

    @property
    def samples_acknowledged(self) -> int:
        """How many samples of this sitting are known to be on the disk."""
        synced = self._journal.synced
        while len(self._sample_entries) > 1 and self._sample_entries[1][0] <= synced:
            self._sample_entries.pop(0)
        if self._sample_entries and self._sample_entries[0][0] <= synced:
            return self._sample_entries[0][1]
        return 0

    def event(self, kind: str, **details: Any) -> None:
        """Something that happened: a gap, a fault, a verdict."""
        self._journal.append(encode_json(Entry.EVENT, {"kind": kind, **details}))

    def end_test(self, status: str, samples: int | None = None, **notes: str | float) -> None:
        """The running test is over: ``status`` completed or aborted.

        ``samples`` is how many were played of a test that was completed before its time; all without it.
        """
        entry: dict[str, Any] = {"status": status, "notes": notes}
        if samples is not None:
            entry["samples"] = samples
        self._journal.append(encode_json(Entry.TEST_END, entry))

    def finish(self) -> Session:
        """Write the session from what the journal holds, verify it, and remove the journal.

        Raises:
            JournalError, OSError: nothing is lost; the journal stays for ``tissueid recover``.
        """
        self._journal.append(encode_json(Entry.CLOSED, {}))
        self._journal.sync()
        self._journal.close()
        session = session_from_entries(read_entries(self._journal.path))
        write_session(self.path, session)
        self._journal.path.unlink()
        return session

    def finish_or_discard(self) -> Session | None:
        """After a failure: keep what was recorded as a session, or leave nothing when there is nothing.

        Where even that fails, the journal stays for ``tissueid recover``.
        """
        if self.samples_appended:
            return self.finish()
        self._journal.close()
        self._journal.path.unlink()
        return None

    def abandon(self) -> None:
        """Close without a session; the journal stays for ``tissueid recover``."""
        self._journal.close()


@dataclass
class _OpenTest:
    """A test as its entries come by."""

    number: int
    run: Run
    attributes: dict[str, Any]
    status: str = "recovered"
    notes: dict[str, str | float] = field(default_factory=dict)
    blocks: list[NDArray[np.void]] = field(default_factory=list)
    events: list[dict[str, Any]] = field(default_factory=list)

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
        inside = (place >= 0) & (place < self.run.samples)
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


def session_from_entries(entries: Iterable[tuple[Entry, bytes]]) -> Session:
    """The session that a journal's entries tell. A test without an end is marked recovered.

    Raises:
        UnusableInputError: not even the first entry is whole, or the entries make no sense.
    """
    sitting: dict[str, Any] | None = None
    tests: list[_OpenTest] = []
    try:
        for kind, payload in entries:
            if kind is Entry.SAMPLES:
                if tests:
                    tests[-1].blocks.append(np.frombuffer(payload, SAMPLE))
                continue
            value = json.loads(payload)
            match kind:
                case Entry.SITTING:
                    if value["sample_fields"] != [list(item) for item in SAMPLE.descr]:
                        raise UnusableInputError("the journal's samples have a layout this software does not know")
                    sitting = value
                case Entry.TEST:
                    run = Run(**value["run"])
                    if not 0 < run.samples <= MAX_RUN_SAMPLES:
                        raise UnusableInputError(f"the journal has a test of {run.samples} samples")
                    tests.append(_OpenTest(value["number"], run, value["attributes"]))
                case Entry.EVENT if tests:
                    tests[-1].events.append(value)
                case Entry.TEST_END if tests:
                    tests[-1].end(value["status"], value["notes"], value.get("samples"))
        if sitting is None:
            raise UnusableInputError("the journal was cut off before anything was recorded")
        device = DeviceDescription(**sitting["device"])
        finished = tuple(test for item in tests if (test := item.close(device)) is not None)
        subject = Subject(**sitting["subject"])
    except (KeyError, TypeError, ValueError) as error:
        raise UnusableInputError(f"the journal's entries make no sense: {error}") from error
    return Session(
        instrument=device,
        subject=subject,
        tests=finished,
        session_id=sitting["session_id"],
        created=sitting["created"],
    )


def recover(path: Path, out: Path | None = None) -> tuple[Path, Session]:
    """Finish what a dead host left. ``path`` is the journal or the session that it belongs to.

    ``out`` is where the session goes when there is no room beside the journal.

    Returns the session file and what it holds.

    Raises:
        UnusableInputError: there is nothing to recover, or nothing in it.
        JournalError: the test still runs.
    """
    journal = path if path.name.endswith(".journal") else journal_path(path)
    target = out or journal.with_name(journal.name.removesuffix(".journal"))
    if not journal.is_file():
        where = f"{path} has no journal beside it" if path.exists() else f"there is no {journal}"
        raise UnusableInputError(f"nothing to recover: {where}")
    with journal.open("rb") as held:
        lock(held)
        session = session_from_entries(read_entries(journal))
        if target.exists():
            # The host died between the rename and the removal of the journal.
            if read_session(target).session_id != session.session_id:
                raise UnusableInputError(f"{target} is another session; move it away first")
        elif not session.tests:
            raise UnusableInputError(f"{journal} holds no sample of any test; delete it if it is in the way")
        else:
            write_session(target, session)
    journal.unlink()
    return target, read_session(target)
