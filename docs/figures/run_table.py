"""Shows the state machine of a run as the table of docs/safety.md.

Without options it prints the table; ``--write`` puts it into the document between its marks.
"""

from __future__ import annotations

import argparse
import inspect
import re
import sys
from collections.abc import Callable
from pathlib import Path

from tissueid.instrument.run_machine import TABLE, Mode

SAFETY = Path(__file__).resolve().parents[2] / "docs" / "safety.md"
MARKED = re.compile(r"(<!-- run -->\n).*?(<!-- end of run -->)", re.DOTALL)


def _first_line(item: Callable[..., object]) -> str:
    return (inspect.getdoc(item) or "").split("\n", 1)[0].rstrip(".")


def _name(item: Callable[..., object]) -> str:
    return item.__name__.replace("_", " ")


def table() -> str:
    """Return modes, events and reactions as Markdown."""
    lines = ["| mode | |", "| --- | --- |", *(f"| {mode.name} | {mode.value} |" for mode in Mode), ""]
    lines += ["| event | reaction | in other modes |", "| --- | --- | --- |"]
    for event, row in TABLE.items():
        reactions = list(row.values())
        usual = max(reactions, key=reactions.count)
        other: dict[str, list[str]] = {}
        for mode, reaction in row.items():
            if reaction is not usual:
                other.setdefault(_name(reaction), []).append(mode.name)
        shown = "; ".join(f"*{name}* in {', '.join(modes)}" for name, modes in other.items())
        what = event if isinstance(event, str) else _first_line(event)
        lines.append(f"| {what} | *{_name(usual)}* | {shown} |")
    every = {reaction for row in TABLE.values() for reaction in row.values()}
    lines += ["", "| reaction | |", "| --- | --- |"]
    lines += [f"| *{_name(reaction)}* | {_first_line(reaction)} |" for reaction in sorted(every, key=_name)]
    return "\n".join(lines) + "\n"


def page_with_table(page: str) -> str:
    """Return the page with the table between its marks."""
    return MARKED.sub(lambda marks: f"{marks[1]}{table()}{marks[2]}", page)


def main() -> int:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="put the table into docs/safety.md")
    if parser.parse_args().write:
        SAFETY.write_text(page_with_table(SAFETY.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print(table())
    return 0


if __name__ == "__main__":
    sys.exit(main())
