"""Run work in a separate process with its own workers. All processes end at once when the work is cancelled."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, TypeVar

from tissueid.child_process import spawn_context

if TYPE_CHECKING:
    from tissueid.gap.workers import Executor

R = TypeVar("R")
Step = Callable[[str, int, int], None]
"""Callback for progress: step, number done, total."""
Work = Callable[[Step, "Executor", Callable[[], bool]], R]

_POLL_S = 0.1
_LEAVING_S = 0.8
_LEAVE = "leave"


def run_in_process(work: Work[R], step: Step, cancelled: Callable[[], bool]) -> R | None:
    """Run picklable work in a new process and return its result; None if it was cancelled.

    A diagnosis in a thread would hold the window up whenever it is between two compiled loops, and could not be ended
    in the midst of a fit.

    Raises:
        RuntimeError: the process ended without a result.
        Exception: whatever the work raised.
    """
    context = spawn_context()
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(work, theirs))
    process.start()
    theirs.close()
    try:
        while not cancelled():
            if not ours.poll(_POLL_S):
                continue
            kind, content = ours.recv()
            if kind == "step":
                step(*content)
            elif kind == "failed":
                raise content
            else:
                return content  # type: ignore[no-any-return]
        return None
    except EOFError:
        raise RuntimeError("the process of a diagnosis ended without a word") from None
    finally:
        with contextlib.suppress(OSError):
            ours.send(_LEAVE)
        process.join(_LEAVING_S)
        if process.is_alive():
            process.kill()
            process.join()
        ours.close()


def _work(work: Work[object], out: Connection) -> None:
    # Runs in the new process.
    left = threading.Event()
    threading.Thread(target=_listen, args=(out, left), daemon=True).start()
    try:
        found = _with_helpers(work, lambda what, done, total: out.send(("step", (what, done, total))), left.is_set)
    except Exception as error:  # noqa: BLE001 - it is raised again on the other side, if anybody is still there
        _say(out, ("failed", error), left)
    else:
        _say(out, ("done", found), left)


def _with_helpers(work: Work[R], step: Step, left: Callable[[], bool]) -> R:
    from tissueid.gap.workers import executor

    with executor() as people:
        return work(step, people, left)


def _say(out: Connection, what: tuple[str, object], left: threading.Event) -> None:
    if not left.is_set():
        with contextlib.suppress(OSError):
            out.send(what)


def _listen(out: Connection, left: threading.Event) -> None:
    # Set when the window cancels or has ended: running fits are abandoned.
    with contextlib.suppress(EOFError, OSError):
        out.recv()
    left.set()
