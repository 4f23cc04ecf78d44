"""Files that a procedure writes: checked before any work, so that nothing else is overwritten."""

from __future__ import annotations

import errno
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissueid.atomic_write import atomic_file, check_creatable, open_regular, private_folder
from tissueid.errors import UnusableInputError
from tissueid.stored_values import finite
from tissueid.untrusted_input import json_value

if TYPE_CHECKING:
    from tissueid.reports.comparison_page import ComparisonReport
    from tissueid.reports.overlay_page import OverlayReport
    from tissueid.sessions import Session


HTML = ("<!DOCTYPE html",)
"""First characters of the pages that may be overwritten."""
PDF = ("%PDF",)
_LARGEST_REPORT = 200_000_000
"""Number of bytes of a report that are searched for the id of its session."""
_LARGEST_VALUES = 20_000_000


def check_output(target: Path | None, begins: tuple[str | bytes, ...]) -> None:
    """Check that a file can be written and that nothing else is overwritten.

    ``begins`` are the first characters, or bytes, of files that may be overwritten. ``-`` is standard output.

    Raises:
        UnusableInputError: the folder is missing, the target is a folder, or it is a file of another kind.
    """
    if target is None or str(target) == "-":
        return
    if target.is_dir():
        raise UnusableInputError("file.is_folder", "{path} is a folder; name a file", path=str(target))
    if not target.parent.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(target.parent))
    if target.exists():
        with open_regular(target) as file:
            head = file.read(512).lstrip()
        signatures = tuple(text.encode() if isinstance(text, str) else text for text in begins)
        if head and not head.startswith(signatures):
            raise UnusableInputError(
                "file.other_content",
                "{path} already exists and has other content; it is not overwritten",
                path=str(target),
            )


def check_report(target: Path | None, session: Session) -> None:
    """Check that a report does not overwrite the report of another session.

    The report of the same session may be overwritten.

    Raises:
        UnusableInputError: the file is not a report of this session.
    """
    if target is None or not target.is_file() or target.stat().st_size == 0:
        return
    with target.open("rb") as file:
        if session.session_id and session.session_id.encode() in file.read(_LARGEST_REPORT):
            return
    raise UnusableInputError(
        "file.other_report",
        "{path} already exists and is not a report of this session: choose another file name",
        path=str(target),
    )


def check_new(target: Path | None) -> None:
    """Check that the report of a measurement does not overwrite an earlier one.

    Raises:
        UnusableInputError: the file already exists.
    """
    if target is not None and target.is_file() and target.stat().st_size > 0:
        raise UnusableInputError(
            "file.exists", "{path} already exists: choose another file name, or move the file", path=str(target)
        )


def stored_values(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file that this program wrote; an empty one if there is none, or it cannot be used."""
    try:
        with open_regular(path) as file:
            values = json_value(file.read(_LARGEST_VALUES))
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}


def check_different(*targets: Path | None) -> None:
    """Check that no file is named for two outputs.

    Raises:
        UnusableInputError: two outputs have the same file.
    """
    named = [target.resolve() for target in targets if target is not None and str(target) != "-"]
    if twice := [target for number, target in enumerate(named) if target in named[:number]]:
        raise UnusableInputError(
            "file.twice", "{path} is named for two outputs: each needs its own file", path=str(twice[0])
        )


def check_result_folder(out: Path, outputs: tuple[str, ...], values: str, made_by: str) -> None:
    """Make a folder of results, and check that only results of an earlier run are overwritten.

    Args:
        out: the folder.
        outputs: names of the files that are overwritten.
        values: name of the JSON file that states in ``made_by`` what made them.
        made_by: what makes them.

    Raises:
        UnusableInputError: it is a file, cannot be made, or holds other results.
    """
    if out.exists() and not out.is_dir():
        raise UnusableInputError("demo.no_folder", "{path} is not a folder", path=str(out))
    with writing(out):
        private_folder(out)
    if any((out / name).exists() for name in outputs) and stored_values(out / values).get("made_by") != made_by:
        raise UnusableInputError(
            "file.other_results", "{folder} contains other results; choose another folder", folder=str(out)
        )


def json_text(value: Any) -> str:
    """Return a value as the text of a JSON file, with null for numbers that are not finite."""
    return json.dumps(finite(value), indent=2, allow_nan=False) + "\n"


def write_text(target: Path, text: str) -> None:
    """Write a text file atomically; parts of names that are not UTF-8 become ``\\udce9``.

    Raises:
        UnusableInputError: the file cannot be written.
    """
    with writing(target), atomic_file(target) as partial:
        partial.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def write_figures(report: ComparisonReport | OverlayReport, page: Path | None, folder: Path | None) -> tuple[Path, ...]:
    """Write the page and the figures of a report, as far as they are wanted; return the files of the figures.

    Raises:
        UnusableInputError: one cannot be written.
    """
    try:
        if page is not None:
            report.write(page)
        return () if folder is None else report.write_figures(folder)
    except OSError as error:
        raise unwritable(Path(error.filename or page or folder or ""), error) from error


@contextmanager
def writing(target: Path) -> Iterator[None]:
    """Turn an error of the operating system into one of a file that cannot be written.

    Raises:
        UnusableInputError: the file cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise unwritable(target, error) from error


def unwritable(target: Path, error: OSError) -> UnusableInputError:
    """Return the error of a file that cannot be written."""
    return UnusableInputError(
        "file.unwritable", "cannot write {path}: {why}", path=str(target), why=str(error.strerror or error)
    )


_SHOWN = 40
"""Characters of a name that a message repeats."""
_TEMPORARY = 26
"""Characters that a temporary name adds; a journal adds fewer."""


def check_session_path(path: Path, *, taken: bool = False) -> None:
    """Check that a new session, its journal and its temporary file can be created at a path. Nothing is left there.

    ``taken`` is whether the name may be that of a session or journal: another one is chosen then.

    Raises:
        UnusableInputError: it cannot; the message says why.
    """
    from tissueid.acquisition.journal import RECOVER, journal_path

    if not path.name:
        raise UnusableInputError("save_path.empty", "enter the file of the session")
    unwritable = _creation_error(path)
    if unwritable is not None and unwritable.errno == errno.ENAMETOOLONG:
        raise UnusableInputError(
            "save_path.too_long",
            "the name {name}… is too long: a temporary name, which is {more} characters longer, must fit too",
            name=path.name[:_SHOWN],
            more=_TEMPORARY,
        ) from unwritable
    if path.is_dir():
        raise UnusableInputError("save_path.folder", "{path} is a folder; name a session file", path=str(path))
    if not path.parent.is_dir():
        raise UnusableInputError(
            "save_path.no_folder",
            "there is no folder {folder}: make it, or choose another one",
            folder=str(path.parent),
        )
    if path.exists() and not taken:
        raise UnusableInputError(
            "save_path.exists",
            "{path} is there already; files are never overwritten: choose another name",
            path=str(path),
        )
    if journal_path(path).exists() and not taken:
        raise UnusableInputError(
            "save_path.unfinished",
            "an unfinished test is left at {path}: recover it ({action}), or choose another name",
            path=str(path),
            action=RECOVER,
        )
    if unwritable is not None:
        raise UnusableInputError(
            "save_path.not_writable",
            "the folder {folder} cannot be written to ({problem}): choose another one",
            folder=str(path.parent),
            problem=unwritable.strerror or str(unwritable),
        ) from unwritable


def _creation_error(path: Path) -> OSError | None:
    """Return why the temporary file of a session cannot be created; None if it can."""
    try:
        check_creatable(path)
    except OSError as error:
        return error
    return None
