"""Runs every fault in every state and shows what came of it, as the table of docs/safety.md.

Without options it prints the table; ``--write`` puts it into the document between its marks. Status 1 when a cell
fails.
"""

from __future__ import annotations

import argparse
import faulthandler
import logging
import re
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from faults.cells import ORDEALS, STATES, Outcome, run_cell  # noqa: E402

SAFETY = ROOT / "docs" / "safety.md"
PLACE = re.compile(r"(<!-- matrix -->).*?(<!-- end -->)", re.DOTALL)
LONGEST_CELL_S = 120.0
"""Timeout of a cell, s of wall-clock time; a cell that exceeds it prints its stack and fails."""

INTRODUCTION = (
    "",
    "A number: the test was aborted; time in ms from the start of the fault until the coil was released. `goes on`:",
    "the test was completed; lost samples are marked as not received. In every cell the coil stayed within its limits,",
    "all recorded samples are in the session, the message is one line that says what to do, and after the fault the",
    "same program opened the instrument again and completed a test.",
    "",
    "A lasting fault that begins while nothing is played counts from the start of the next test. Under a constant",
    "force a frozen sensor cannot be detected: in `preload`, `checking` and `calibrating` it is detected when the",
    "force changes. With a frozen temperature sensor the test continues under the thermal models of both sides. A host",
    "that receives nothing sends no heartbeat, so the watchdog releases the coil before the host ends the test.",
    "",
)


def outcome(cell: tuple[str, str]) -> Outcome:
    """Return the outcome of one cell, run in a separate process."""
    logging.disable(logging.CRITICAL)
    faulthandler.dump_traceback_later(LONGEST_CELL_S, exit=True)
    try:
        with tempfile.TemporaryDirectory() as folder:
            return run_cell(*cell, Path(folder))
    finally:
        faulthandler.cancel_dump_traceback_later()


def shown(found: Outcome) -> str:
    """Return the text of one cell of the table."""
    if found.problems:
        return "**failed**"
    if found.message is not None:
        milliseconds = 1e3 * found.energised_s
        return f"{milliseconds:.1f}" if 0.0 < milliseconds < 10.0 else f"{milliseconds:.0f}"
    return f"goes on, {found.lost_samples} lost" if found.lost_samples else "goes on"


def table(found: dict[tuple[str, str], Outcome]) -> str:
    """Return all cells as Markdown, and the messages."""
    tolerated = [name for name in ORDEALS if all(shown(found[name, state]).startswith("goes on") for state in STATES)]
    lines = [*INTRODUCTION, f"| | {' | '.join(STATES)} |", f"| --- |{' --- |' * len(STATES)}"]
    lines += [
        f"| {name} | {' | '.join(shown(found[name, state]) for state in STATES)} |"
        for name in ORDEALS
        if name not in tolerated
    ]
    lines += ["", "| fault with which the test goes on in every state | most samples lost |", "| --- | --- |"]
    lines += [f"| {name} | {max(found[name, state].lost_samples for state in STATES)} |" for name in tolerated]
    lines += ["", "States: " + "; ".join(f"*{name}*, {standing.what}" for name, standing in STATES.items()) + "."]
    faults: dict[str, dict[str, None]] = {}
    for name in ORDEALS:
        for state in STATES:
            message = found[name, state].message
            if message is not None:
                faults.setdefault(message.replace("loopback", "PORT"), {})[name] = None
    lines += ["", "| message | faults |", "| --- | --- |"]
    lines += [f"| {message} | {'; '.join(names)} |" for message, names in faults.items()]
    worst = max(item.wait_s for item in found.values())
    lines += ["", f"Longest time that the host waited before it continued or aborted: {worst:.2f} s."]
    return "\n".join(lines)


def main() -> int:
    """Run, print or write; 1 when a cell fails."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="put the table into docs/safety.md")
    parser.add_argument("--processes", type=int, default=1, help="how many cells at a time")
    options = parser.parse_args()
    cells = [(name, state) for name in ORDEALS for state in STATES]
    with ProcessPoolExecutor(options.processes) as pool:
        found = dict(zip(cells, pool.map(outcome, cells), strict=True))
    failed = [(cell, problem) for cell, item in found.items() for problem in item.problems]
    for (name, state), problem in failed:
        print(f"{name}, {state}: {problem}", file=sys.stderr)
    text = table(found)
    if not options.write:
        print(text)
    else:
        page = SAFETY.read_text(encoding="utf-8") if SAFETY.exists() else "# Safety\n"
        if not PLACE.search(page):
            page += "\n<!-- matrix -->\n<!-- end -->\n"
        SAFETY.write_text(PLACE.sub(lambda marks: f"{marks[1]}\n{text}\n{marks[2]}", page), encoding="utf-8")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
