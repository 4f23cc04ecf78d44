"""Load stored diagnoses and the titles of sessions in the background of the Gap page."""

from __future__ import annotations

import functools
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, Signal

from tissueid.app.jobs import Jobs
from tissueid.app.user_files import stamp_of
from tissueid.app.views.gap.diagnosis_store import KeptDiagnoses, read_kept
from tissueid.app.views.researcher.selected_test import local_time
from tissueid.app.views.researcher.session_search import SessionEntry, entry_of
from tissueid.formatting import clean, subject_text
from tissueid.language import _, plural

_LONGEST = 40
"""Maximum length of one part of a title, characters."""


def read_titles(paths: Sequence[Path], cancelled: threading.Event) -> dict[Path, str | None]:
    """Return the titles of sessions that were read before ``cancelled`` was set.

    The title of a file that is no session, or says nothing of itself, is empty; that of a missing file is None.
    """
    found: dict[Path, str | None] = {}
    for path in paths:
        if cancelled.is_set():
            break
        stamp = stamp_of(path)
        found[path] = None if stamp is None else title_of(entry_of(path, stamp))
    return found


def title_of(entry: SessionEntry) -> str:
    """Return subject, site, date and test of a session; "" if the file has none of the first three."""
    sites = dict.fromkeys(clean(test.site).strip() for test in entry.tests)
    known = [subject_text(entry.pseudonym), *sites, local_time(entry.when)]
    parts = [part[:_LONGEST] for part in known if part]
    return ", ".join([*parts, _tests(entry)]) if parts else ""


def unique_titles(titles: Mapping[Path, str]) -> dict[Path, str]:
    """Return the text of each file in the list: its title, with the file name where titles are equal."""
    count = Counter(titles.values())
    named = {}
    for path, title in titles.items():
        name = clean(path.name)
        named[path] = name if not title else f"{title}, {name}" if count[title] > 1 else title
    return named


def _tests(entry: SessionEntry) -> str:
    if len(entry.tests) == 1:
        test = entry.tests[0]
        return _("test {number} ({kind})").format(number=test.number, kind=_(test.kind))
    return plural("{count} test", "{count} tests", len(entry.tests)).format(count=len(entry.tests))


class DiagnosisLoader(QObject):
    """Loader with one job at a time; :meth:`load_next` starts the next one.

    ``kept_read`` carries the kept diagnoses, ``titles_read`` the titles of sessions by their paths; ``failed`` says in
    words why kept diagnoses cannot be read. ``wanted`` is whether they are still to be read.
    """

    kept_read = Signal(object)
    titles_read = Signal(object)
    failed = Signal(str)

    def __init__(self, jobs: Jobs, folder: Path, parent: QObject) -> None:
        super().__init__(parent)
        self._jobs, self._folder = jobs, folder
        self.wanted = True
        self._cancelled = threading.Event()
        self.running = False

    def load_next(self, untitled: Sequence[Path]) -> bool:
        """Read the stored diagnoses once, then missing titles of sessions; return False if nothing remains."""
        if self.running:
            return True
        if self.wanted:
            self.wanted = False
            self._begin(functools.partial(read_kept, self._folder), self._kept_ended)
            return True
        if untitled:
            self._cancelled = threading.Event()
            self._begin(functools.partial(read_titles, tuple(untitled), self._cancelled), self._titles_ended)
            return True
        return False

    def cancel(self) -> None:
        """Request cancellation of the running job."""
        self._cancelled.set()

    def _begin(self, work: Callable[[], Any], ended: Callable[[Any], None]) -> None:
        self.running = True
        self._jobs.do(work, ended, self._broke)

    def _kept_ended(self, kept: KeptDiagnoses) -> None:
        self.running = False
        self.kept_read.emit(kept)

    def _titles_ended(self, titles: dict[Path, str | None]) -> None:
        self.running = False
        self.titles_read.emit(titles)

    def _broke(self, words: str) -> None:
        self.running = False
        self.failed.emit(words)
