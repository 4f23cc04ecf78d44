"""Measures what the engines promise and writes the tables of docs/engines.md.

Without options it prints them; ``--write`` puts them into the document, a table for each topic; ``--only TOPIC``
measures one topic, which is a module of ``engine_claims``. Status 1 when a claim is not kept.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import re
import sys
from collections.abc import Iterable
from pathlib import Path

HERE = Path(__file__).parent
DOCUMENT = HERE.parent / "engines.md"
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "tests")]  # the claims, and the systems that the tests simulate

import engine_claims  # noqa: E402
from engine_claims.base import Claim  # noqa: E402


def topics() -> list[str]:
    """Names of the modules that measure something."""
    return sorted(module.name for module in pkgutil.iter_modules(engine_claims.__path__) if module.name != "base")


def measure(topic: str) -> list[Claim]:
    """The claims of a topic, told as they come."""
    found: list[Claim] = []
    for claim in importlib.import_module(f"engine_claims.{topic}").claims():
        print(f"{topic}: {claim.what}: {claim.measured}{'' if claim.kept else '  (NOT KEPT)'}", flush=True)
        found.append(claim)
    return found


def as_section(topic: str, claims: Iterable[Claim]) -> str:
    """Heading and table of a topic as Markdown, between marks by which they are found again."""
    title = (importlib.import_module(f"engine_claims.{topic}").__doc__ or topic).splitlines()[0].rstrip(".")
    lines = [f"<!-- measured: {topic} -->", f"### {title}", "", "| | asked | measured |", "| --- | --- | --- |"]
    lines += [f"| {c.what} | {c.asked} | {c.measured}{'' if c.kept else ' (**not reached**)'} |" for c in claims]
    return "\n".join([*lines, f"<!-- end of {topic} -->"])


def write(topic: str, claims: Iterable[Claim]) -> None:
    """Put a topic's section into the document in place of what stands there.

    Raises:
        LookupError: the document has no place for this topic.
    """
    text = DOCUMENT.read_text(encoding="utf-8")
    place = re.compile(f"<!-- measured: {topic} -->.*?<!-- end of {topic} -->", re.DOTALL)
    if not place.search(text):
        raise LookupError(f"{DOCUMENT.name} has no marks for the topic {topic}")
    DOCUMENT.write_text(place.sub(lambda _: as_section(topic, claims), text), encoding="utf-8")


def main() -> int:
    """Measure, print, and with ``--write`` write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="put the tables into docs/engines.md")
    parser.add_argument("--only", choices=topics(), help="measure one topic")
    options = parser.parse_args()
    kept = True
    for topic in [options.only] if options.only else topics():
        claims = measure(topic)
        kept &= all(claim.kept for claim in claims)
        if options.write:
            write(topic, claims)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
