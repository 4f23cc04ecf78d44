"""LVM files as LabVIEW writes them."""

import contextlib

import numpy as np
import pytest
from coded import coded, says
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tissueid.errors import UnusableInputError
from tissueid.messages import code_of
from tissueid.sessions.imports import Choices, Source, import_test, parse_map

VOLTS = [0.1, -0.2, 0.3, 0.4]
NEWTONS = [1.5, 2.5, -3.5, 4.5]
END = "***End_of_Header***"


def file_header(separator="Tab", decimal=".", x_columns="One", multi="Yes"):
    return [
        ("LabVIEW Measurement", ""),
        ("Writer_Version", "2"),
        ("Reader_Version", "2"),
        ("Separator", separator),
        ("Decimal_Separator", decimal),
        ("Multi_Headings", multi),
        ("X_Columns", x_columns),
        ("Time_Pref", "Relative"),
        ("Operator", "x"),
        ("Date", "2009/07/14"),
        ("Time", "12:00:00,5"),
        (END, ""),
        ("", ""),
    ]


def segment_header(start=0.0, step=0.001, samples=4):
    return [
        ("Channels", "2", ""),
        ("Samples", str(samples), str(samples)),
        ("Date", "2009/07/14", "2009/07/14"),
        ("Time", "12:00:00", "12:00:00"),
        ("Y_Unit_Label", "Volts", "Newtons"),
        ("X_Dimension", "Time", "Time"),
        ("X0", str(start), str(start)),
        ("Delta_X", str(step), str(step)),
        (END, "", "", ""),
        ("X_Value", "Drive", "Load cell", "Comment"),
    ]


def body(start=0.0, step=0.001, x_columns="One"):
    rows = []
    for k, (volts, newtons) in enumerate(zip(VOLTS, NEWTONS, strict=True)):
        x = f"{start + k * step:.6f}"
        if x_columns == "Multi":
            rows.append((x, str(volts), x, str(newtons)))
        else:
            rows.append(("" if x_columns == "No" else x, str(volts), str(newtons)))
    return rows


def text(rows, separator="\t", decimal="."):
    lines = []
    for key, *values in rows:
        if key in ("Date", "Time", "Separator", "Decimal_Separator"):
            lines.append(separator.join((key, *values)))
        else:
            lines.append(separator.join((key, *(value.replace(".", decimal) for value in values))))
    return "\n".join(line.replace(".", decimal) if line[:1] in "-0123456789" else line for line in lines) + "\n"


def imported(tmp_path, content, *options, rows="", **more):
    path = tmp_path / "a.lvm"
    path.write_text(content)
    options = options or ("voltage=Drive:V", "force=Load cell")
    return import_test(Source.parsed(f"{path}{rows}"), parse_map(options), Choices(), **more)


@pytest.mark.parametrize("x_columns", ["One", "No", "Multi"])
@pytest.mark.parametrize(
    ("word", "separator", "decimal"), [("Tab", "\t", "."), ("Comma", ",", "."), ("Tab", "\t", ",")]
)
def test_however_it_was_set_up(tmp_path, x_columns, word, separator, decimal):
    head = file_header(word, decimal, x_columns)
    segment = segment_header()
    if x_columns == "Multi":
        segment[-1] = ("X_Value", "Drive", "X_Value", "Load cell", "Comment")
    assert len(head) + len(segment) in (22, 23, 24)
    found = imported(tmp_path, text([*head, *segment, *body(x_columns=x_columns)], separator, decimal))
    np.testing.assert_array_equal(found.test.signals["voltage"], VOLTS)
    np.testing.assert_array_equal(found.test.signals["force"], NEWTONS)
    assert found.test.sample_rate_hz == 1000.0
    assert found.format == "lvm"


def test_segments_that_go_on_are_one_record(tmp_path):
    rows = [*file_header(), *segment_header(), *body(), ("", ""), *segment_header(0.004), *body(0.004)]
    found = imported(tmp_path, text(rows))
    np.testing.assert_array_equal(found.test.signals["force"], NEWTONS * 2)
    assert imported(tmp_path, text(rows), rows="@4:").test.samples == 4


def test_a_gap_between_segments_is_left_empty(tmp_path):
    rows = [*file_header(), *segment_header(), *body(), ("", ""), *segment_header(0.006), *body(0.006)]
    found = imported(tmp_path, text(rows))
    np.testing.assert_array_equal(found.test.signals["force"], [*NEWTONS, np.nan, np.nan, *NEWTONS])
    notice = next(notice for notice in found.notices if code_of(notice) == "import.samples_missing")
    assert says(notice, "import.samples_missing", missing=2)


def test_segments_that_start_anew_are_chosen_by_rows(tmp_path):
    for x_columns in ("One", "No"):
        head = file_header(x_columns=x_columns)
        rows = [*head, *segment_header(), *body(x_columns=x_columns), ("", ""), *segment_header()]
        content = text([*rows, *body(x_columns=x_columns)])
        with pytest.raises(UnusableInputError, check=coded("import.segments", count=2, rows="0, 4")):
            imported(tmp_path, content)
        assert imported(tmp_path, content, rows="@4:8").test.samples == 4


def test_segments_under_one_heading(tmp_path):
    rows = [*file_header(multi="No"), *segment_header(), *body(), ("", ""), *body(0.004)]
    assert imported(tmp_path, text(rows)).test.samples == 8


def test_comments_and_special_blocks_are_no_numbers(tmp_path):
    rows = [*file_header(), *segment_header(), *body()]
    content = text(rows).replace("-0.2\t2.5", "-0.2\t2.5\thit it")
    content = content.replace(f"{END}\n\n", f"{END}\n\n***Start_Special***\nRTS_1\t2\t3\n***End_Special***\n", 1)
    np.testing.assert_array_equal(imported(tmp_path, content).test.signals["force"], NEWTONS)


def test_a_file_that_was_cut_off_is_told(tmp_path):
    found = imported(tmp_path, text([*file_header(), *segment_header(samples=10), *body()]))
    notice = next(notice for notice in found.notices if code_of(notice) == "import.lvm_rows")
    assert says(notice, "import.lvm_rows", announced=10.0, row=0, rows=4)


@pytest.mark.parametrize(
    ("old", "new", "code", "values"),
    [
        ("LabVIEW Measurement", "Something else", "import.lvm_not_one", {}),
        (END, "***", "import.lvm_truncated", {}),
        ("Channels\t2", "Channels\tmany", "import.lvm_channel_count", {"found": "'many'"}),
        ("Channels\t2", "Channels\t99999999999999999999", "import.lvm_channel_count", {}),
        ("Channels\t2", "Channels\t000000002" + 5000 * "0", "import.lvm_channel_count", {}),
        ("-0.2\t2.5", "-0.2\tx", "import.lvm_not_a_number", {"line": 25, "column": 3, "found": "'x'"}),
        ("-0.2\t2.5", "-0.2", "import.lvm_cells", {"column": 3}),
        ("Delta_X\t0.001", "Delta_X\tfast", "import.lvm_value", {"key": "Delta_X", "value": "'fast'"}),
        ("X_Columns\tOne", "X_Columns\tSeven", "import.lvm_x_columns", {}),
        ("Decimal_Separator\t.", "Decimal_Separator\t;", "import.lvm_decimal", {}),
    ],
)
def test_broken_files_are_refused_in_one_line(tmp_path, old, new, code, values):
    content = text([*file_header(), *segment_header(), *body()])
    assert old in content
    with pytest.raises(UnusableInputError, check=coded(code, **values)) as raised:
        imported(tmp_path, content.replace(old, new))
    assert "\n" not in str(raised.value)


def test_no_times_and_no_step(tmp_path):
    content = text([*file_header(x_columns="No"), *segment_header(), *body(x_columns="No")]).replace("Delta_X", "Delta")
    with pytest.raises(UnusableInputError, check=coded("import.lvm_no_time")):
        imported(tmp_path, content)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_is_read_or_refused(tmp_path, data):
    content = text([*file_header(), *segment_header(), *body()])
    at = data.draw(st.integers(0, len(content)))
    length = data.draw(st.integers(0, 40))
    damaged = content[:at] + data.draw(st.text(st.characters(max_codepoint=255), max_size=5)) + content[at + length :]
    with contextlib.suppress(UnusableInputError):
        assert imported(tmp_path, damaged, "voltage=2:V", "force=3:N").test.samples > 0
