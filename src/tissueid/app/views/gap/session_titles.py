"""Titles of sessions in a list: subject, site, date and test."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from tissueid.app.file_stamp import stamp_of
from tissueid.app.views.researcher.labels_of_tests import local_time
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
