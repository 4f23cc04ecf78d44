"""``tissueid calibrate list`` and ``show``: list and show calibrations."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from tissueid.calibration.file import Calibration, read_calibration
from tissueid.calibration.labels import headline_of, notes_of, readable
from tissueid.calibration.status import FileStatus, file_status
from tissueid.calibration.store import calibration_folder, stored_calibrations
from tissueid.cli.output import check_json, human_output, message_json, table, write_json
from tissueid.procedures.calibration_files import write_calibration_report
from tissueid.procedures.output_files import HTML, check_new, check_output


def list_calibrations(folder: Path | None, serial: str | None, json_file: Path | None) -> None:
    """Print all calibrations of a folder, newest first, with their status.

    Which of them an instrument uses also depends on its nominal values: it can refuse a calibration.
    """
    check_json(json_file)
    chosen = calibration_folder(folder)
    now = datetime.now(UTC)
    out = human_output(json_file)
    if not out.is_terminal:
        out.width = 120
    rows = table(f"Calibrations in {chosen}", "file", "serial number", "kind", "date", "status")
    for column in rows.columns:
        column.justify = "left"
    answers: list[dict[str, object]] = []
    newest: set[tuple[str, str]] = set()
    for item in stored_calibrations(chosen):
        found = item.calibration
        if serial is not None and (found is None or found.serial_number != serial):
            continue
        age = file_status(item, now)
        key = ("", "") if found is None else (found.serial_number, found.kind)
        is_newest = age.usable and key not in newest
        if is_newest:
            newest.add(key)
        words = f"{age.words}; the newest that passed" if is_newest else age.words
        rows.add_row(
            item.path.name,
            found.serial_number if found else "",
            found.kind if found else "",
            found.date[:10] if found else "",
            words,
        )
        answers.append(_listed(item.path, found, age, is_newest))
    if chosen is None:
        out.print(
            "there are no calibrations yet: run 'tissueid calibrate static', or choose another folder by "
            "--calibrations DIR",
            markup=False,
        )
    elif not answers:
        out.print(f"there are no calibrations in {chosen}", markup=False, soft_wrap=True)
    else:
        out.print(rows)
    if json_file is not None:
        write_json(json_file, {"folder": None if chosen is None else str(chosen), "calibrations": answers})


def _listed(path: Path, found: Calibration | None, age: FileStatus, is_newest: bool) -> dict[str, object]:
    return {
        "file": str(path),
        "serial_number": found.serial_number if found else None,
        "model": found.model if found else None,
        "kind": found.kind if found else None,
        "date": found.date if found else None,
        "verdict": found.verdict if found else None,
        "state": age.state,
        "words": age.words,
        "message": message_json(age.words),
        "newest_that_passed": is_newest,
    }


def show_calibration(file: Path, report: Path | None, json_file: Path | None) -> None:
    """Print one calibration: instrument, date, verdict, all values."""
    check_json(json_file)
    check_output(report, HTML)
    check_new(report)
    calibration = read_calibration(file)
    out = human_output(json_file)
    if not out.is_terminal:
        out.width = 120
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
    if report is not None:
        write_calibration_report(calibration, report)
    if json_file is not None:
        write_json(json_file, calibration.model_dump(mode="json"))
