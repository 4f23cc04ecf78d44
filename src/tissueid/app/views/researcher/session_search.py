"""Search folders for sessions, and read their attributes without the signals."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from tissueid.app.views.researcher.background_work import BackgroundWork
from tissueid.app.views.researcher.selected_test import timestamp_of
from tissueid.app.words import in_words
from tissueid.errors import CancelledError, TissueIDError
from tissueid.formatting import clean
from tissueid.language import _
from tissueid.messages import translated
from tissueid.sessions import TestOutline, read_outline
from tissueid.sessions.quality import verdict_of

ENDINGS = (".h5", ".hdf5")
MOST_FILES = 20_000
_LONGEST = 500
"""Maximum length of a text from a file, characters."""

VERDICTS = ("", "good", "look", "repeat")
"""Quality verdicts from unknown to worst."""

Stamp = tuple[int, int]
"""Modification time (ns) and size of a file; an unchanged file is not read again."""


@dataclass(frozen=True)
class TestEntry:
    """One test of a session in the list. ``verdict`` is one of ``VERDICTS``."""

    __test__ = False

    number: int
    site: str
    configuration: str
    kind: str
    status: str
    seconds: float
    verdict: str


@dataclass(frozen=True)
class SessionEntry:
    """One file in the list. ``problem`` is the reason if it is not a session; the rest is then empty.

    ``when`` is in seconds since 1970, NaN where the file does not tell.
    """

    path: Path
    stamp: Stamp
    problem: str = ""
    when: float = math.nan
    pseudonym: str = ""
    tests: tuple[TestEntry, ...] = ()


def entry_of(path: Path, stamp: Stamp) -> SessionEntry:
    """Read the attributes of a file; an error becomes its ``problem``."""
    try:
        outline = read_outline(path)
    except TissueIDError as error:
        problem = translated(error.message).removeprefix(str(path)).strip(" :").removeprefix("is ")
        return SessionEntry(path, stamp, problem[:_LONGEST])
    except OSError as error:
        return SessionEntry(path, stamp, in_words(error)[:_LONGEST])
    tests = tuple(_test_entry(test) for test in outline.tests)
    head, when = outline.head, timestamp_of(outline.head.created)
    return SessionEntry(path, stamp, "", math.nan if when is None else when, head.subject.pseudonym[:_LONGEST], tests)


def _test_entry(outline: TestOutline) -> TestEntry:
    test = outline.test
    return TestEntry(
        test.number,
        test.site[:_LONGEST],
        clean(test.configuration)[:_LONGEST],
        clean(test.kind)[:_LONGEST].replace("_", " "),
        test.status,
        outline.seconds,
        verdict_of(test) or "",
    )


class SessionSearch(BackgroundWork):
    """Search of folders and single files. ``entries`` receives every entry when it is read.

    What ``previous`` has is not read again while its file is as it was. Links are not followed.
    """

    walk_s = 0.3
    """Longest time of a walk before the files that it has listed are read, s; chosen to be hardly noticed."""

    def __init__(self, folders: Sequence[Path], files: Sequence[Path], previous: Mapping[Path, SessionEntry]) -> None:
        super().__init__(_("Looking for sessions"))
        self.entries: SimpleQueue[SessionEntry] = SimpleQueue()
        self.remarks: list[str] = []
        self._folders = tuple(folders)
        self._files = tuple(files)
        self._previous = dict(previous)

    def run(self) -> SessionSearch:
        """Search; a cancelled search keeps what it has found."""
        try:
            read: set[Path] = set()
            for batch in self._batches():
                fresh = [path for path in dict.fromkeys(batch) if path not in read]
                read.update(fresh)
                self.label = _("Reading {count} files").format(count=len(read))
                for done, path in enumerate(fresh):
                    self.tell(done / len(fresh))
                    self._look_at(path)
        except CancelledError:
            self.remarks.append(_("The search was stopped: the list may lack sessions."))
        return self

    def _batches(self) -> Iterator[list[Path]]:
        """Yield the files to read: those of a large or slow folder piece by piece, while the walk goes on."""
        batch: list[Path] = []
        until = time.monotonic() + self.walk_s
        for path in self._listed():
            batch.append(path)
            if time.monotonic() > until:
                yield batch
                batch, until = [], time.monotonic() + self.walk_s
        yield [*batch, *self._files]

    def _look_at(self, path: Path) -> None:
        try:
            now = path.stat()
        except OSError:
            return  # gone since it was listed
        stamp = now.st_mtime_ns, now.st_size
        entry = self._previous.get(path)
        self.entries.put(entry if entry is not None and entry.stamp == stamp else entry_of(path, stamp))

    def _listed(self) -> Iterator[Path]:
        count = 0
        for folder in self._folders:
            if not folder.is_dir():
                self.remarks.append(_("There is no folder {folder}.").format(folder=folder))
            for root, folders, files in os.walk(folder):
                self.tell(0.0)
                folders[:] = sorted(name for name in folders if not name.startswith("."))
                for name in sorted(files):
                    if not name.lower().endswith(ENDINGS) or name.startswith("."):
                        continue
                    count += 1
                    if count > MOST_FILES:
                        self.remarks.append(
                            _("There are more than {most} files; the others are not listed.").format(most=MOST_FILES)
                        )
                        return
                    yield Path(root, name)
