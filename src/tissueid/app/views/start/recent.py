"""The newest sittings and the unfinished tests of the folder of sessions and of the studies."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from platformdirs import user_log_path
from PySide6.QtCore import QSettings

from tissueid.app.context import AppServices
from tissueid.app.words import in_words, sentence
from tissueid.calibration.status import calibration_folder, user_calibration_folder
from tissueid.errors import TissueIDError, UnusableInputError
from tissueid.formatting import clean, label_and_unit, local_minute, local_time, number, subject_text
from tissueid.language import _, marked
from tissueid.messages import MISSING, Message, translated
from tissueid.procedures.import_export import unfinished_journals
from tissueid.procedures.study_protocol import PROTOCOL_FILE
from tissueid.sessions import Outline, read_outline, read_session_head
from tissueid.sessions.accepted_result import AcceptedResult, is_sitting_key, read_result, result_path, sitting_of
from tissueid.sessions.quality import HEADLINES, Verdict, verdict_of
from tissueid.units import shown_si


def storage_locations(services: AppServices, settings: QSettings) -> list[tuple[str, str]]:
    """Return the label and location of each kind of stored data."""
    try:
        calibrations = str(services.calibrations or calibration_folder() or user_calibration_folder())
    except TissueIDError as error:
        calibrations = in_words(error)
    return [
        (_("Sessions"), str(services.folder)),
        (_("Calibrations"), calibrations),
        (_("Audit log"), str(services.audit.path)),
        (_("Settings of this window"), settings.fileName()),
        (_("Details of defects"), str(user_log_path("tissueid", appauthor=False) / "last-defect.txt")),
    ]


MOST_SHOWN = 30
MOST_READ = 200
"""Files without a date in their name whose heads are read to learn when they were recorded, newest change first."""
MOST_STUDIES = 50
"""Studies whose sittings are listed."""
LONGEST_TEXT = 80
NOT_JUDGED = marked("Not judged")
_LEVELS: dict[Verdict, str] = {"good": "good", "look": "check", "repeat": "poor"}
_LONGEST_PROBLEM = 200
_DATED, _DATED_LENGTH = "%Y-%m-%d_%H-%M-%S", 19
"""How the window names a session, by local time, and how long that is."""


@dataclass(frozen=True)
class Recent:
    """One sitting as the list shows it, or a session that belongs to none.

    ``path`` is the file that is opened: an accepted test, or else the newest that can be used. ``level`` is that of a
    colour; ``verdict`` says why where a file is no session. ``tests`` counts the files of the sitting. ``study`` is the
    name of the folder of its study, and ``accepted`` its accepted result; "" without one.
    """

    path: Path
    date: str
    site: str
    subject: str
    verdict: str
    level: str = ""
    tests: int = 1
    study: str = ""
    accepted: str = ""

    def matches(self, terms: Sequence[str]) -> bool:
        """Return whether each of some words, in lower case, is in the date, site, subject, study or verdict."""
        text = " ".join((self.date, self.site, self.subject, self.study, self.verdict)).casefold()
        return all(word in text for word in terms)


File = tuple[Path, float, int]
"""A file as it was read: path, time of change, and size."""


@dataclass
class KnownFiles:
    """What was read of files, each once: when sessions without a date in their name were recorded, and lines by key."""

    dates: dict[File, float] = field(default_factory=dict)
    lines: dict[File, tuple[str, Recent]] = field(default_factory=dict)


@dataclass(frozen=True)
class FolderLook:
    """The content of a folder. ``problem`` is the error if it could not be listed, else empty."""

    sessions: tuple[Recent, ...] = ()
    unfinished: tuple[Path, ...] = ()
    count: int = 0
    problem: str = ""


def look_into(
    folder: Path,
    cancelled: threading.Event,
    cache: KnownFiles | None = None,
    *,
    studies: Iterable[Path] = (),
    search: str = "",
) -> FolderLook:
    """List the newest sittings of a folder and of studies by the time of their tests, and unfinished tests.

    Studies are those below the folder and the given ones; their sessions lie in folders by subject. A folder that is
    not there yet is empty. Files come from anywhere: one that is no session has a line that says so. Ends soon once
    ``cancelled`` is set. ``cache`` keeps what was read from one look to the next. With ``search`` only sittings that
    have all its words are listed.
    """
    cache = cache or KnownFiles()
    try:
        places = dict.fromkeys(folder.glob("*.h5"), "")
        journals = tuple(unfinished_journals(folder))
    except OSError as error:
        return FolderLook(problem=in_words(error))
    for study in list(dict.fromkeys(path.resolve() for path in [*_studies_below(folder), *studies]))[:MOST_STUDIES]:
        with contextlib.suppress(OSError):
            places |= dict.fromkeys(study.glob("*/*.h5"), study.name)
    files = []
    for path in places:
        with contextlib.suppress(OSError):
            if path.is_file():
                files.append((path, path.stat()))
    dated = _dated(files, cache, cancelled)
    sittings: dict[str, list[Recent]] = {}
    terms = search.casefold().split()
    for recorded, file in dated:
        if cancelled.is_set():
            break
        if file not in cache.lines:
            key, line = _line(file[0], recorded)
            cache.lines[file] = key, replace(line, study=clean(places[file[0]]))
        key, line = cache.lines[file]
        if not line.matches(terms):
            continue
        if key not in sittings and len(sittings) == MOST_SHOWN:
            break
        sittings.setdefault(key, []).append(line)
    return FolderLook(tuple(_joined(key, lines) for key, lines in sittings.items()), journals, len(dated))


def _dated(
    files: Sequence[tuple[Path, os.stat_result]], cache: KnownFiles, cancelled: threading.Event
) -> list[tuple[float, File]]:
    """When each file was recorded, newest first: by its name, by its head, or by its change where neither says so."""
    dated: list[tuple[float, File]] = []
    read = 0
    for path, state in sorted(files, key=lambda item: item[1].st_mtime, reverse=True):
        recorded = _by_name(path.name)
        key = (path, state.st_mtime, state.st_size)
        if recorded is None and key not in cache.dates and read < MOST_READ and not cancelled.is_set():
            read += 1
            cache.dates[key] = _by_head(path) or state.st_mtime
        dated.append((recorded if recorded is not None else cache.dates.get(key, state.st_mtime), key))
    return sorted(dated, reverse=True)


def _studies_below(folder: Path) -> list[Path]:
    try:
        protocols = [path for depth in ("*", "*/*") for path in sorted(folder.glob(f"{depth}/{PROTOCOL_FILE}"))]
    except OSError:
        return []
    return [path.parent for path in protocols]


def _by_name(name: str) -> float | None:
    """Return the time of a recording by a file name of the window, in local time; None for other names."""
    try:
        return datetime.strptime(name[:_DATED_LENGTH], _DATED).timestamp()
    except (ValueError, OverflowError, OSError):
        return None


def _by_head(path: Path) -> float | None:
    try:
        moment = local_time(read_session_head(path).created)
    except (TissueIDError, OSError):
        return None
    return None if moment is None else moment.timestamp()


def _joined(key: str, lines: Sequence[Recent]) -> Recent:
    """The tests of a sitting as one line, with its accepted result where it was finished."""
    newest = lines[0]
    folder = newest.path.parent
    try:
        path = result_path(folder, key)
        result = read_result(path) if is_sitting_key(key) and path.exists() else None
    except (UnusableInputError, OSError):
        result = None  # the page of the sitting says so
    accepted = [] if result is None else [test.file for test in result.tests]
    usable = [line for line in lines if line.level in ("good", "check")]
    counting = [line for line in lines if line.path.name in accepted] or usable or list(lines)
    worst = max(counting, key=lambda line: list(_LEVELS.values()).index(line.level) if line.level else -1)
    site = newest.site
    if len(lines) > 1:
        site = _("{site} ({count} tests)").format(site=site, count=len(lines))
    said = "" if result is None else _said(result)
    shown = replace(newest, path=counting[0].path, site=site, verdict=worst.verdict, level=worst.level)
    return replace(shown, tests=len(lines), accepted=said)


def _said(result: AcceptedResult) -> str:
    """Return the accepted values in one line, in the active units."""
    values = []
    for quantity, value in result.values.items():
        unit, scale = shown_si(label_and_unit(quantity)[1])
        values.append(f"{number(scale * value.mean, 3)} {unit}")
    text = ", ".join(values)
    if result.count == 1:
        return _("accepted {values}").format(values=text)
    return translated(
        Message("start.accepted_mean", "accepted mean of {count}: {values}", count=result.count, values=text)
    )


def _line(path: Path, recorded: float) -> tuple[str, Recent]:
    """The key of the sitting of a session, its path where it has none, and its line."""
    date = f"{datetime.fromtimestamp(recorded):%Y-%m-%d %H:%M}"
    try:
        outline = read_outline(path)
    except (TissueIDError, OSError) as error:
        reason = in_words(error).replace(f"{path}: ", "").replace(f"{path} ", "")
        said = _short(sentence(reason), _LONGEST_PROBLEM)
        return str(path), Recent(path, date, clean(path.name)[:LONGEST_TEXT], MISSING, said)
    tests = [item.test for item in outline.tests]
    sites = list(dict.fromkeys(clean(test.site).strip() for test in tests if test.site.strip()))
    site = _short(", ".join(sites), LONGEST_TEXT) or (
        _("Site not recorded") if _by_name(path.name) is not None else clean(path.name)[:LONGEST_TEXT]
    )
    if len(tests) != 1:
        site = _("{site} ({count} tests)").format(site=site, count=len(tests))
    verdict, level = _verdict(outline)
    key = (sitting_of(tests[0]) if len(tests) == 1 else None) or str(path)
    return key, Recent(
        path,
        local_minute(outline.head.created) or date,
        site,
        _short(subject_text(outline.head.subject.pseudonym), LONGEST_TEXT) or MISSING,
        verdict,
        level,
    )


def _verdict(outline: Outline) -> tuple[str, str]:
    """What the quality gate said, the worst of it where there are several tests, and the level of its colour."""
    tests = [item.test for item in outline.tests]
    judged = [verdict for test in tests if (verdict := verdict_of(test)) is not None]
    if not tests:
        return _("No tests"), ""
    if not judged:
        return _(NOT_JUDGED), ""
    worst = max(judged, key=list(_LEVELS).index)
    return _(HEADLINES[worst]), _LEVELS[worst]


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 1]}…"
