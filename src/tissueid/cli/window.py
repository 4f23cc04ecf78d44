"""``tissueid`` without a command: open the window, or report why it cannot be opened."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from tissueid.errors import UnusableInputError

SYSTEM_PACKAGES = (
    "libegl1 libgl1 libxkbcommon0 libdbus-1-3 libfontconfig1 libglib2.0-0 libx11-xcb1 libxcb-cursor0 libxcb-icccm4 "
    "libxcb-image0 libxcb-keysyms1 libxcb-randr0 libxcb-render-util0 libxcb-shape0 libxcb-sync1 libxcb-xfixes0 "
    "libxcb-xkb1 libxkbcommon-x11-0"
)
"""Packages of Debian and Ubuntu that Qt needs; tools/check_qt_libraries.sh installs the same."""
_OURS = ("PySide6", "shiboken6", "pyqtgraph")


def open_application() -> int:
    """Open the window and return the exit status when it is closed.

    Raises:
        UnusableInputError: there is no display, or a required package is not installed.
    """
    check_display(os.environ, sys.platform)
    try:
        from tissueid.app.window import run
    except ImportError as error:
        if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] not in _OURS:
            raise
        raise _missing(error) from error
    return run()


def check_display(environment: Mapping[str, str], platform: str) -> None:
    """Check for errors on which Qt aborts the program: no display, no answer from it, or a missing library.

    Raises:
        UnusableInputError: the window cannot be opened; the message says why and what to do.
    """
    if platform in ("win32", "darwin"):
        return
    wanted = environment.get("QT_QPA_PLATFORM", "")
    display = environment.get("DISPLAY", "")
    if wanted.partition(":")[0] not in ("", "xcb") or (not wanted and environment.get("WAYLAND_DISPLAY")):
        return
    if not display:
        raise UnusableInputError(
            "there is no display to open the window on (DISPLAY and WAYLAND_DISPLAY are not set); "
            "'tissueid --help' lists commands that work without it"
        )
    try:
        _load_plugin()
        answers = _x_server_answers()
    except OSError as error:
        raise _missing(error) from error
    if not answers:
        raise UnusableInputError(
            f"the display {display} does not answer; 'tissueid --help' lists commands that need none"
        )


def _missing(error: ImportError | OSError) -> UnusableInputError:
    if isinstance(error, ModuleNotFoundError):
        return UnusableInputError(
            f"the window needs {error.name}, which is not installed: run 'make env', or pip install 'tissueid[app]'"
        )
    library = str(error).partition(":")[0]
    return UnusableInputError(
        f"the window needs the system library {library}, which cannot be loaded: run 'make env' as root, "
        f"or sudo apt-get install {SYSTEM_PACKAGES}"
    )


def _load_plugin() -> None:
    """Load the X11 plugin of Qt; an OSError names a missing library."""
    package = find_spec("PySide6")
    for folder in (package.submodule_search_locations or []) if package else []:
        plugin = Path(folder) / "Qt" / "plugins" / "platforms" / "libqxcb.so"
        if plugin.is_file():
            ctypes.CDLL(str(plugin))


def _x_server_answers() -> bool:
    """Return whether the X server of DISPLAY answers."""
    xcb = ctypes.CDLL("libxcb.so.1")
    xcb.xcb_connect.restype = ctypes.c_void_p
    connection = ctypes.c_void_p(xcb.xcb_connect(None, None))
    broken = xcb.xcb_connection_has_error(connection)
    xcb.xcb_disconnect(connection)
    return not broken
