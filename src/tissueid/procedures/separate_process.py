"""Run a procedure in a separate process, which ends at once when it is cancelled."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TypeVar

from tissueid.child_process import lower_priority, spawn_context, start_worker
from tissueid.errors import CancelledError
from tissueid.language import current_language, set_language
from tissueid.procedures.control import Control
from tissueid.units import in_force, use

R = TypeVar("R")

_POLL_S = 0.1
_LEAVING_S = 0.8
_LEAVE = "leave"


def run_in_process(work: Callable[[Control], R], control: Control, grace_s: float = 0.0) -> R:
    """Run picklable work in a new process and return its result. Progress, notices and finished parts reach
    ``control``.

    The process has a low priority, so that it does not disturb a measurement. A diagnosis in a thread would block the
    window whenever it is between two compiled loops, and could not be ended in the middle of a fit.

    Args:
        work: gets the control of its process.
        control: of the caller.
        grace_s: how long cancelled work may take to return what it has done so far, s.

    Raises:
        CancelledError: it was cancelled.
        RuntimeError: the process ended without a result.
        Exception: whatever the work raised.
    """
    context = spawn_context()
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(work, current_language(), in_force(), theirs))
    start_worker(process)
    theirs.close()
    try:
        deadline = math.inf
        while time.monotonic() < deadline:
            if control.cancelled() and deadline == math.inf:
                ours.send(_LEAVE)
                deadline = time.monotonic() + grace_s
            if not ours.poll(_POLL_S):
                continue
            kind, content = ours.recv()
            if kind == "progress":
                control.progress(*content)
            elif kind == "notice":
                control.notice(content)
            elif kind == "finished":
                control.finished(content)
            elif kind == "failed":
                raise content
            else:
                return content  # type: ignore[no-any-return]
        raise CancelledError(control.reason)
    except (EOFError, BrokenPipeError):
        raise RuntimeError("the process of a procedure ended without a result") from None
    finally:
        with contextlib.suppress(OSError):
            ours.send(_LEAVE)
        process.join(_LEAVING_S)
        if process.is_alive():
            process.kill()
            process.join()
        ours.close()


class _PipeControl(Control):
    """Control in the new process: what it shows is sent to the other side."""

    def __init__(self, out: Connection) -> None:
        self._out = out
        self.abandoned = threading.Event()

    def progress(self, fraction: float | None, step: str) -> None:
        self.send("progress", (fraction, step))

    def notice(self, message: str) -> None:
        self.send("notice", message)

    def finished(self, part: object) -> None:
        self.send("finished", part)

    def cancelled(self) -> bool:
        return self.abandoned.is_set()

    def send(self, kind: str, content: object) -> None:
        with contextlib.suppress(OSError):
            self._out.send((kind, content))


def _work(work: Callable[[Control], object], language: str, units: str, out: Connection) -> None:
    # Runs in the new process, which starts in English and clinical units.
    lower_priority()
    set_language(language)
    use(units)
    control = _PipeControl(out)
    threading.Thread(target=_listen, args=(out, control.abandoned), daemon=True).start()
    try:
        result = work(control)
    except Exception as error:  # noqa: BLE001 - it is raised again on the other side, if it still waits
        control.send("failed", error)
    else:
        control.send("done", result)


def _listen(out: Connection, abandoned: threading.Event) -> None:
    # Set when the other side cancels or has ended: running fits are abandoned.
    with contextlib.suppress(EOFError, OSError):
        out.recv()
    abandoned.set()
