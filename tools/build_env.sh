#!/usr/bin/env bash
# Build the environment: a virtual environment from pinned versions, then the system libraries that Qt needs.
set -euo pipefail
venv=${1:-.venv}

find_python() {
    local candidate
    for candidate in ${PYTHON:-} python3 python3.11 python3.12 python3.13 python; do
        if command -v "$candidate" >/dev/null 2>&1 &&
            "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
    echo "Python 3.11 or newer is needed and none was found; set PYTHON=/path/to/python3.11" >&2
    exit 2
}

python=$(find_python)
echo "== environment: $("$python" --version) -> $venv (about a minute the first time)"
rm -f "$venv/.built"
"$python" -m venv "$venv" || {
    echo "could not create a virtual environment; on Debian and Ubuntu: apt-get install python3-venv" >&2
    exit 2
}
export PIP_DISABLE_PIP_VERSION_CHECK=1
"$venv/bin/python" -m pip install --quiet --constraint constraints.txt --editable '.[app,dev]'
bash "$(dirname "$0")/check_qt_libraries.sh" "$venv"
touch "$venv/.built"
echo "== environment ready"
