"""Start child processes of Python that import nothing from the current folder.

Python puts the current folder first on the path of ``python -c`` (which multiprocessing uses) and ``python -m``. A
``multiprocessing.py`` or ``numpy.py`` in the folder of a session would therefore run when that session is analysed.
All processes are started by this module; a test checks that.
"""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any

_NICE = 10
"""Added niceness: next to a busy process of the usual priority it gets a tenth of a processor."""
SAFE_PATH = {"PYTHONSAFEPATH": "1"}
"""Environment that keeps the current folder off the path of all child Pythons (option ``-P`` of Python 3.11)."""


def start(*arguments: str, environment: dict[str, str] | None = None, **options: Any) -> subprocess.Popen[Any]:
    """Start Python with arguments and return the process.

    Args:
        arguments: after the interpreter, such as ``-m`` and a module.
        environment: variables in addition to this process's own.
        options: for ``subprocess.Popen``.

    Raises:
        OSError: the process cannot be started.
    """
    return subprocess.Popen(_command(arguments), env=_environment(environment), **options)


def run(*arguments: str, environment: dict[str, str] | None = None, **options: Any) -> subprocess.CompletedProcess[Any]:
    """Run Python with arguments to its end.

    Args:
        arguments: after the interpreter, such as ``-m`` and a module.
        environment: variables in addition to this process's own.
        options: for ``subprocess.run``.

    Raises:
        OSError: the process cannot be started.
        subprocess.TimeoutExpired: the process did not end in time.
        subprocess.CalledProcessError: with ``check``, its status is not 0.
    """
    return subprocess.run(_command(arguments), env=_environment(environment), **options)


def spawn_context() -> SpawnContext:
    """Return a multiprocessing context whose processes, including the resource tracker, are safe."""
    # Its processes inherit the environment and the path of this process.
    os.environ.update(SAFE_PATH)
    return multiprocessing.get_context("spawn")


def start_worker(process: SpawnProcess) -> None:
    """Start a process of ``spawn_context`` that does not run the caller's script again.

    Its function must be in a module. Without this, a script that is not guarded by ``if __name__ == "__main__":`` would
    run once more in each process.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        process.start()
    finally:
        sys.modules["__main__"] = script


def lower_priority() -> None:
    """Let this process and its children give way to others, above all to the one that measures."""
    if sys.platform == "win32":
        import ctypes

        kernel = ctypes.windll.kernel32
        kernel.SetPriorityClass(kernel.GetCurrentProcess(), 0x4000)  # BELOW_NORMAL_PRIORITY_CLASS
    else:
        os.nice(_NICE)


def _command(arguments: tuple[str, ...]) -> list[str]:
    return [sys.executable, "-P", *arguments]


def _environment(more: dict[str, str] | None) -> dict[str, str]:
    return os.environ | SAFE_PATH | (more or {})
