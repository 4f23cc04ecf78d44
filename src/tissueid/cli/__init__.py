"""The command line. Only ``main`` converts errors to messages and exit statuses."""

from __future__ import annotations

import errno
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from typer.core import TyperGroup
from typer.exceptions import Abort, TyperException
from typer.main import get_group

from tissueid.cli.commands import loaded_app
from tissueid.cli.streams import FLUSH_TIMEOUT_S, unblocked_streams

INTERRUPTED = 130
"""Exit status after an interrupt, as shells define it."""
_RELEASE_S = 2.0
"""Time after an interrupt in which further ones are ignored, so that the coil is released undisturbed."""

_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables set to one thread unless the user has set them.

The linear algebra consists of many small problems. On a busy computer each waits for the slowest thread: all engines on
one test took 126 s with threads and 9 s without.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status: 0 success, 2 unusable input, 1 a defect, 130 interrupted.

    Without ``arguments`` the arguments of the process are used, and its standard streams never block a test.
    """
    if arguments is not None:
        return _run(arguments)
    with unblocked_streams() as output:
        status = _run(None)
        try:
            output.deliver(None if status == 0 else FLUSH_TIMEOUT_S)
        except OSError as error:
            if status == 0 and error.errno not in (errno.EPIPE, errno.EBADF):  # the reader has closed the pipe
                return _fail(f"standard output: {error.strerror}", 2)
        return status


def _run(arguments: Sequence[str] | None) -> int:
    for variable in _ONE_THREAD:  # read when numpy is first imported, which commands do
        os.environ.setdefault(variable, "1")
    try:
        with _termination_as_interrupt(final=arguments is None):
            status = _commands()(
                args=None if arguments is None else list(arguments), prog_name="tissueid", standalone_mode=False
            )
    except (KeyboardInterrupt, Abort):
        status = INTERRUPTED
    except Exception as error:  # noqa: BLE001 - any other error is a defect
        return _failed(error)
    if status == INTERRUPTED:  # Typer converts some interrupts to this status
        return _fail("interrupted; recorded data is kept and no file is incomplete", INTERRUPTED)
    return status if isinstance(status, int) else 0


def _failed(error: Exception) -> int:
    """Print what went wrong and return the exit status; called where the error is handled."""
    from tissueid.errors import CancelledError, TissueIDError  # not at the start, which they would delay
    from tissueid.extras import EXTRAS, missing_package

    if isinstance(error, TissueIDError):
        return _fail(str(error), INTERRUPTED if isinstance(error, CancelledError) else 2)
    if isinstance(error, TyperException):
        return _fail(f"{error.format_message()} (see --help)", 2)
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}", 2)
    package = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if package in EXTRAS:
        return _fail(str(missing_package(package)), 2)
    return _fail(f"internal error; please report the file {_keep_traceback()}", 1)


@cache
def _commands() -> TyperGroup:
    # Typer analyses all signatures at every call, which takes longer than many commands.
    return get_group(loaded_app())


@contextmanager
def _termination_as_interrupt(*, final: bool) -> Iterator[None]:
    """Handle a closed terminal and a request to terminate like Ctrl+C: release the coil and keep the recording.

    Signals within ``_RELEASE_S`` after a handled one are ignored, because they would disturb the release. With
    ``final`` the program ends after this block, and Ctrl+C is ignored after an interrupt.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    handled: float | None = None

    def interrupt(_number: int, _frame: object) -> None:
        nonlocal handled
        now = time.monotonic()
        if handled is None or now - handled > _RELEASE_S:
            handled = now
            raise KeyboardInterrupt

    signals = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # otherwise the parent process ignores Ctrl+C
        signals.append(signal.SIGINT)
    before = {number: signal.signal(number, interrupt) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            over = final and handled is not None and number == signal.SIGINT
            signal.signal(number, signal.SIG_IGN if over else handler)


def _fail(message: str, status: int) -> int:
    line = " ".join(message.split())
    if not line.isprintable():  # names from files and devices must not control the terminal
        from tissueid.formatting import clean

        line = clean(line)
    print(f"tissueid: {line}", file=sys.stderr)
    return status


def _keep_traceback() -> Path:
    """Write the traceback to the log folder and return the file."""
    from platformdirs import user_log_path

    from tissueid.atomic_write import private_folder, write_private

    path = private_folder(user_log_path("tissueid", appauthor=False)) / "last-defect.txt"
    write_private(path, traceback.format_exc())
    return path
