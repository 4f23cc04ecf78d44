#!/usr/bin/env bash
# Qt brings itself but not the system's graphics libraries. Name those that are missing; install them where that is possible.
set -euo pipefail
venv=${1:-.venv}
[ "$(uname -s)" = Linux ] || exit 0

probe='from PySide6 import QtGui, QtWidgets'
QT_QPA_PLATFORM=offscreen "$venv/bin/python" -c "$probe" 2>/dev/null && exit 0

packages="libegl1 libgl1 libxkbcommon0 libdbus-1-3 libfontconfig1 libglib2.0-0"
missing=$(QT_QPA_PLATFORM=offscreen "$venv/bin/python" -c "$probe" 2>&1 | tail -n 1 || true)
echo "== the window needs system libraries that are missing: $missing"
if command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" = 0 ]; then
    echo "== installing $packages"
    { apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $packages; } >/dev/null || true
fi
if QT_QPA_PLATFORM=offscreen "$venv/bin/python" -c "$probe" 2>/dev/null; then
    echo "== the window's libraries are in place"
else
    echo "== still missing. Everything but the window works. To have the window: sudo apt-get install $packages"
fi
