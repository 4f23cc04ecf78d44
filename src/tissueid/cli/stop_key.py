"""Stop keys of a test at a terminal: Space, Enter, q or Escape releases the coil, as does Ctrl+C."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tissueid.cli.output import console
from tissueid.errors import CancelledError
from tissueid.messages import Message
from tissueid.procedures.control import BY_KEY

STOPS = b" \r\n\x1bqQ"
"""Bytes of the stop keys. Arrow keys and the like begin with Escape and therefore stop too."""
HINT = "Space, Enter, q or Esc stops the test and releases the coil at once"


class StopKey:
    """State of the stop key. All methods can be called from any thread."""

    def __init__(self) -> None:
        self._pressed = threading.Event()

    def press(self) -> None:
        """Record that a stop key was pressed."""
        self._pressed.set()

    def check(self) -> bool:
        """Return False; used as the ``cancelled`` callback of a test.

        Raises:
            CancelledError: a stop key was pressed.
        """
        if self._pressed.is_set():
            raise CancelledError(
                Message("stop.kept", "{cause}; the coil is released and what was recorded is kept", cause=BY_KEY)
            )
        return False


@contextmanager
def stop_key() -> Iterator[StopKey]:
    """Read the keys of the terminal while the context lasts; pass ``check`` as ``cancelled``.

    The terminal settings are restored afterwards. If standard input is not a terminal, or belongs to another program
    (the command runs in the background), no key is read; Ctrl+C and signals still work. Keys typed before and during
    the test are discarded, because they are not meant for the next program.
    """
    key = StopKey()
    with contextlib.ExitStack() as stack:
        reader = _reader(stack)
        if reader is not None:
            over = threading.Event()
            thread = threading.Thread(target=_watch, args=(reader, key, over), name="stop key", daemon=True)
            stack.callback(thread.join)
            stack.callback(over.set)
            thread.start()
            console.print(HINT, style="dim")
        yield key


def _watch(read: Callable[[], bytes | None], key: StopKey, over: threading.Event) -> None:
    """Read keys until a stop key is pressed, the terminal is closed, or the test is over."""
    while not over.is_set():
        typed = read()
        if typed is None:
            return
        if any(code in STOPS for code in typed):
            key.press()
            return


_POLL_S = 0.02
"""Time that one read waits for a key."""

if sys.platform == "win32":
    import msvcrt
    import time

    def _reader(stack: contextlib.ExitStack) -> Callable[[], bytes | None] | None:
        """Return a function that reads the keys of the console; None if there is no console."""
        del stack
        if sys.stdin is None or not sys.stdin.isatty():
            return None
        while msvcrt.kbhit():
            msvcrt.getch()

        def read() -> bytes | None:
            if not msvcrt.kbhit():
                time.sleep(_POLL_S)
                return b""
            return msvcrt.getch()

        return read

else:
    import select
    import termios
    import tty

    def _reader(stack: contextlib.ExitStack) -> Callable[[], bytes | None] | None:
        """Set up the terminal until the stack unwinds; return a function that reads its keys, None if there is none."""
        try:
            terminal = sys.stdin.fileno()
            if not os.isatty(terminal) or os.tcgetpgrp(terminal) != os.getpgrp():
                return None
            before = termios.tcgetattr(terminal)
            tty.setcbreak(terminal, termios.TCSANOW)  # Ctrl+C still interrupts
            termios.tcflush(terminal, termios.TCIFLUSH)
        except (OSError, ValueError, AttributeError, termios.error):
            return None  # closed or redirected

        def restore() -> None:
            with contextlib.suppress(OSError, termios.error):
                # not TCSAFLUSH, which waits for a terminal that accepts no output
                termios.tcsetattr(terminal, termios.TCSANOW, before)
                termios.tcflush(terminal, termios.TCIFLUSH)

        stack.callback(restore)

        def read() -> bytes | None:
            try:
                ready, _, _ = select.select([terminal], [], [], _POLL_S)
                return (os.read(terminal, 64) or None) if ready else b""
            except (OSError, ValueError):
                return None

        return read
