"""Fit the thresholds of the gap's decisions on one simulated laboratory, score them on the other, and the reverse.

    python tools/fit_thresholds.py --first FOLDER ... --second FOLDER ...

The folders are those of finished checks of each laboratory, recorded by ``tissueid gap blind-check --laboratory NAME
--take-out --keep FOLDER`` (``--skin`` for sets). The first tables compare the fits with the thresholds of the program;
the last shows how the objective of both laboratories together depends on each threshold.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tissueid.gap.thresholds import THRESHOLDS
from tissueid_lab.blind_check.answers import seal
from tissueid_lab.blind_check.threshold_fit import (
    DECISION,
    PROBABILITY,
    changed,
    fit_thresholds,
    read_decided,
    scores,
    value,
)


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", nargs="+", type=Path, metavar="FOLDER", required=True)
    parser.add_argument("--second", nargs="+", type=Path, metavar="FOLDER", required=True)
    given = parser.parse_args()
    cases = [[case for folder in folders for case in read_decided(folder)] for folders in (given.first, given.second)]
    fitted = [fit_thresholds(items) for items in cases]
    sets = {"fitted on the first": fitted[0], "fitted on the second": fitted[1], "the program's": THRESHOLDS}
    for name in (*DECISION, *PROBABILITY):
        print(f"{name:20}", *(f"{getattr(item, name):>8.3g}" for item in sets.values()))
    for place, items, folders in zip(("first", "second"), cases, (given.first, given.second), strict=True):
        tables = {title: scores(items, item) for title, item in sets.items()}
        print(f"\nscored on the {place}: {', '.join(tables)} (labels {', '.join(map(seal, folders))})")
        for figure in tables["the program's"]:
            found = [table[figure] for table in tables.values()]
            print(f"{figure:52}", *(f"{value:>7.3f}" for value, _ in found), f"  ({found[0][1]})")
    print("\nobjective of both laboratories by threshold, the others as in the program")
    for name, grid in DECISION.items():
        tried = ((item, sum(value(items, changed(THRESHOLDS, name, item)) for items in cases)) for item in grid)
        print(f"{name:20}", "  ".join(f"{item:g}: {reached:.3f}" for item, reached in tried))
    return 0


if __name__ == "__main__":
    sys.exit(main())
