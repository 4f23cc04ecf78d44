"""The stop key of a test at a terminal: Space, Enter, q or Escape releases the coil, besides Ctrl+C."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from tissueid.cli.output import console
from tissueid.errors import CancelledError

BY_KEY = "stopped by key"
STOPS = b" \r\n\x1bqQ"
"""What the keys send. Keys such as the arrows send an Escape and more, and stop too."""
HINT = "Space, Enter, q or Esc stops: the coil is released at once"


class StopKey:
    """Whether somebody pressed it. Any thread may ask."""

    def __init__(self) -> None:
        self._pressed = threading.Event()

    def press(self) -> None:
        """Stop."""
        self._pressed.set()

    def check(self) -> bool:
        """False; for whoever asks whether a test is cancelled.

        Raises:
            CancelledError: the key was pressed.
        """
        if self._pressed.is_set():
            raise CancelledError(f"{BY_KEY}; the coil is released and what was recorded is kept")
        return False


@contextmanager
def stop_key() -> Iterator[StopKey]:
    """Watch the terminal's keys for as long as the context lasts; pass ``check`` on as ``cancelled``.

    The terminal is given back as it was. Where standard input is no terminal, or belongs to another program at the
    moment (the command runs in the background), no key is read, and Ctrl+C and signals are all there is. What is typed
    while it lasts, and was typed ahead, is thrown away: it was meant for the test, not for what comes after it.
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
    """Read until a key stops, the terminal is gone, or it is over."""
    while not over.is_set():
        typed = read()
        if typed is None:
            return
        if any(code in STOPS for code in typed):
            key.press()
            return


_LOOK_S = 0.02
"""How long a read waits for a key."""

if sys.platform == "win32":
    import msvcrt
    import time

    def _reader(stack: contextlib.ExitStack) -> Callable[[], bytes | None] | None:
        """What reads the keys of the console; None where there is none."""
        del stack
        if sys.stdin is None or not sys.stdin.isatty():
            return None
        while msvcrt.kbhit():
            msvcrt.getch()

        def read() -> bytes | None:
            if not msvcrt.kbhit():
                time.sleep(_LOOK_S)
                return b""
            return msvcrt.getch()

        return read

else:
    import select
    import termios
    import tty

    def _reader(stack: contextlib.ExitStack) -> Callable[[], bytes | None] | None:
        """What reads the terminal's keys, which it is set up for until the stack unwinds; None where there is none."""
        try:
            terminal = sys.stdin.fileno()
            if not os.isatty(terminal) or os.tcgetpgrp(terminal) != os.getpgrp():
                return None
            before = termios.tcgetattr(terminal)
            tty.setcbreak(terminal, termios.TCSANOW)  # Ctrl+C stays what it is
            termios.tcflush(terminal, termios.TCIFLUSH)
        except (OSError, ValueError, AttributeError, termios.error):
            return None  # closed, redirected or half gone

        def give_back() -> None:
            with contextlib.suppress(OSError, termios.error):
                # Not TCSAFLUSH, which waits for a terminal that takes no output.
                termios.tcsetattr(terminal, termios.TCSANOW, before)
                termios.tcflush(terminal, termios.TCIFLUSH)

        stack.callback(give_back)

        def read() -> bytes | None:
            try:
                ready, _, _ = select.select([terminal], [], [], _LOOK_S)
                return (os.read(terminal, 64) or None) if ready else b""
            except (OSError, ValueError):
                return None

        return read
