"""One test of a saved session, as the browser hands it on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Chosen:
    """A test that a researcher selected: its file, its number there, and what it is called on the screen.

    ``site`` and ``pseudonym`` are as the file has them; ``label`` is cleaned and short, and tells the selected ones
    apart.
    """

    path: Path
    number: int
    site: str
    pseudonym: str
    label: str


__all__ = ["Chosen"]
