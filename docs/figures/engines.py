"""Measures what the engines promise and writes the table of docs/engines.md.

Without options it prints the table; ``--write`` puts it into the document, ``--only TOPIC`` measures one topic, which
is a module of ``engine_claims``. Status 1 when a claim is not kept.
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

BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def topics() -> list[str]:
    """Names of the modules that measure something."""
    return sorted(module.name for module in pkgutil.iter_modules(engine_claims.__path__) if module.name != "base")


def measure(names: Iterable[str]) -> list[Claim]:
    """The claims of these topics, one after another, told as they come."""
    found: list[Claim] = []
    for name in names:
        for claim in importlib.import_module(f"engine_claims.{name}").claims():
            print(f"{name}: {claim.what}: {claim.measured}{'' if claim.kept else '  (NOT KEPT)'}", flush=True)
            found.append(claim)
    return found


def as_table(claims: Iterable[Claim]) -> str:
    """The claims as Markdown."""
    lines = ["| | asked | measured |", "| --- | --- | --- |"]
    lines += [f"| {c.what} | {c.asked} | {c.measured}{'' if c.kept else ' (**not reached**)'} |" for c in claims]
    return "\n".join(lines)


def main() -> int:
    """Measure, print, and with ``--write`` write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="put the table into docs/engines.md")
    parser.add_argument("--only", choices=topics(), help="measure one topic")
    options = parser.parse_args()
    if options.write and options.only:
        parser.error("--write needs every topic")
    claims = measure([options.only] if options.only else topics())
    if options.write:
        text = DOCUMENT.read_text(encoding="utf-8")
        block = f"{BEGIN}\n{as_table(claims)}\n{END}"
        DOCUMENT.write_text(re.sub(f"{BEGIN}.*?{END}", lambda _: block, text, flags=re.DOTALL), encoding="utf-8")
    return 0 if all(claim.kept for claim in claims) else 1


if __name__ == "__main__":
    sys.exit(main())
