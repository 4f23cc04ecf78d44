"""Child process that reads untrusted HDF5 files (docs/decisions/0030-reader-process.md).

The HDF5 library is written in C: a damaged file can cause an endless loop, exhaust memory or crash it, and neither
Ctrl+C nor an exception stops it. The child is reused for further files, and restarted if a file ended it.
"""

from __future__ import annotations

import atexit
import contextlib
import faulthandler
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

from tissueid.child_process import start
from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.messages import Action, Message
from tissueid.sessions import hdf5_mat, hdf5_session
from tissueid.sessions.file_policy import check_session_file
from tissueid.sessions.model import Outline, Session, Test
from tissueid.untrusted_input import MEMORY_BYTES, allowed_seconds

_COMMAND = "from tissueid.sessions.reader_process import serve; serve()"
_TIMED_OUT = -signal.SIGPROF if hasattr(signal, "SIGPROF") else 1
"""Exit status of a child that exceeded its time."""
_MEMORY = MEMORY_BYTES * 3 // 5
"""Memory limit of the child for one file, bytes above its size at start. The rest is for the result."""
_MEMORY_PER_BYTE = 16
"""Additional memory per byte of the file."""
_KEPT = 100_000_000
"""Growth of a child's memory, bytes, above which it is replaced after the file."""


_SLOW = Message("session.slow", "{path} is damaged: it takes too long to be read")
_CRASHED = Message("session.crashed", "{path} is damaged: it ends the reading process")


def _renamed(value: Any, old: str, new: str) -> Any:
    """Return a text, message or value with a path replaced."""
    if isinstance(value, Message):
        values = {name: _renamed(item, old, new) for name, item in value.values.items()}
        return Message(value.code, value.template, **values)
    if isinstance(value, Action):
        return replace(value, command=value.command.replace(old, new))
    return value.replace(old, new) if isinstance(value, str) else value


class ReaderProcess:
    """A child process that reads HDF5 files, one at a time. Concurrent threads are serialised.

    ``seconds`` is the time limit for one file by its size.
    """

    def __init__(self, seconds: Callable[[int], float] = allowed_seconds) -> None:
        self._seconds = seconds
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None

    def read(self, task: str, path: Path, *arguments: Any) -> list[Any]:
        """Run a task of ``_TASKS`` on a file in the child; return what it yields.

        Raises:
            UnusableInputError: as the task, or the child could not be started.
            SessionFormatError: as the task, or reading the file took too long or ended the child.
        """
        absolute = Path(os.path.abspath(path))  # noqa: PTH100 - Path.resolve would follow links, and say so in errors
        with self._lock:
            try:
                return self._ask(pickle.dumps((task, absolute, self._seconds(path.stat().st_size), arguments)))
            except (EOFError, OSError, pickle.UnpicklingError) as error:
                reason = _SLOW if self._ended() == _TIMED_OUT else _CRASHED
                raise SessionFormatError(reason.code, reason.template, path=str(path)) from error
            except UnusableInputError as error:
                raise type(error)(_renamed(error.message, str(absolute), str(path))) from error
            except BaseException:
                self._ended()  # after an interrupt or a defect, the next caller must not receive the remaining items
                raise

    def close(self) -> None:
        """End the child. It is restarted for the next file."""
        with self._lock:
            self._ended()

    def kill(self) -> None:
        """Kill the child without waiting for its file, at the end of the program."""
        if (process := self._process) is not None:
            process.kill()
            with contextlib.suppress(OSError), process:
                pass  # closes the pipes and waits

    def _ask(self, request: bytes) -> list[Any]:
        process = self._running()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(request)
        process.stdin.flush()
        items = []
        while True:
            kind, value = pickle.load(process.stdout)  # noqa: S301 - written by this program's own child
            if kind == "item":
                items.append(value)
                continue
            if kind == "last":
                self._ended()
            if kind == "defect":
                raise RuntimeError(value)
            if isinstance(value, UnusableInputError):
                raise value
            return items

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._process.poll() is None:
            return self._process
        self._ended()
        try:
            self._process = start(
                "-c",
                _COMMAND,
                environment={"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                cwd=Path(sys.executable).anchor,  # does not keep the current folder in use
                # In its own process group it does not receive Ctrl+C; it ends when its input is closed.
                start_new_session=sys.platform != "win32",
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            )
        except OSError as error:
            raise UnusableInputError(
                "reader.not_started",
                "the reading process cannot be started: {reason}",
                reason=str(error.strerror or error),
            ) from error
        return self._process

    def _ended(self) -> int | None:
        """End the child; return its exit status if it had ended by itself."""
        process, self._process = self._process, None
        if process is None:
            return None
        with process:
            with contextlib.suppress(OSError):
                process.stdin.close()  # type: ignore[union-attr]
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.2)
            own = process.returncode
            process.kill()
        return own


_reader = ReaderProcess()
_reader_of = os.getpid()
atexit.register(lambda: _reader.kill())


def read_in_child(task: str, path: Path, *arguments: Any) -> list[Any]:
    """Run ``ReaderProcess.read`` with the child of this process."""
    global _reader, _reader_of
    if _reader_of != os.getpid():  # after a fork, the child belongs to the parent
        _reader, _reader_of = ReaderProcess(), os.getpid()
    return _reader.read(task, path, *arguments)


_TASKS: dict[str, Callable[..., Any]] = {
    "session": hdf5_session.session_parts,
    "head": hdf5_session.read_session_head,
    "outline": hdf5_session.read_outline,
    "test": hdf5_session.read_test,
    "MAT vectors": hdf5_mat.hdf5_vectors,
    "MAT values": hdf5_mat.hdf5_values,
}
"""Functions of a path and further arguments; each returns one result, or yields several."""


# -- the child ------------------------------------------------------------------------------------------------


def serve() -> None:
    """Main function of the child: read files until the input ends."""
    incoming, outgoing = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr  # other output must not mix with the results
    if hasattr(signal, "SIGPROF"):
        signal.signal(signal.SIGPROF, signal.SIG_DFL)  # a parent may have ignored it
    addresses, resident = _memory()
    while True:
        try:
            task, path, seconds, arguments = pickle.load(incoming)  # noqa: S301 - written by this program's own parent
        except EOFError:
            return
        _limit_memory(addresses, path)
        kind, value = _served(outgoing, task, path, seconds, arguments)
        _end_after(0.0)
        last = kind == "done" and _memory()[1] > resident + _KEPT
        _send(outgoing, "last" if last else kind, value)


def _served(
    outgoing: IO[bytes], task: str, path: Path, seconds: float, arguments: tuple[Any, ...]
) -> tuple[str, Exception | str | None]:
    try:
        _end_after(seconds)
        result = _TASKS[task](path, *arguments)
        for item in result if isinstance(result, Iterator) else (result,):
            _send(outgoing, "item", item)
            _end_after(seconds)
    except UnusableInputError as error:
        return "done", error.with_traceback(None)
    except MemoryError:
        return "done", SessionFormatError(
            "session.memory", "{path} is damaged: it would take too much memory", path=str(path)
        )
    except Exception:  # noqa: BLE001 - a defect of the software, reported by the parent
        return "defect", traceback.format_exc()
    return "done", None


def _send(outgoing: IO[bytes], kind: str, value: object) -> None:
    pickle.dump((kind, value), outgoing, protocol=pickle.HIGHEST_PROTOCOL)
    outgoing.flush()


def _end_after(seconds: float) -> None:
    """End this process after a time limit, regardless of its state; no limit for 0.

    CPU time counts if the system supports it, so that a busy machine or a slow disk is not attributed to the file.
    """
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, seconds)  # the unhandled signal ends the process
    elif seconds:
        faulthandler.dump_traceback_later(seconds, exit=True)
    else:
        faulthandler.cancel_dump_traceback_later()


def _memory() -> tuple[int, int]:
    """Return the virtual and the resident memory in use, bytes; 0 if the system does not report them."""
    try:
        addresses, resident = Path("/proc/self/statm").read_text(encoding="ascii").split()[:2]
        page = os.sysconf("SC_PAGE_SIZE")
        return int(addresses) * page, int(resident) * page
    except (OSError, ValueError):
        return 0, 0


def _limit_memory(addresses: int, path: Path) -> None:
    """Limit the memory of this process, if the system supports it."""
    if not addresses:
        return
    import resource

    with contextlib.suppress(OSError, ValueError):
        most = addresses + _MEMORY + _MEMORY_PER_BYTE * path.stat().st_size
        resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))


def read_session(path: Path) -> Session:
    """Read a session.

    Raises:
        SessionFormatError: missing, not a session, or not in accordance with the format or a limit.
    """
    return hdf5_session.whole_session(_read("session", path))


def read_session_head(path: Path) -> Session:
    """Read a session without its tests.

    Raises:
        SessionFormatError: as ``read_session``.
    """
    head: Session = _read("head", path)[0]
    return head


def read_outline(path: Path) -> Outline:
    """Read a session without its signals, in a few milliseconds for tests of any length.

    Raises:
        SessionFormatError: as ``read_session``.
    """
    outline: Outline = _read("outline", path)[0]
    return outline


def read_test(path: Path, number: int) -> Test:
    """Read one test of a session.

    Raises:
        SessionFormatError: as ``read_session``, or there is no such test.
    """
    test: Test = _read("test", path, number)[0]
    return test


def _read(task: str, path: Path, *arguments: Any) -> list[Any]:
    check_session_file(path)  # at once, and with errors that distinguish a folder from a missing file
    return read_in_child(task, path, *arguments)
