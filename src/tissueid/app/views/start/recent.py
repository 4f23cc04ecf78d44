"""What lies in the folder of sessions: the newest ones in one line each, and tests that were never finished."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from tissueid.app.errands import unfinished
from tissueid.app.language import _, marked
from tissueid.app.words import in_words, sentence
from tissueid.errors import TissueIDError
from tissueid.sessions import Outline, read_outline
from tissueid.sessions.quality import Quality, quality_of
from tissueid.wording import MISSING, clean, local_minute

MOST_SHOWN = 10
LONGEST_TEXT = 80
NOT_JUDGED = marked("Not judged")
_LEVELS = {"good": "good", "look": "check", "repeat": "poor"}
_LONGEST_PROBLEM = 200


@dataclass(frozen=True)
class Recent:
    """One session as the list shows it. ``level`` is that of a colour; ``verdict`` says why where it is no session."""

    path: Path
    date: str
    site: str
    subject: str
    verdict: str
    level: str = ""


@dataclass(frozen=True)
class FolderLook:
    """What was seen of a folder. ``problem`` is why it could not be listed, in words, or empty."""

    sessions: tuple[Recent, ...] = ()
    unfinished: tuple[Path, ...] = ()
    count: int = 0
    problem: str = ""


def look_into(folder: Path, cancelled: threading.Event) -> FolderLook:
    """List the newest sessions of a folder, and its unfinished tests; a folder that is not there yet is empty.

    Files come from anywhere: one that is no session has a line that says so. Ends soon once ``cancelled`` is set.
    """
    try:
        dated = sorted(((path.stat().st_mtime, path) for path in folder.glob("*.h5") if path.is_file()), reverse=True)
        journals = tuple(unfinished(folder))
    except OSError as error:
        return FolderLook(problem=in_words(error))
    sessions: list[Recent] = []
    for changed, path in dated[:MOST_SHOWN]:
        if cancelled.is_set():
            break
        sessions.append(_line(path, changed))
    return FolderLook(tuple(sessions), journals, len(dated))


def _line(path: Path, changed: float) -> Recent:
    date = f"{datetime.fromtimestamp(changed):%Y-%m-%d %H:%M}"
    try:
        outline = read_outline(path)
    except (TissueIDError, OSError) as error:
        words = in_words(error).replace(f"{path}: ", "").replace(f"{path} ", "")
        return Recent(path, date, clean(path.name)[:LONGEST_TEXT], MISSING, _short(sentence(words), _LONGEST_PROBLEM))
    tests = [item.test for item in outline.tests]
    sites = list(dict.fromkeys(clean(test.site).strip() for test in tests if test.site.strip()))
    site = _short(", ".join(sites), LONGEST_TEXT) or _("Site not recorded")
    if len(tests) != 1:
        site = _("{site} ({count} tests)").format(site=site, count=len(tests))
    verdict, level = _verdict(outline)
    return Recent(
        path,
        local_minute(outline.head.created) or date,
        site,
        _short(clean(outline.head.subject.pseudonym).strip(), LONGEST_TEXT) or MISSING,
        verdict,
        level,
    )


def _verdict(outline: Outline) -> tuple[str, str]:
    """What the quality gate said, the worst of it where there are several tests, and the level of its colour."""
    tests = [item.test for item in outline.tests]
    judged = [quality for test in tests if (quality := quality_of(test)) is not None]
    if not tests:
        return _("No tests"), ""
    if not judged:
        return _(NOT_JUDGED), ""
    worst = max(judged, key=_severity)
    return _(worst.headline), _LEVELS[worst.verdict]


def _severity(quality: Quality) -> int:
    return list(_LEVELS).index(quality.verdict)


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"
