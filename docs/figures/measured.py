"""Measure claims and write them as data: for the scripts of this folder.

The claims are a package of modules, one for each topic, each with ``claims()``. Each topic is a section of
docs/measured/NAME.json.
"""

from __future__ import annotations

import argparse
import importlib
import json
import pkgutil
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# The claims; the systems that the tests simulate; the plain routes of the benchmarks.
sys.path[:0] = [str(folder) for folder in (HERE, ROOT / "tests", ROOT / "tests" / "stimuli", ROOT)]

from engine_claims.base import Claim  # noqa: E402


def replace_section(name: str, topic: str, **content: object) -> None:
    """Replace a section of docs/measured/NAME.json, except for what ``content`` leaves out.

    Raises:
        LookupError: the data have no section of this topic.
    """
    path = ROOT / "docs" / "measured" / f"{name}.json"
    data = json.loads(path.read_text(encoding="utf-8"))
    found = [section for section in data["sections"] if section["topic"] == topic]
    if len(found) != 1:
        raise LookupError(f"{path.name} has {len(found)} sections of the topic {topic}")
    found[0].update(content)
    path.write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


@dataclass(frozen=True)
class Measured:
    """A subject of measured figures and the package of its claims."""

    package: str
    name: str

    def topics(self) -> list[str]:
        """Names of the modules that measure something."""
        found = pkgutil.iter_modules(importlib.import_module(self.package).__path__)
        return sorted(module.name for module in found if module.name != "base")

    def measure(self, topic: str) -> list[Claim]:
        """Return the claims of a topic, printed as they are measured."""
        found: list[Claim] = []
        for claim in importlib.import_module(f"{self.package}.{topic}").claims():
            print(f"{topic}: {claim.what}: {claim.measured}{'' if claim.kept else '  (NOT KEPT)'}", flush=True)
            found.append(claim)
        return found

    def write(self, topic: str, claims: Iterable[Claim]) -> None:
        """Replace the section of a topic in the data."""
        title = (importlib.import_module(f"{self.package}.{topic}").__doc__ or topic).splitlines()[0].rstrip(".")
        rows = [[c.what, c.asked, f"{c.measured}{'' if c.kept else ' (**not reached**)'}"] for c in claims]
        replace_section(self.name, topic, title=title, columns=["", "target", "measured"], rows=rows)

    def main(self, description: str | None) -> int:
        """Measure, print, and with ``--write`` write; 1 when a claim is not kept."""
        parser = argparse.ArgumentParser(description=description)
        parser.add_argument("--write", action="store_true", help=f"put the tables into docs/measured/{self.name}.json")
        parser.add_argument("--only", choices=self.topics(), help="measure one topic")
        options = parser.parse_args()
        kept = True
        for topic in [options.only] if options.only else self.topics():
            claims = self.measure(topic)
            kept &= all(claim.kept for claim in claims)
            if options.write:
                self.write(topic, claims)
        return 0 if kept else 1
