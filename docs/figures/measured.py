"""Measures what a document claims, and writes its tables: for the scripts beside this file.

The claims are a package of modules, one a topic, each with ``claims()``. In the document each topic has a table of its
own between marks by which it is found again.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
# The claims; the systems that the tests simulate; the plain routes of the benchmarks.
sys.path[:0] = [str(folder) for folder in (HERE, ROOT / "tests", ROOT / "tests" / "stimuli", ROOT)]

from engine_claims.base import Claim  # noqa: E402


@dataclass(frozen=True)
class Measured:
    """A document and the package of claims that it makes."""

    package: str
    document: Path

    def topics(self) -> list[str]:
        """Names of the modules that measure something."""
        found = pkgutil.iter_modules(importlib.import_module(self.package).__path__)
        return sorted(module.name for module in found if module.name != "base")

    def measure(self, topic: str) -> list[Claim]:
        """The claims of a topic, told as they come."""
        found: list[Claim] = []
        for claim in importlib.import_module(f"{self.package}.{topic}").claims():
            print(f"{topic}: {claim.what}: {claim.measured}{'' if claim.kept else '  (NOT KEPT)'}", flush=True)
            found.append(claim)
        return found

    def as_section(self, topic: str, claims: Iterable[Claim]) -> str:
        """Heading and table of a topic as Markdown, between marks by which they are found again."""
        said = importlib.import_module(f"{self.package}.{topic}").__doc__ or topic
        lines = [f"<!-- measured: {topic} -->", f"### {said.splitlines()[0].rstrip('.')}", ""]
        lines += ["| | target | measured |", "| --- | --- | --- |"]
        lines += [f"| {c.what} | {c.asked} | {c.measured}{'' if c.kept else ' (**not reached**)'} |" for c in claims]
        return "\n".join([*lines, f"<!-- end of {topic} -->"])

    def write(self, topic: str, claims: Iterable[Claim]) -> None:
        """Put a topic's section into the document in place of what stands there.

        Raises:
            LookupError: the document has no place for this topic.
        """
        text = self.document.read_text(encoding="utf-8")
        place = re.compile(f"<!-- measured: {topic} -->.*?<!-- end of {topic} -->", re.DOTALL)
        if not place.search(text):
            raise LookupError(f"{self.document.name} has no marks for the topic {topic}")
        self.document.write_text(place.sub(lambda _: self.as_section(topic, claims), text), encoding="utf-8")

    def main(self, description: str | None) -> int:
        """Measure, print, and with ``--write`` write; 1 when a claim is not kept."""
        parser = argparse.ArgumentParser(description=description)
        parser.add_argument("--write", action="store_true", help=f"put the tables into docs/{self.document.name}")
        parser.add_argument("--only", choices=self.topics(), help="measure one topic")
        options = parser.parse_args()
        kept = True
        for topic in [options.only] if options.only else self.topics():
            claims = self.measure(topic)
            kept &= all(claim.kept for claim in claims)
            if options.write:
                self.write(topic, claims)
        return 0 if kept else 1
