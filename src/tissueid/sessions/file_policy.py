"""One policy for every reader of a file or a folder of sessions: regular files only, size and signature first.

Nothing here parses a file, so that a pipe, a device, a huge sparse file or a text with the name of a session is refused
at once. Readers of sessions apply it themselves (``hdf5_members.opened``); what lists a folder uses ``session_files``.
"""

from __future__ import annotations

import os
import shlex
import stat
from pathlib import Path

from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.language import marked
from tissueid.messages import Action, Message, code_of
from tissueid.untrusted_input import MAX_FILE_BYTES, UNPACKED_FREE_BYTES, UNPACKED_PER_BYTE

RECORDS = (".csv", ".txt", ".tsv", ".mat", ".lvm")
"""Names of files of other programs that can be imported."""
RECOVER_PLACE = marked("“Recover” on the page Start")
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_BLOCK_BYTES = 512
"""Unit of ``st_blocks``, and the first place after 0 where an HDF5 file may begin; further places double it."""
_LAST_START = 1 << 20
"""Last place where the signature is searched: larger user blocks are not in use."""


def checked_size(path: Path) -> int:
    """Return the size of a file, bytes, after checking that it is a regular file that can be read.

    Raises:
        UnusableInputError: it is missing, not a regular file, empty, too large, or almost all of it is a hole. The
            message does not name the file.
    """
    try:
        status = path.stat()
    except FileNotFoundError:
        raise UnusableInputError("file.no_such", "no such file") from None
    except (OSError, ValueError) as error:  # a name that is too long, or holds a null character
        raise UnusableInputError(unreadable(error)) from error
    if stat.S_ISDIR(status.st_mode):
        raise UnusableInputError("file.folder", "is a folder; name a file")
    if not stat.S_ISREG(status.st_mode):
        raise UnusableInputError("file.not_plain", "is not an ordinary file")
    size = status.st_size
    if size == 0:
        raise UnusableInputError("file.empty", "is empty")
    if size > MAX_FILE_BYTES:
        raise UnusableInputError(
            "file.too_large", "has {size} bytes; at most {most} are read", size=size, most=MAX_FILE_BYTES
        )
    stored = getattr(status, "st_blocks", 0) * _BLOCK_BYTES  # 0 where the file system does not count them
    if stored and size > max(UNPACKED_FREE_BYTES, UNPACKED_PER_BYTE * stored):
        raise UnusableInputError(
            "file.sparse", "has {size} bytes of which only {stored} are stored", size=size, stored=stored
        )
    return size


def check_session_file(path: Path) -> int:
    """Return the size of a file, bytes, after checking ``checked_size`` and the signature of HDF5.

    Raises:
        SessionFormatError: the file is not one, or cannot be read; the message begins with the path.
    """
    try:
        size = checked_size(path)
        with path.open("rb") as file:
            offset = 0
            while file.read(len(_SIGNATURE)) != _SIGNATURE:
                offset = offset * 2 or _BLOCK_BYTES
                if offset > min(size, _LAST_START):
                    raise SessionFormatError(damaged(path))
                file.seek(offset)
    except SessionFormatError:
        raise
    except UnusableInputError as error:
        if error.code == "file.no_such":
            raise SessionFormatError(missing(path)) from error
        if error.code in ("file.folder", "file.empty"):
            raise SessionFormatError(damaged(path)) from error
        raise SessionFormatError(located(str(path), error.message)) from error
    except OSError as error:
        raise SessionFormatError(located(str(path), unreadable(error))) from error
    return size


def session_files(folder: Path, *, recursive: bool = False) -> dict[Path, Message | None]:
    """Return the files of a folder that end in .h5, sorted, each with the reason to refuse it, or None.

    Nothing but regular files passes (``check_session_file``). Folders are left out whatever their name. Links to files
    are followed, links to folders are not. ``recursive`` includes the subfolders.

    Raises:
        UnusableInputError: the folder is missing, or cannot be read.
    """
    if not folder.is_dir():
        raise UnusableInputError("file.no_folder", "there is no folder {folder}", folder=str(folder))
    reasons: dict[Path, Message | None] = {}
    try:
        names = sorted(folder.rglob("*") if recursive else folder.iterdir())
    except OSError as error:
        raise UnusableInputError(located(str(folder), unreadable(error))) from error
    for path in names:
        if path.suffix.lower() != ".h5" or path.is_dir():
            continue
        try:
            check_session_file(path)
            reasons[path] = None
        except SessionFormatError as error:
            message = error.message
            assert isinstance(message, Message)
            reasons[path] = message
    return reasons


def unreadable(error: Exception) -> Message:
    """Return the reason for an error of the operating system, without the path."""
    reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else str(error)
    return Message("file.unreadable", "cannot be read: {reason}", reason=reason)


def located(location: str, reason: str) -> Message:
    """Return a message with the location of a reason, and with the code and the values of the reason."""
    values = dict(reason.values) if isinstance(reason, Message) else {}
    return Message(code_of(reason), "{path}: {reason}", **values | {"path": location, "reason": reason})


def missing(path: Path) -> Message:
    """Return the message for a session that is not there."""
    if (action := _recovery(path)) is None:
        return Message("file.missing", "{path}: no such file", path=str(path))
    return Message(
        "session.missing_with_journal",
        "{path}: no such file; its journal exists: {action} makes the session from it",
        path=str(path),
        action=action,
    )


def damaged(path: Path) -> Message:
    """Return the message for a file that is not a session, or no longer one."""
    if path.is_dir():
        return Message("session.folder", "{path} is a folder", path=str(path))
    if path.suffix.lower() in RECORDS:
        return Message(
            "session.record",
            "{path} is no session file: {action} makes one of it",
            path=str(path),
            action=Action("session.import", "tissueid import", marked("“Import records”")),
        )
    if (action := _recovery(path)) is None:
        return Message("session.damaged", "{path} is damaged, or not an HDF5 session", path=str(path))
    return Message(
        "session.damaged_with_journal",
        "{path} is damaged, or not an HDF5 session; its journal exists: move the file away, and {action} makes the "
        "session from it",
        path=str(path),
        action=action,
    )


def _recovery(path: Path) -> Action | None:
    """Return the action that makes the session from its journal; None without a journal."""
    journal = journal_path(path)
    if not journal.is_file():
        return None
    return Action("session.recover", f"tissueid recover {shlex.quote(str(journal))}", RECOVER_PLACE)


def journal_path(session: Path) -> Path:
    """Return the path of the journal of a session, in the same folder."""
    return session.with_name(session.name + ".journal")
