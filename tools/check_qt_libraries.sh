#!/usr/bin/env bash
# Qt brings itself but not the system's graphics libraries. Name those that are missing; install them where that is possible.
set -euo pipefail
venv=${1:-.venv}
[ "$(uname -s)" = Linux ] || exit 0

# Loading Qt's X11 plugin needs no display, and fails where opening a window would.
probe='
import ctypes, pathlib, PySide6
from PySide6 import QtGui, QtWidgets
ctypes.CDLL(str(pathlib.Path(PySide6.__path__[0], "Qt/plugins/platforms/libqxcb.so")))'
complete() { QT_QPA_PLATFORM=offscreen "$venv/bin/python" -c "$probe" 2>/dev/null; }
complete && exit 0

# The same as SYSTEM_PACKAGES in src/tissueid/cli/window.py.
packages="libegl1 libgl1 libxkbcommon0 libdbus-1-3 libfontconfig1 libglib2.0-0 libx11-xcb1 libxcb-cursor0 libxcb-icccm4
    libxcb-image0 libxcb-keysyms1 libxcb-randr0 libxcb-render-util0 libxcb-shape0 libxcb-sync1 libxcb-xfixes0
    libxcb-xkb1 libxkbcommon-x11-0"
packages=$(echo $packages)
missing=$(QT_QPA_PLATFORM=offscreen "$venv/bin/python" -c "$probe" 2>&1 | tail -n 1 || true)
echo "== the window needs system libraries that are missing: $missing"
if command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" = 0 ]; then
    echo "== installing $packages"
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $packages; } >/dev/null || true
fi
if complete; then
    echo "== the window's libraries are in place"
else
    echo "== still missing. Everything but the window works. To have the window: sudo apt-get install $packages"
fi
