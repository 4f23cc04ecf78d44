"""Executors of fits, serial and in parallel processes, with progress and cancellation."""

from __future__ import annotations

import contextlib
import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess, parent_process
from typing import Any, Protocol, TypeVar

from tissueid.child_process import spawn_context, start_worker
from tissueid.errors import CancelledError, UnusableInputError

T = TypeVar("T")
R = TypeVar("R")

POLL_S = 0.2
"""Interval of the check for cancellation, s."""
EXIT_TIMEOUT_S = 2.0
"""Time for all processes together to end on request before they are killed, s."""


class Executor(Protocol):
    """Interface of an executor, which applies one function to many items."""

    def do(
        self, work: Callable[[T], R], things: Sequence[T], cancelled: Callable[[], bool], done: Callable[[T], None]
    ) -> list[R]:
        """Return results in the order of ``things``; call ``done`` with each finished item.

        Raises:
            CancelledError: ``cancelled`` returned True.
        """
        ...


class SerialExecutor:
    """Serial executor in this process."""

    def do(
        self, work: Callable[[T], R], things: Sequence[T], cancelled: Callable[[], bool], done: Callable[[T], None]
    ) -> list[R]:
        """Return results in the order of ``things``."""
        results = []
        for thing in things:
            if cancelled():
                raise CancelledError
            results.append(work(thing))
            done(thing)
        return results


class Pool:
    """Pool of worker processes, each with a pipe.

    One thread sends and receives, and a process gets the next item after it has answered the last: nothing is queued,
    no lock is shared, and a process that dies closes its pipe. A signal can therefore interrupt anything here, or end
    the processes first, and ``close`` still returns.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._members: list[tuple[BaseProcess, Connection]] = []

    @property
    def processes(self) -> tuple[BaseProcess, ...]:
        """The processes."""
        return tuple(process for process, _ in self._members)

    def do(
        self, work: Callable[[T], R], things: Sequence[T], cancelled: Callable[[], bool], done: Callable[[T], None]
    ) -> list[R]:
        """Return results in the order of ``things``; drop unfinished items when cancelled.

        An item whose process dies is given to another process, once.

        Raises:
            CancelledError: ``cancelled`` returned True.
            UnusableInputError: two processes died on the same item.
            Exception: the first exception of the work in the order of ``things``.
        """
        answers: dict[int, tuple[bool, Any]] = {}
        doing: dict[Connection, int] = {}
        waiting = list(reversed(range(len(things))))
        self._stop([pipe for process, pipe in self._members if not process.is_alive()])
        idle = [pipe for _, pipe in self._members]
        repeated: set[int] = set()
        try:
            while len(answers) < len(things):
                while waiting and (idle or len(doing) < self._count):
                    free = idle.pop() if idle else self._started()
                    doing[free] = waiting.pop()
                    with contextlib.suppress(OSError):  # of a process that died: its end is received below
                        free.send((work, things[doing[free]]))
                for pipe in wait(list(doing), POLL_S):
                    assert isinstance(pipe, Connection)
                    index = doing[pipe]
                    try:
                        answers[index] = pipe.recv()
                    except (EOFError, OSError):
                        self._stop([pipe])
                        del doing[pipe]
                        if index in repeated:
                            raise UnusableInputError(
                                "workers.ended",
                                "two processes that computed the same part were ended from outside: free memory, or "
                                "choose fewer processes",
                            ) from None
                        repeated.add(index)
                        waiting.append(index)
                        continue
                    done(things[index])
                    del doing[pipe]
                    idle.append(pipe)
                if cancelled():
                    raise CancelledError
        finally:
            self._stop(doing)
        for index in range(len(things)):
            good, value = answers[index]
            if not good:
                raise value
        return [answers[index][1] for index in range(len(things))]

    def close(self) -> None:
        """End all processes."""
        self._stop([pipe for _, pipe in self._members])

    def _started(self) -> Connection:
        """Start a process and return its pipe."""
        context = spawn_context()
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs,), daemon=True)
        try:
            start_worker(process)
            self._members.append((process, ours))
        finally:
            theirs.close()
        return ours

    def _stop(self, pipes: Collection[Connection]) -> None:
        # End the processes of these pipes: a busy process would answer an outdated request.
        leaving = [(process, pipe) for process, pipe in self._members if pipe in pipes]
        for process, _ in leaving:
            process.terminate()
        latest = time.monotonic() + EXIT_TIMEOUT_S
        for process, pipe in leaving:
            process.join(max(latest - time.monotonic(), 0.0))
            if process.is_alive():
                process.kill()
                process.join()
            pipe.close()
        self._members = [member for member in self._members if member not in leaving]


@contextmanager
def executor(workers: int | None = None) -> Iterator[Executor]:
    """Yield an executor with this number of processes, one for each processor by default; 1 runs in this process."""
    count = workers or os.cpu_count() or 1
    if count == 1:
        yield SerialExecutor()
        return
    with contextlib.closing(Pool(count)) as pool:
        yield pool


def _serve(pipe: Connection) -> None:
    # Main function of a worker process until the pipe is closed. Ctrl+C reaches the whole group; the parent handles it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if (parent := parent_process()) is not None:
        threading.Thread(target=_exit_with_parent, args=(parent,), daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        while True:
            work, thing = pipe.recv()
            pipe.send(_answer(work, thing))


def _answer(work: Callable[[Any], Any], thing: Any) -> tuple[bool, Any]:
    try:
        return True, work(thing)
    except Exception as error:  # noqa: BLE001 - it is raised again in the parent
        try:
            pickle.loads(pickle.dumps(error))  # noqa: S301 - written just now
        except Exception:  # noqa: BLE001 - some errors cannot be made again from their arguments
            return False, RuntimeError(f"{type(error).__name__}: {error}")
        return False, error


def _exit_with_parent(parent: BaseProcess) -> None:
    # A busy process would outlive a killed parent.
    parent.join()
    os._exit(0)
