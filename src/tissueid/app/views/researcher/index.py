"""Which sessions there are below some folders, and what each says of itself; read by attributes, never by signals."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue

from tissueid.app.views.researcher.chosen import time_of
from tissueid.app.views.researcher.errand import Errand
from tissueid.app.words import in_words
from tissueid.errors import CancelledError, TissueIDError
from tissueid.language import _
from tissueid.sessions import TestOutline, read_outline
from tissueid.sessions.quality import quality_of
from tissueid.wording import clean

ENDINGS = (".h5", ".hdf5")
MOST_FILES = 20_000
_LONGEST = 500
"""Characters that are kept of a text; files come from anywhere."""

VERDICTS = ("", "good", "look", "repeat")
"""From unknown to worst."""

Stamp = tuple[int, int]
"""When a file was last changed, ns, and its size: where both are as they were, it need not be read again."""


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
class Entry:
    """One file in the list. Where it is no session, ``problem`` says why, and the rest is empty.

    ``when`` is in seconds since 1970, NaN where the file does not tell.
    """

    path: Path
    stamp: Stamp
    problem: str = ""
    when: float = math.nan
    pseudonym: str = ""
    tests: tuple[TestEntry, ...] = ()


def entry_of(path: Path, stamp: Stamp) -> Entry:
    """Look into one file; whatever is wrong with it is put down in words."""
    try:
        outline = read_outline(path)
    except TissueIDError as error:
        return Entry(path, stamp, str(error).removeprefix(str(path)).strip(" :").removeprefix("is ")[:_LONGEST])
    except OSError as error:
        return Entry(path, stamp, in_words(error)[:_LONGEST])
    tests = tuple(_test_entry(test) for test in outline.tests)
    head, when = outline.head, time_of(outline.head.created)
    return Entry(path, stamp, "", math.nan if when is None else when, head.subject.pseudonym[:_LONGEST], tests)


def _test_entry(outline: TestOutline) -> TestEntry:
    test = outline.test
    quality = quality_of(test)
    return TestEntry(
        test.number,
        test.site[:_LONGEST],
        clean(test.configuration)[:_LONGEST],
        clean(test.kind)[:_LONGEST].replace("_", " "),
        test.status,
        outline.seconds,
        "" if quality is None else quality.verdict,
    )


class Search(Errand):
    """Looks through folders, and at single files besides. ``found`` gets every entry as soon as it is read.

    What ``known`` has is not read again while its file is as it was. Links are not followed.
    """

    def __init__(self, folders: Sequence[Path], files: Sequence[Path], known: Mapping[Path, Entry]) -> None:
        super().__init__(_("Looking for sessions"))
        self.found: SimpleQueue[Entry] = SimpleQueue()
        self.remarks: list[str] = []
        self._folders = tuple(folders)
        self._files = tuple(files)
        self._known = dict(known)

    def run(self) -> Search:
        """Do it; what was found until it was cancelled is found."""
        try:
            paths = list(dict.fromkeys([*self._listed(), *self._files]))
            for done, path in enumerate(paths):
                self.tell(done / len(paths))
                self.words = _("Reading {count} files").format(count=len(paths))
                self._look_at(path)
        except CancelledError:
            self.remarks.append(_("The search was stopped: the list may lack sessions."))
        return self

    def _look_at(self, path: Path) -> None:
        try:
            now = path.stat()
        except OSError:
            return  # gone since it was listed
        stamp = now.st_mtime_ns, now.st_size
        known = self._known.get(path)
        self.found.put(known if known is not None and known.stamp == stamp else entry_of(path, stamp))

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


__all__ = ["ENDINGS", "MOST_FILES", "VERDICTS", "Entry", "Search", "TestEntry", "entry_of"]
