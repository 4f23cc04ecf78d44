"""Output of ``tissueid calibrate list`` and ``show``."""

from __future__ import annotations

from pathlib import Path

from tissueid.calibration.labels import headline_of, notes_of, readable
from tissueid.cli.output import check_json, human_output, table, write_json
from tissueid.messages import stored
from tissueid.procedures.calibration_queries import (
    CalibrationListPlan,
    ListedCalibration,
    ShowCalibrationPlan,
    listed_calibrations,
    saved_calibration,
)


def print_calibrations(plan: CalibrationListPlan, json_file: Path | None) -> None:
    """Print all calibrations of a folder, newest first, with their status.

    Raises:
        UnusableInputError: the folder of the plan does not exist, or cannot be read.
    """
    check_json(json_file)
    folder, listed = listed_calibrations(plan)
    out = human_output(json_file, width=120)
    rows = table(f"Calibrations in {folder}", "file", "serial number", "kind", "date", "status")
    for column in rows.columns:
        column.justify = "left"
    for item in listed:
        found, words = item.calibration, item.status.words
        cells = ("", "", "") if found is None else (found.serial_number, found.kind, found.date[:10])
        rows.add_row(item.path.name, *cells, f"{words}; the newest that passed" if item.newest else words)
    if folder is None:
        out.print(
            "there are no calibrations yet: run 'tissueid calibrate static', or choose another folder by "
            "--calibrations DIR",
            markup=False,
        )
    elif not listed:
        out.print(f"there are no calibrations in {folder}", markup=False, soft_wrap=True)
    else:
        out.print(rows)
    if json_file is not None:
        answers = [_answer(item) for item in listed]
        write_json(json_file, {"folder": None if folder is None else str(folder), "calibrations": answers})


def _answer(item: ListedCalibration) -> dict[str, object]:
    found, status = item.calibration, item.status
    return {
        "file": str(item.path),
        "serial_number": found.serial_number if found else None,
        "model": found.model if found else None,
        "kind": found.kind if found else None,
        "date": found.date if found else None,
        "verdict": found.verdict if found else None,
        "state": status.state,
        "words": status.words,
        "message": stored(status.words),
        "newest_that_passed": item.newest,
    }


def print_calibration(plan: ShowCalibrationPlan, json_file: Path | None) -> None:
    """Print one calibration: instrument, date, verdict, all values.

    Raises:
        UnusableInputError: the file is not a calibration, or the report cannot be written.
    """
    check_json(json_file)
    calibration = saved_calibration(plan)
    out = human_output(json_file, width=120)
    out.print(
        f"{calibration.kind} calibration of {calibration.model}, {calibration.serial_number}, {calibration.date}, "
        f"by {calibration.software}",
        markup=False,
        soft_wrap=True,
    )
    rows = table("", "quantity", "value", "unit")
    for name, quantity in calibration.quantities.items():
        rows.add_row(*readable(name, quantity))
    out.print(rows)
    out.print(headline_of(calibration), markup=False)
    for line in (*calibration.problems, *notes_of(calibration)):
        out.print(f"- {line}", markup=False, soft_wrap=True)
    if json_file is not None:
        write_json(json_file, calibration.model_dump(mode="json"))
