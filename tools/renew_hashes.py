"""Renew the hashes in constraints.txt: those of all files of each pinned version in the package index.

    .venv/bin/python tools/renew_hashes.py            # after a version was changed: write name==version, then run this
    .venv/bin/python tools/renew_hashes.py --check    # status 1 if the index has a file that is not listed

The index is the one configured for pip, queried by pip's own client for the pinned packages only. A file without a
SHA-256 in the index is downloaded and hashed. No address is written.
"""

from __future__ import annotations

import argparse
import hashlib
import re
import sys
from pathlib import Path

from pip._internal.commands import create_command
from pip._internal.index.collector import LinkCollector, parse_links
from pip._internal.models.link import Link
from pip._vendor.packaging.utils import (
    InvalidSdistFilename,
    InvalidWheelFilename,
    canonicalize_name,
    parse_sdist_filename,
    parse_wheel_filename,
)
from pip._vendor.packaging.version import InvalidVersion

PINS = Path(__file__).parents[1] / "constraints.txt"
_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)\s*(;[^\\]*)?", re.MULTILINE)


def pins(text: str) -> list[tuple[str, str, str]]:
    """Return name, version and marker of every pinned package."""
    return [(name, version, (marker or "").strip()) for name, version, marker in _PIN.findall(text)]


def files(collector: LinkCollector, name: str, version: str) -> dict[str, Link]:
    """Return the wheels of one version, for all platforms, and its source archive, by file name."""
    found: dict[str, Link] = {}
    for location in collector.search_scope.get_index_urls_locations(name):
        page = collector.fetch_response(Link(location))
        for link in parse_links(page) if page is not None else ():
            if _of(link.filename) == (canonicalize_name(name), version) and not link.is_yanked:
                found.setdefault(link.filename, link)
    return found


def _of(filename: str) -> tuple[str, str]:
    """Return project and version of a file; None for other files than wheels and source archives."""
    try:
        if filename.endswith(".whl"):
            project, version, _, _ = parse_wheel_filename(filename)
        else:
            project, version = parse_sdist_filename(filename)
    except (InvalidWheelFilename, InvalidSdistFilename, InvalidVersion):
        return "", ""
    return project, str(version)


def sha256_of(collector: LinkCollector, link: Link) -> str:
    """Return the hash given by the index, or compute it from the file."""
    if "sha256" in link._hashes:
        return str(link._hashes["sha256"])
    answer = collector.session.get(link.url_without_fragment)
    answer.raise_for_status()
    return hashlib.sha256(answer.content).hexdigest()


def listed(text: str) -> set[str]:
    """Return all hashes of a file of pins."""
    return set(re.findall(r"--hash=sha256:([0-9a-f]{64})", text))


def main() -> int:
    """Renew or check; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing")
    check = parser.parse_args().check
    command = create_command("download")
    options, _ = command.parse_args([])
    text = PINS.read_text(encoding="utf-8")
    blocks, missing = [], []
    with command.main_context():
        collector = LinkCollector.create(command.get_default_session(options), options=options)
        for name, version, marker in pins(text):
            hashes = sorted({sha256_of(collector, link) for link in files(collector, name, version).values()})
            if not hashes:
                missing.append(f"{name}=={version}")
            head = f"{name}=={version}" + (f" {marker}" if marker else "")
            blocks.append(" \\\n".join([head, *(f"    --hash=sha256:{value}" for value in hashes)]))
    if missing:
        print(f"the index has no file of {', '.join(missing)}", file=sys.stderr)
        return 2
    comment = "".join(line for line in text.splitlines(keepends=True) if line.startswith("#"))
    renewed = comment + "\n".join(blocks) + "\n"
    if check:
        new = listed(renewed) - listed(text)
        print(f"{len(new)} hashes of {len(listed(renewed))} are not listed")
        return 1 if new else 0
    PINS.write_text(renewed, encoding="utf-8")
    print(f"{len(blocks)} packages, {len(listed(renewed))} hashes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
