"""Fit the thresholds of the gap's decisions on one simulated laboratory, score them on the other, and the reverse.

    python tools/fit_thresholds.py FIRST SECOND [--write]

FIRST and SECOND are folders of finished checks, one of each laboratory, recorded by
``tissueid gap blind-check --laboratory NAME --take-out --keep FOLDER``. With ``--write`` those fitted on the first
become the thresholds of the program.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

from tissueid.atomic_write import atomic_file
from tissueid.gap import decision
from tissueid.gap.decision import THRESHOLDS, Thresholds
from tissueid.gap.scenarios import seal
from tissueid.gap.threshold_fit import DECISION, PROBABILITY, fit_thresholds, read_decided, scores


def main() -> int:
    """Print both tables; write the thresholds where asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs=2, type=Path, metavar="FOLDER")
    parser.add_argument("--write", action="store_true", help="make those of the first folder the program's")
    given = parser.parse_args()
    cases = [read_decided(folder) for folder in given.folders]
    fitted = [fit_thresholds(items, Thresholds()) for items in cases]
    sets = {"fitted on the first": fitted[0], "fitted on the second": fitted[1], "the program's": THRESHOLDS}
    for name in (*DECISION, *PROBABILITY):
        print(f"{name:20}", *(f"{getattr(item, name):>8.3g}" for item in sets.values()))
    rows: dict[str, dict[str, dict[str, object]]] = {}
    for place, items in zip(("first", "second"), cases, strict=True):
        tables = {title: scores(items, item) for title, item in sets.items()}
        print(f"\nscored on the {place}: " + ", ".join(tables))
        for figure in tables["the program's"]:
            found = [table[figure] for table in tables.values()]
            print(f"{figure:52}", *(f"{value:>7.3f}" for value, _ in found), f"  ({found[0][1]})")
        rows[place] = {title: {key: list(value) for key, value in table.items()} for title, table in tables.items()}
    if given.write:
        path = Path(decision.__file__).with_name("thresholds.json")
        about = {
            "fitted_on": {"laboratory": "first", "labels_sha256": seal(given.folders[0])},
            "scored_on": {"laboratory": "second", "labels_sha256": seal(given.folders[1])},
            "thresholds": {name: asdict(fitted[0])[name] for name in (*DECISION, *PROBABILITY)},
            "scores": rows["second"]["fitted on the first"],
        }
        with atomic_file(path) as partial:
            partial.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
        print(f"\nwritten: {path.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
