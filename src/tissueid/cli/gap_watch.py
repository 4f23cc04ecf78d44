"""``tissueid gap watch``: the gap of the sessions of a folder over time, against an accepted twin."""

from __future__ import annotations

from pathlib import Path

from rich.table import Table

from tissueid.cli.output import check_json, console_control, human_output, table, write_json
from tissueid.gap.history import GapHistory, GapHistoryEntry, history_headline
from tissueid.messages import MISSING
from tissueid.procedures.gap_folder import watch_folder
from tissueid.procedures.gap_plans import WatchPlan
from tissueid.procedures.output_files import check_different


def run_watch(plan: WatchPlan, json_file: Path | None) -> None:
    """Diagnose the sessions, print them in order of time, and write the requested files.

    Raises:
        UnusableInputError: the twin, every session, or an option cannot be used.
    """
    check_json(json_file)
    check_different(json_file, plan.report)
    with console_control() as control:
        watched = watch_folder(plan, control)
    history, console = watched.history, human_output(json_file)
    console.print(_history_table(history))
    console.print(f"{history_headline(history)[0]}.", markup=False, soft_wrap=True)
    if json_file is not None:
        write_json(json_file, history.as_answer())
    if plan.report is not None:
        console.print(f"report: {plan.report}", markup=False)


def _history_table(history: GapHistory) -> Table:
    rows = table("Gap against the twin", "Session", "Recorded, UTC", "Gap", "Floor", "Result")
    for entry in history.entries:
        cells = [MISSING, MISSING]
        if entry.answer is not None:
            cells = [f"{entry.gap(name):.2%}" for name in ("before", "floor")]
        rows.add_row(entry.file, _date(entry), *cells, _result(entry))
    return rows


def _date(entry: GapHistoryEntry) -> str:
    return MISSING if entry.time is None else f"{entry.time:%Y-%m-%d %H:%M}"


def _result(entry: GapHistoryEntry) -> str:
    if entry.answer is None:
        return entry.reason
    return " + ".join(entry.combination) or str(entry.answer["verdict"]).replace("_", " ")
