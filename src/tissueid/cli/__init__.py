"""The command line. ``main`` is the only place where errors become words and exit statuses."""

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

from platformdirs import user_log_path
from typer.core import TyperGroup
from typer.exceptions import Abort, TyperException
from typer.main import get_group

from tissueid.cli.commands import app
from tissueid.cli.streams import PATIENCE_S, unblocked_streams
from tissueid.errors import CancelledError, TissueIDError
from tissueid.whole_file import private_folder, write_private

INTERRUPTED = 130
_LETTING_GO_S = 2.0

_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Linear algebra here is many small problems. Spread over threads that other programs hold up, each waits for the
slowest: all engines on one test then took 126 s in place of 9. Whoever sets these variables keeps what was set."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit status: 0 done, 2 unusable input, 1 a defect, 130 interrupted.

    Without ``arguments`` it is the program itself, whose standard streams then never hold up a test.
    """
    if arguments is not None:
        return _run(arguments)
    with unblocked_streams() as output:
        status = _run(None)
        try:
            output.deliver(None if status == 0 else PATIENCE_S)
        except OSError as error:
            if status == 0 and error.errno not in (errno.EPIPE, errno.EBADF):  # a reader who left has seen enough
                return _complain(f"standard output: {error.strerror}", 2)
        return status


def _run(arguments: Sequence[str] | None) -> int:
    for variable in _ONE_THREAD:  # read when numpy is first imported, which commands do
        os.environ.setdefault(variable, "1")
    try:
        with _endings_as_interrupts(to_the_end=arguments is None):
            status = _commands()(
                args=None if arguments is None else list(arguments), prog_name="tissueid", standalone_mode=False
            )
    except CancelledError as error:
        return _complain(str(error), INTERRUPTED)
    except TissueIDError as error:
        return _complain(str(error), 2)
    except TyperException as error:
        return _complain(f"{error.format_message()} (see --help)", 2)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _complain(f"{where}{error.strerror or error}", 2)
    except (KeyboardInterrupt, Abort):
        status = INTERRUPTED
    except Exception:  # noqa: BLE001 - the last stop before the user
        return _complain(f"this is a defect of the software; please report {_keep_traceback()}", 1)
    if status == INTERRUPTED:  # typer turns some interrupts into this status by itself
        return _complain("interrupted; what was recorded is kept, nothing is left half-written", INTERRUPTED)
    return status if isinstance(status, int) else 0


@cache
def _commands() -> TyperGroup:
    # Typer works the options out of the signatures anew at every call, which takes longer than many a command.
    return get_group(app)


@contextmanager
def _endings_as_interrupts(*, to_the_end: bool) -> Iterator[None]:
    """A closed terminal and a request to end are met like Ctrl+C: the coil is released, the recording kept.

    What comes within two seconds of one that was heeded is not: it would fall into the work of letting go. With
    ``to_the_end`` the program ends after this, and after an interrupt Ctrl+C does nothing any more.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    heeded: float | None = None

    def interrupt(_number: int, _frame: object) -> None:
        nonlocal heeded
        now = time.monotonic()
        if heeded is None or now - heeded > _LETTING_GO_S:
            heeded = now
            raise KeyboardInterrupt

    signals = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else somebody has Ctrl+C ignored
        signals.append(signal.SIGINT)
    before = {number: signal.signal(number, interrupt) for number in signals}
    try:
        yield
    finally:
        for number, handler in before.items():
            over = to_the_end and heeded is not None and number == signal.SIGINT
            signal.signal(number, signal.SIG_IGN if over else handler)


def _complain(message: str, status: int) -> int:
    line = " ".join(message.split())
    if not line.isprintable():  # names from files and devices must not steer a terminal
        from tissueid.wording import clean

        line = clean(line)
    print(f"tissueid: {line}", file=sys.stderr)
    return status


def _keep_traceback() -> Path:
    """Where the details went: users need not see them, whoever mends it does."""
    path = private_folder(user_log_path("tissueid", appauthor=False)) / "last-defect.txt"
    write_private(path, traceback.format_exc())
    return path
