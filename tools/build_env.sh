#!/usr/bin/env bash
# Build the environment: a virtual environment from pinned versions with verified hashes, then the system libraries that
# Qt needs. TISSUEID_UNVERIFIED=1 installs the pinned versions without verification, where a file has no known hash.
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
pip=("$venv/bin/python" -m pip --quiet)
pins=$venv/pins.txt
build_pins=$venv/build_pins.txt
verify=(--require-hashes)
if [ "${TISSUEID_UNVERIFIED:-}" = 1 ]; then
    echo "== packages are not verified: TISSUEID_UNVERIFIED is set" >&2
    verify=()
    sed -nE 's/^([A-Za-z0-9._-]+==[^ ]+( *;[^\\]*)?).*/\1/p' constraints.txt >"$pins"
else
    cp constraints.txt "$pins"
fi
# What builds packages is installed first, as wheels, so that nothing is fetched unverified in order to build another.
awk '/^[A-Za-z]/ { keep = /^(babel|hatchling|packaging|pathspec|pluggy|setuptools|tomlkit|trove-classifiers)==/ } keep' \
    "$pins" >"$build_pins"
if ! { "${pip[@]}" install ${verify[@]+"${verify[@]}"} --no-deps --only-binary :all: --requirement "$build_pins" &&
    "${pip[@]}" install ${verify[@]+"${verify[@]}"} --no-build-isolation --requirement "$pins"; }; then
    cat >&2 <<'END'
The packages could not be installed (pip says above why). If it says that hashes do not match, a file is not the one that was
published: do not use it. If it finds no matching file, or wants to build a package and cannot, this platform or this
version of Python has no wheel of the pinned version:
  - use a version of Python from 3.11 on that has one (PYTHON=/path/to/python make env), or
  - write another version into constraints.txt and run tools/renew_hashes.py, with an index that has it, or
  - TISSUEID_UNVERIFIED=1 make env, which takes what the index gives for the pinned versions without verification.
END
    exit 2
fi
"${pip[@]}" install --no-deps --no-build-isolation --no-index --editable .
"$venv/bin/python" -m pip check
bash "$(dirname "$0")/check_qt_libraries.sh" "$venv"
touch "$venv/.built"
echo "== environment ready"
