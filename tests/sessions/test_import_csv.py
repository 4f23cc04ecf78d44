"""Rows of text from anywhere: however they are written, the numbers come out, or one line says why not."""

import contextlib
import csv

import numpy as np
import pytest
from coded import coded, holding, says
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tissueid.errors import UnusableInputError
from tissueid.messages import code_of
from tissueid.sessions.imports import Choices, Source, import_test, parse_map

FORCE = [0.5, 1.25, -3.0, 2.5]
POSITION = [0.001, 0.002, 0.0035, 0.004]
MAP = ["force=force:N", "position=position:m"]


def imported(path, *options, rows="", choices=Choices(), **more):  # noqa: B008
    return import_test(Source.parsed(f"{path}{rows}"), parse_map(options) if options else None, choices, **more)


def written(tmp_path, text, name="a.csv", encoding="utf-8"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return path


def table(delimiter=",", decimal=".", head="time,force,position"):
    lines = [head.replace(",", delimiter)] if head else []
    for k, (f, x) in enumerate(zip(FORCE, POSITION, strict=True)):
        lines.append(delimiter.join(str(v).replace(".", decimal) for v in (0.01 * k, f, x)))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        (table(), "utf-8"),
        (table(";"), "utf-8"),
        (table("\t"), "utf-8"),
        (table("|"), "utf-8"),
        (table("  "), "utf-8"),
        (table(";", ","), "utf-8"),
        (table("\t", ","), "utf-8"),
        (table(), "utf-8-sig"),
        (table(), "utf-16"),
        (table().replace("\n", "\r\n"), "utf-8"),
        (table().rstrip("\n"), "utf-8"),
        ("Prüfstand 3\nRate: 100\n\n" + table(), "latin-1"),
        ("# made by X\n# time,force,position\n" + table(head=""), "utf-8"),
        ("% x\n" + table(), "utf-8"),
        (table().replace("\n", ",\n"), "utf-8"),
        ("\n".join(",".join(f'"{c}"' for c in row.split(",")) for row in table().splitlines()), "utf-8"),
        ("\n".join(";".join(f'"{c}"' for c in row.split(";")) for row in table(";", ",").splitlines()), "utf-8"),
        (table() + "\n\n", "utf-8"),
    ],
)
def test_however_it_is_written(tmp_path, text, encoding):
    found = imported(written(tmp_path, text, encoding=encoding), *MAP)
    np.testing.assert_array_equal(found.test.signals["force"], FORCE)
    np.testing.assert_array_equal(found.test.signals["position"], POSITION)
    assert found.test.sample_rate_hz == 100.0
    assert found.rows == range(4)


def test_quoted_decimal_commas_between_commas(tmp_path):
    rows = ["time,force,position"]
    for k, (f, x) in enumerate(zip(FORCE, POSITION, strict=True)):
        rows.append(",".join('"' + str(v).replace(".", ",") + '"' for v in (0.01 * k, f, x)))
    found = imported(written(tmp_path, "\n".join(rows)), *MAP)
    np.testing.assert_array_equal(found.test.signals["force"], FORCE)


def test_without_a_header_columns_have_numbers(tmp_path):
    path = written(tmp_path, table(head=""))
    found = imported(path, "force=2:N", "position=3:mm", "time=1:s")
    np.testing.assert_array_equal(found.test.signals["position"], np.array(POSITION) / 1000)
    with pytest.raises(UnusableInputError, check=coded("import.no_column_number", number=4, count=3)):
        imported(path, "force=2:N", "position=4:m", rate_hz=100.0)
    with pytest.raises(UnusableInputError, check=coded("import.no_column_number")):
        imported(path, "force=0:N", "position=3:m", rate_hz=100.0)


@pytest.mark.parametrize(
    "head",
    [
        "Time (ms);Force [mN];Position (µm)",
        "t_ms;force_mN;position_um",
        "time/ms;force/mN;position/um",
        "time, ms;force, mN;position, um",
        "Time;Force;Position\nms;mN;µm",
        "Time;Force;Position\n(ms);(millinewtons);(microns)",
    ],
)
def test_units_in_the_header(tmp_path, head):
    found = imported(written(tmp_path, head + "\n0;1500;20\n2;-500;50\n4;0;70\n"), "force=force", "position=position")
    assert found.test.sample_rate_hz == 500.0
    np.testing.assert_array_equal(found.test.signals["force"], [1.5, -0.5, 0.0])
    np.testing.assert_array_equal(found.test.signals["position"], [2e-5, 5e-5, 7e-5])


@pytest.mark.parametrize(
    ("role", "unit", "value", "si"),
    [
        ("force", "mN", 3.0, 0.003),
        ("force", "gf", 1000.0, 9.80665),
        ("voltage", "mV", 7.0, 0.007),
        ("current", "mA", 7.0, 0.007),
        ("position", "mm", 3.0, 0.003),
        ("position", "um", 3.0, 0.000003),
        ("position", "in", 1.0, 0.0254),
        ("temperature", "degC", 21.5, 21.5),
        ("temperature", "K", 273.15, 0.0),
        ("acceleration_x", "g", 1.0, 9.80665),
        ("input", "mV", 7.0, 0.007),
        ("output", "kPa", 2.0, 2000.0),
    ],
)
def test_units_become_si(tmp_path, role, unit, value, si):
    other = "command" if role != "command" else "force"
    path = written(tmp_path, f"a,b\n{value},1\n{value},2\n")
    found = imported(path, f"{role}=a:{unit}", f"{other}=b:V", rate_hz=50.0)
    assert found.test.signals[role][0] == si


def test_blank_cells_and_words_for_missing_are_nan_and_stay(tmp_path):
    path = written(tmp_path, "time,force,position\n0,1,1\n0.01,,nan\n0.02,N/A,-\n0.03,4,4\n")
    found = imported(path, *MAP).test.signals
    np.testing.assert_array_equal(found["force"], [1, np.nan, np.nan, 4])
    np.testing.assert_array_equal(found["position"], [1, np.nan, np.nan, 4])


def test_a_column_of_text_that_is_not_asked_for(tmp_path):
    path = written(tmp_path, "when,force,position\n2026-01-01 10:00:00,1.5,2\n2026-01-01 10:00:01,2.5,3\n")
    found = imported(path, *MAP, rate_hz=10.0)
    np.testing.assert_array_equal(found.test.signals["force"], [1.5, 2.5])
    with pytest.raises(UnusableInputError, check=coded("import.contradiction", column="when", stated="s", used="N")):
        imported(path, "force=when:N", "position=position:m", rate_hz=10.0)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [("@0:2", [0, 1]), ("@1:", [1, 2, 3]), ("@:-1", [0, 1, 2]), ("@-2:", [2, 3]), ("@:", [0, 1, 2, 3])],
)
def test_rows_are_selected_as_slices_have_them(tmp_path, rows, expected):
    found = imported(written(tmp_path, table()), *MAP, rows=rows)
    np.testing.assert_array_equal(found.test.signals["force"], np.array(FORCE)[expected])
    assert list(found.rows) == expected


@pytest.mark.parametrize(
    ("rows", "code"),
    [
        ("@0:5", "import.row_beyond"),
        ("@4:", "import.no_rows"),
        ("@2:2", "import.no_rows"),
        ("@3:1", "import.no_rows"),
        ("@-5:", "import.row_beyond"),
    ],
)
def test_rows_that_are_not_there(tmp_path, rows, code):
    with pytest.raises(UnusableInputError, check=holding(code)):
        imported(written(tmp_path, table()), *MAP, rows=rows)


def test_a_file_may_be_named_like_a_selection(tmp_path):
    found = imported(written(tmp_path, table(), name="a.csv@0:2"), *MAP)
    assert found.test.samples == 4


def test_a_footer_is_left_out_by_rows(tmp_path):
    path = written(tmp_path, table() + "end of test\n")
    with pytest.raises(UnusableInputError, check=coded("import.cells", line=6, cells=1, others=3)):
        imported(path, *MAP)
    assert imported(path, *MAP, rows="@:4").test.samples == 4


@pytest.mark.parametrize(
    ("content", "code", "values"),
    [
        (b"", "file.empty", {}),
        (bytes(range(256)) * 40, "import.not_text", {}),
        (b"PK\x03\x04 sheet", "import.spreadsheet", {}),
        (b"hello\nworld\n", "import.no_columns", {}),
        (b"1\n2\n3\n", "import.no_columns", {}),
        (b"force,position\n", "import.no_columns", {}),
        (b"force,position\n1,2\n3\n", "import.cells", {"line": 3, "cells": 1, "others": 2}),
        (b"force,position\n1,2\n3,4,5\n", "import.cells", {"line": 3, "cells": 3}),
        (b"force,position\n1,2\n3,four\n", "import.not_a_number", {"line": 3, "column": 2, "found": "'four'"}),
        (b"force,position\n1,2\n3,4_000\n", "import.not_a_number", {"found": "'4_000'"}),
        (b"force,position\n1,2\n3,0x10\n", "import.not_a_number", {"found": "'0x10'"}),
        (b"force,position\n,2\n,4\n", "import.no_numbers", {"role": "force", "samples": 2}),
        (b"force,force,position\n1,2,3\n", "import.column_ambiguous", {"numbers": "1, 2"}),
        (b"load,position\n1,2\n", "import.no_column", {"columns": "1 'load', 2 'position'"}),
        (b"\xff\xfe\x00", "import.no_columns", {}),
    ],
)
def test_an_unusable_file_is_refused_in_one_line(tmp_path, content, code, values):
    path = written(tmp_path, content)
    with pytest.raises(UnusableInputError, check=coded(code, path=str(path), **values)) as raised:
        imported(path, *MAP, rate_hz=100.0)
    assert str(raised.value).startswith(str(path))
    assert "\n" not in str(raised.value)


def test_formats_that_can_contain_programs_are_not_read(tmp_path):
    with pytest.raises(UnusableInputError, check=coded("import.program")):
        imported(written(tmp_path, b"\x80\x04K\x01.", name="a.pkl"), *MAP)
    with pytest.raises(UnusableInputError, check=coded("import.not_text")):
        imported(written(tmp_path, b"\x80\x04\x00K\x01.", name="a.csv"), *MAP)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["force"], "ROLE=COLUMN:UNIT"),
        (["force="], "ROLE=COLUMN:UNIT"),
        (["torque=1:N", "force=2:N"], "knows no 'torque'"),
        (["force=1:N"], "at least two signals"),
        (["force=1:N", "time=2:s"], "at least two signals"),
        (["force=1:N", "force=2:N"], "says twice"),
    ],
)
def test_mappings_that_cannot_be(options, words):
    with pytest.raises(UnusableInputError, match=words):
        parse_map(options)


def test_units_that_cannot_be():
    with pytest.raises(UnusableInputError, check=coded("import.wrong_unit", role="force", expected="N", unit="mm")):
        parse_map(["force=1:mm", "position=2:m"])
    for unit in ("furlong", "MN"):
        with pytest.raises(UnusableInputError, check=coded("import.unknown_unit", unit=unit)):
            parse_map([f"force=1:{unit}", "position=2:m"])


def test_one_column_for_two_signals(tmp_path):
    with pytest.raises(UnusableInputError, check=coded("import.column_twice", column="force")):
        imported(written(tmp_path, table()), "force=2:N", "command=force:V")


@pytest.mark.parametrize(
    ("options", "scale", "values"),
    [
        (
            ["force=force:N", "position=position:mm"],
            (1000, 1),
            {"role": "force", "low": -3000.0, "high": 2500.0, "others": "mN, gf"},
        ),
        (
            ["force=force:mN", "position=position:mm"],
            (1, 1),
            {"role": "force", "unit": "mN", "others": "N, gf, kgf, lbf"},
        ),
        (
            ["force=force:N", "position=position:m"],
            (1, 1),
            {"role": "position", "low": 0.1, "others": "cm, mm, mil"},
        ),
        (
            ["force=force:N", "position=position:um"],
            (1, 1),
            {"role": "position"},
        ),
        (["current=force:A", "position=position:mm"], (100, 1), {"role": "current", "others": "mA"}),
    ],
)
def test_implausible_sizes_are_reported(tmp_path, options, scale, values):
    rows = [f"{0.001 * k},{scale[0] * f},{x}" for k, (f, x) in enumerate([(-3, 0.1), (2.5, 9.1), (1, 3)])]
    found = imported(written(tmp_path, "time,force,position\n" + "\n".join(rows)), *options)
    notice = next(
        notice
        for notice in found.notices
        if code_of(notice) == "import.implausible" and notice.values["role"] == values["role"]
    )
    assert says(notice, "import.implausible", **values)


def test_honest_sizes_are_not_doubted(tmp_path):
    found = imported(written(tmp_path, "time,force,position\n0,1,1\n0.01,9,4\n0.02,3,2\n"), *MAP[:1], "position=3:mm")
    (notice,) = found.notices
    assert says(notice, "import.time_found", column="time", unit="s")


def test_a_unit_that_contradicts_the_header_is_refused_unless_it_is_insisted_on(tmp_path):
    path = written(tmp_path, "t_s,force_mN,position_mm\n0,1,1\n0.01,9,4\n")
    with pytest.raises(UnusableInputError, check=coded("import.contradiction", stated="mN", used="N")):
        imported(path, "force=force:N", "position=position:mm")
    found = imported(path, "force=force:N!", "position=position:mm")
    assert list(found.test.signals["force"]) == [1.0, 9.0]
    notice = next(notice for notice in found.notices if code_of(notice) == "import.other_unit")
    assert says(notice, "import.other_unit", role="force", stated="mN", used="N")


def test_provenance_without_the_name_of_the_file(tmp_path):
    path = written(tmp_path, table(), name="john-doe.csv")
    notes = imported(path, *MAP, rows="@1:3").test.notes
    assert notes["source_rows"] == "1:3"
    assert notes["source_format"] == "csv"
    assert len(str(notes["source_sha256"])) == 64
    assert "john" not in str(notes)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=400))
def test_any_bytes_are_read_or_refused(tmp_path, content):
    path = written(tmp_path, content)
    with contextlib.suppress(UnusableInputError):
        assert imported(path, "force=1:N", "position=2:m", rate_hz=10.0).test.samples > 0


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    rows=st.lists(st.tuples(st.floats(-1e9, 1e9), st.floats(-1e9, 1e9)), min_size=2, max_size=20),
    delimiter=st.sampled_from([",", ";", "\t", "|"]),
    decimal=st.sampled_from([".", ","]),
)
def test_every_number_comes_back(tmp_path, rows, delimiter, decimal):
    path = tmp_path / "a.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(["force", "position"])
        writer.writerows([f"{v:.17e}".replace(".", decimal) for v in row] for row in rows)
    found = imported(path, *MAP, rate_hz=10.0).test.signals
    np.testing.assert_array_equal(found["force"], [row[0] for row in rows])
    np.testing.assert_array_equal(found["position"], [row[1] for row in rows])
