"""``tissueid devices``: list instruments."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from tissueid.cli.output import check_json, human_output, table, write_json
from tissueid.procedures.instrument_queries import DevicesPlan, listed_instruments

_ANSWERS = {True: "yes", False: "no", None: "not probed"}


def list_devices(plan: DevicesPlan, json_file: Path | None) -> None:
    """Print the instruments that were found, and why some did not answer."""
    check_json(json_file)
    found = listed_instruments(plan)
    out = human_output(json_file)
    rows = table("Instruments", "device", "what", "answers")
    for column in rows.columns:
        column.justify = "left"
    for item in found:
        what = f"{item.what}: {item.detail}" if item.answers and item.detail else item.what
        rows.add_row(item.url, what, _ANSWERS[item.answers])
    out.print(rows)
    for item in found:
        if item.answers is False:
            out.print(item.detail, markup=False)
    if json_file is not None:
        write_json(json_file, [asdict(item) for item in found])
