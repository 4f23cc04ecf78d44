"""The date of an imported record, and what cannot be known of the instrument that recorded it."""

import os
from datetime import UTC, datetime

import numpy as np
import pytest
from scipy.io import savemat

from tissueid.acquisition.quality import judge_session
from tissueid.app.views.technician.checkup import background
from tissueid.sessions import read_session
from tissueid.sessions.imports import Choices, Source, import_session, parse_map
from tissueid.sessions.imports.imported_test import recording_date

COLUMNS = parse_map(["time=1:s", "force=2:N", "position=3:mm"])
LVM = "LabVIEW Measurement\nSeparator\tTab\nDate\t2009/07/14\nTime\t12:00:00,5\n***End_of_Header***\n\nChannels\t2\n"


def utc(*parts):
    return datetime(*parts).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


@pytest.mark.parametrize(
    ("text", "date"),
    [
        (LVM, (2009, 7, 14, 12, 0, 0)),
        (LVM + "Date\t2009/07/15\t2009/07/15\nTime\t08:30:05.25\t08:30:05.25\n", (2009, 7, 15, 8, 30, 5)),
        (LVM + "X_Value\tDrive\n1\nDate\t2011/01/01\n", (2009, 7, 14, 12, 0, 0)),
        (LVM.replace("2009", "1904"), None),
        (LVM.replace("07/14", "17/14"), None),
        ("LabVIEW Measurement\n", None),
    ],
)
def test_the_date_in_the_header_of_an_lvm_file(tmp_path, text, date):
    path = tmp_path / "one.lvm"
    path.write_text(text)
    os.utime(path, (1.2e9, 1.2e9))
    wanted = (utc(*date), "header") if date else ("2008-01-10T21:20:00Z", "modified")
    assert recording_date(path, "lvm") == wanted


@pytest.mark.parametrize("head", ["Mon Nov  3 09:14:02 2025", "Mon Foo  3 09:14:02 2025", "Mon Feb 30 09:14:02 2025"])
def test_the_date_in_the_header_of_a_mat_file(tmp_path, head):
    path = tmp_path / "one.mat"
    savemat(path, {"x": np.zeros(3)})
    data = bytearray(path.read_bytes())
    data[:116] = f"MATLAB 5.0 MAT-file, Platform: PCWIN64, Created on: {head}".ljust(116).encode()
    path.write_bytes(data)
    assert recording_date(path, "mat") == (
        (utc(2025, 11, 3, 9, 14, 2), "header") if "Nov" in head else recording_date(path, "csv")
    )


@pytest.fixture
def imported(tmp_path):
    paths = [tmp_path / "later.csv", tmp_path / "earlier.csv"]
    for path, moment in zip(paths, (1.3e9, 1.2e9), strict=True):
        t = np.arange(3000) / 1000.0
        rows = np.column_stack([t, 2.0 + np.sin(30.0 * t) + np.sin(171.0 * t), 0.1 * np.sin(30.0 * t)])
        np.savetxt(path, rows, delimiter=",", header="Zeit,Kraft,Weg", comments="")
        os.utime(path, (moment, moment))
    sources = [Source.parsed(str(path)) for path in paths]
    import_session(sources, COLUMNS, [Choices()] * 2, tmp_path / "made.h5")
    return tmp_path / "made.h5"


def test_a_session_of_records_has_the_earliest_of_their_dates(imported):
    session = read_session(imported)
    assert session.created == "2008-01-10T21:20:00Z"
    assert [test.notes["source_date"] for test in session.tests] == ["modified", "modified"]


def test_what_cannot_be_known_of_an_unknown_instrument_is_not_judged(imported):
    for _, quality in judge_session(read_session(imported)):
        assert not {"calibration_none", "end_of_stroke"} & {finding.code for finding in quality.findings}


def test_an_imported_record_says_nothing_of_the_cable(imported, tmp_path):
    assert background(tmp_path, tmp_path / "none", tmp_path / "audit.jsonl", lambda: None).last is None
