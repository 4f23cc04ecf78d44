"""Fit the thresholds of the gap's decisions on one simulated laboratory, score them on the other, and the reverse.

    python tools/fit_thresholds.py --first FOLDER ... --second FOLDER ... [--write]

The folders are those of finished checks of each laboratory, recorded by ``tissueid gap blind-check --laboratory NAME
--take-out --keep FOLDER`` (``--skin`` for sets). With ``--write`` those fitted on the first laboratory become the
thresholds of the program.
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
    parser.add_argument("--first", nargs="+", type=Path, metavar="FOLDER", required=True)
    parser.add_argument("--second", nargs="+", type=Path, metavar="FOLDER", required=True)
    parser.add_argument("--write", action="store_true", help="make those of the first laboratory the program's")
    given = parser.parse_args()
    cases = [[case for folder in folders for case in read_decided(folder)] for folders in (given.first, given.second)]
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
            "fitted_on": {"laboratory": "first", "labels_sha256": [seal(folder) for folder in given.first]},
            "scored_on": {"laboratory": "second", "labels_sha256": [seal(folder) for folder in given.second]},
            "thresholds": {name: asdict(fitted[0])[name] for name in (*DECISION, *PROBABILITY)},
            "scores": rows["second"]["fitted on the first"],
        }
        with atomic_file(path) as partial:
            partial.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
        print(f"\nwritten: {path.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
