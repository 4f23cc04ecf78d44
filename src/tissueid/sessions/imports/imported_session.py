"""Assembly of a session from imported tests."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from tissueid.device import DeviceDescription
from tissueid.errors import SessionExistsError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Message
from tissueid.sessions.hdf5_session import write_session
from tissueid.sessions.imports.export_attributes import unknown_device
from tissueid.sessions.imports.imported_test import Choices, Imported, Source, import_test
from tissueid.sessions.model import Session, Subject
from tissueid.untrusted_input import MAX_NUMBERS, MAX_TESTS

_FIGURES = {f.name: isinstance(f.default, float) for f in fields(DeviceDescription) if f.name != "calibration"}
"""Names of the parameters of an instrument, and whether each is a number."""


_READING, _WRITING = marked("reading"), marked("writing")
_RENUMBERED: str = Message(
    "import.renumbered", "the tests have new numbers and are no longer marked as repeats of each other"
)
_MORE_THAN_ONE = {
    "instrument": Message(
        "import.instruments", "the files are exports of several instruments: import them into separate sessions"
    ),
    "subject": Message(
        "import.subjects", "the files are exports of several subjects: import them into separate sessions"
    ),
}


@dataclass(frozen=True)
class ImportedSession:
    """Result of an import: the session as written, its tests with their origin, and notices about the whole."""

    session: Session
    tests: tuple[Imported, ...]
    notices: tuple[str, ...]


def check_new_session(out: Path) -> None:
    """Check that a session can be created at a path.

    Raises:
        SessionExistsError: a file exists there; sessions are never overwritten.
        UnusableInputError: its folder does not exist.
    """
    if out.exists():
        raise SessionExistsError(out)
    if not out.parent.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(out.parent))


def import_session(
    sources: Sequence[Source],
    wanted: dict[str, tuple[str, str]] | None,
    choices: Sequence[Choices],
    out: Path,
    *,
    figures: Mapping[str, str | float] | None = None,
    pseudonym: str | None = None,
    rate_hz: float | None = None,
    resample_hz: float | None = None,
    decimal: str | None = None,
    progress: Callable[[str, float], None] = lambda *_: None,
) -> ImportedSession:
    """Read one test from each source and write them as one session.

    ``wanted`` is column and unit by role (``parse_map``), ``choices`` has one entry for each source. ``progress`` is
    called with the name of the step and its completed share, 0 to 1.

    Raises:
        UnusableInputError: a file, its columns, units or times cannot be used; the message names the file.
        SessionExistsError: ``out`` exists.
        OSError: a file cannot be read or written.
    """
    check_new_session(out)
    tests = []
    for done, (source, choice) in enumerate(zip(sources, choices, strict=True)):
        progress(_READING, done / len(sources))
        tests.append(import_test(source, wanted, choice, rate_hz=rate_hz, resample_hz=resample_hz, decimal=decimal))
    progress(_READING, 1.0)
    session, notices = assembled(tests, dict(figures or {}), pseudonym)
    progress(_WRITING, 0.0)
    write_session(out, session)
    progress(_WRITING, 1.0)
    return ImportedSession(session, tuple(tests), tuple(notices))


def instrument_figures(options: Sequence[str]) -> dict[str, str | float]:
    """Return parameters of the instrument from KEY=VALUE options.

    Raises:
        UnusableInputError: an unknown parameter, or an invalid value.
    """
    figures: dict[str, str | float] = {}
    for option in options:
        key, equals, value = option.partition("=")
        if not equals or key not in _FIGURES:
            raise UnusableInputError(f"--instrument is KEY=VALUE, with a KEY of {', '.join(_FIGURES)}; not {option!r}")
        if key in figures:
            raise UnusableInputError(f"--instrument says {key} twice")
        figures[key] = _positive(key, value) if _FIGURES[key] else value
    return figures


def _positive(key: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not 0.0 <= number < math.inf:
        raise UnusableInputError(f"--instrument {key} is a number, 0 or more, in SI units; not {value!r}")
    return number


def assembled(
    imported: Sequence[Imported], figures: dict[str, str | float], pseudonym: str | None
) -> tuple[Session, list[str]]:
    """Return the session with its tests in the given order, and notices about it as a whole.

    Tests that were exported from one session become that session again; others become tests of a new one, numbered from
    1.

    Raises:
        UnusableInputError: too many tests or samples, or exports of different instruments or subjects.
    """
    if len(imported) > MAX_TESTS:
        raise UnusableInputError(
            "import.too_many_tests", "{count} tests; a session has at most {most}", count=len(imported), most=MAX_TESTS
        )
    total = sum(item.test.samples * (len(item.test.signals) + 1) for item in imported)
    if total > MAX_NUMBERS:
        raise UnusableInputError(
            "import.too_many_numbers",
            "the tests hold {numbers} numbers; a session has at most {most}",
            numbers=total,
            most=MAX_NUMBERS,
        )
    exported = [item.attributes for item in imported if item.attributes is not None]
    for attributes in exported[1:]:
        for part in _MORE_THAN_ONE:
            if repr(getattr(attributes, part)) != repr(getattr(exported[0], part)):  # NaN differs from itself
                raise UnusableInputError(_MORE_THAN_ONE[part])
    if exported:
        device, subject = exported[0].device(), exported[0].subject
    else:
        device, subject = replace(unknown_device(), sample_rate_hz=imported[0].test.sample_rate_hz), Subject()
    session = Session(
        replace(device, **figures),  # type: ignore[arg-type]
        subject if pseudonym is None else replace(subject, pseudonym=pseudonym),
    )
    if dates := [item.created for item in imported if item.created]:
        session = replace(session, created=min(dates))
    numbers = [attributes.test.number for attributes in exported]
    again = len(exported) == len(imported) and len(set(numbers)) == len(numbers)
    if again and all(attributes.session == exported[0].session for attributes in exported):
        origin = vars(exported[0].session)
        session = replace(session, tests=tuple(item.test for item in imported), **origin)
        return session, []
    tests = tuple(replace(item.test, number=k, repeat_of=None) for k, item in enumerate(imported, start=1))
    lost = any(item.test.repeat_of is not None for item in imported)
    notices = [_RENUMBERED] if lost else []
    return replace(session, tests=tests), notices
