"""Named twins of a folder as instruments that can be chosen, without the compiled code that plays them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal
from urllib.parse import quote

from tissueid.untrusted import toml_table
from tissueid.wording import clean

FORMAT: Literal["tissueid-twin"] = "tissueid-twin"
SUFFIX = ".toml"
MOST_BYTES = 256 * 1024
MOST_TWINS = 20
"""Newest files of a folder that are looked at."""
_SCHEME = "simulated://"
_LONGEST = 60


def twin_url(path: Path) -> str:
    """Return the address under which the twin in a file is simulated."""
    return _SCHEME + quote(str(path.absolute()))


def is_twin_url(url: str) -> bool:
    """Return whether an address is that of a simulated twin of a file."""
    return url.startswith(_SCHEME) and url.partition("?")[0].endswith(SUFFIX)


def twin_model(name: str, version: int) -> str:
    """Return the model that the simulation of a twin states, and its sessions with it."""
    return f"twin {name}, version {version}"


def twins_in(folder: Path) -> dict[str, str]:
    """Return the model of each twin in a folder by its address, newest first; a file that is no twin is left out."""
    try:
        files = [path for path in folder.glob(f"*{SUFFIX}") if path.is_file() and not path.name.startswith(".")]
        dated = [(path.stat().st_mtime, path) for path in files]
    except OSError:
        return {}
    newest = [path for _, path in sorted(dated, reverse=True)[:MOST_TWINS]]
    return {twin_url(path): model for path in newest if (model := model_of_file(path))}


def model_of_file(path: Path) -> str:
    """Return the model of the twin in a file by its name and version alone; empty where it is no twin."""
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
