"""List of the named twins in a folder. Does not import the compiled simulation code."""

from __future__ import annotations

from pathlib import Path
from typing import Literal
from urllib.parse import quote

from tissueid.formatting import clean
from tissueid.untrusted_input import toml_table

FORMAT: Literal["tissueid-twin"] = "tissueid-twin"
SUFFIX = ".toml"
MOST_BYTES = 256 * 1024
"""Largest file of a twin that is read, bytes."""
MOST_TWINS = 20
"""Maximum number of files read in a folder, newest first."""
_SCHEME = "simulated://"
_LONGEST = 60
"""Maximum number of displayed characters of a name."""


def twin_url(path: Path) -> str:
    """Return the address that simulates the twin in a file."""
    return _SCHEME + quote(str(path.absolute()))


def is_twin_url(url: str) -> bool:
    """Return whether an address simulates the twin in a file."""
    return url.startswith(_SCHEME) and url.partition("?")[0].endswith(SUFFIX)


def twin_model(name: str, version: int) -> str:
    """Return the device model of a simulated twin, which its sessions also carry."""
    return f"twin {name}, version {version}"


def twins_in(folder: Path) -> dict[str, str]:
    """Return the model of each twin in a folder by its address, newest first. Other files are left out."""
    try:
        files = [path for path in folder.glob(f"*{SUFFIX}") if path.is_file() and not path.name.startswith(".")]
        dated = [(path.stat().st_mtime, path) for path in files]
    except OSError:
        return {}
    newest = [path for _, path in sorted(dated, reverse=True)[:MOST_TWINS]]
    return {twin_url(path): model for path in newest if (model := model_of_file(path))}


def model_of_file(path: Path) -> str:
    """Return the model of the twin in a file from its name and version; empty if the file is not a twin."""
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
        content = toml_table(data) if len(data) <= MOST_BYTES else {}
    except (OSError, ValueError):
        return ""
    name, version = content.get("name"), content.get("version")
    if content.get("format") != FORMAT or not isinstance(name, str) or not isinstance(version, int):
        return ""
    return twin_model(clean(name)[:_LONGEST], version)
