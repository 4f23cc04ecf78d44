"""``tissueid devices``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from tissueid.cli.output import console, table, write_json
from tissueid.instrument import find_instruments

_ANSWERS = {True: "yes", False: "no", None: "not asked"}


def list_devices(probe: bool, json_file: Path | None) -> None:
    """Print what was found, and why what did not answer did not."""
    found = find_instruments(probe=probe)
    rows = table("Instruments", "device", "what", "answers")
    for column in rows.columns:
        column.justify = "left"
    for item in found:
        rows.add_row(item.url, item.detail if item.answers and item.detail else item.what, _ANSWERS[item.answers])
    console.print(rows)
    for item in found:
        if item.answers is False:
            console.print(item.detail, markup=False)
    if json_file is not None:
        write_json(json_file, [asdict(item) for item in found])
