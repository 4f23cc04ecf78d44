"""Records as other programs write them: read with the right values, or refused; never silently wrong."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from tests.coded import coded
from tissueid.errors import UnusableInputError
from tissueid.messages import code_of
from tissueid.sessions.imports import Choices, Source, import_test, parse_map

POUND, INCH = 4.4482216152605, 0.0254
ROWS = 40
TIMES = np.arange(ROWS)
FORCES = np.round(1 + 0.5 * np.sin(0.3 * TIMES), 4)
POSITIONS = np.round(2 + 1.5 * np.sin(0.3 * TIMES - 0.3), 4)


@pytest.fixture
def read(tmp_path):
    """A function that imports a text, of a file with a name, by --map options."""

    def imported(text, *options, name="a.csv", rows="", **more):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return import_test(Source.parsed(f"{path}{rows}"), parse_map(options), Choices(), **more)

    return imported


def table(head, *columns, delimiter=","):
    return "\n".join([head, *(delimiter.join(map(str, row)) for row in zip(*columns, strict=True))]) + "\n"


def values(found, name):
    return found.test.signals[name]


# -- LVM ---------------------------------------------------------------------------------------------------------------


def lvm(header, segment, heads, rows):
    lines = ["LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab", "Decimal_Separator\t.", *header]
    lines += ["***End_of_Header***\t", "", *segment, "***End_of_Header***\t\t", heads, *rows]
    return "\n".join(lines) + "\n"


def multi(spaced):
    """Three channels with their own times; the header has a cell for each column, or for each channel."""
    gap = "\t\t" if spaced else "\t"
    columns = [FORCES, 2000 * FORCES, POSITIONS]
    segment = [
        "Channels\t3\t\t\t\t\t",
        *(f"{key}\t{gap.join(cells)}\t" for key, cells in {
            "Samples": [str(ROWS)] * 3,
            "Y_Unit_Label": ["Newtons", "Micrometers", "Millimeters"],
            "X_Dimension": ["Time"] * 3,
            "Delta_X": ["0.001"] * 3,
        }.items()),
    ]  # fmt: skip
    rows = ["\t".join(f"{k / 1000:.6f}\t{column[k]:.4f}" for column in columns) for k in TIMES]
    heads = "X_Value\tLoad cell\tX_Value\tCapacitive\tX_Value\tLVDT\tComment"
    return lvm(["Multi_Headings\tYes", "X_Columns\tMulti"], segment, heads, rows)


@pytest.mark.parametrize("spaced", [True, False])
def test_units_of_channels_with_their_own_times(read, spaced):
    found = read(multi(spaced), "force=Load cell", "position=LVDT", name="a.lvm")
    assert found.test.sample_rate_hz == 1000.0
    np.testing.assert_array_equal(values(found, "force"), FORCES)
    np.testing.assert_array_equal(values(found, "position"), POSITIONS / 1000)
    again = read(multi(spaced), "force=Load cell", "position=LVDT:mm", name="a.lvm")
    np.testing.assert_array_equal(values(again, "position"), POSITIONS / 1000)


def rates(steps):
    segment = ["Channels\t3\t\t", "Samples\t40\t40\t20", "Y_Unit_Label\tNewtons\tMillimeters\tMillimeters\t"]
    segment += ["X_Dimension\tTime\tTime\tTime\t", "X0\t0.0\t0.0\t0.0\t", "Delta_X\t" + "\t".join(steps)]
    rows = [f"\t{FORCES[k]}\t{POSITIONS[k]}\t{POSITIONS[k] if k < 20 else ''}" for k in TIMES]
    return lvm(["Multi_Headings\tYes", "X_Columns\tNo"], segment, "X_Value\tForce\tFast\tSlow\tComment", rows)


def test_channels_of_another_step_are_not_read_at_that_of_the_first(read):
    text = rates(["0.001", "0.001", "0.01"])
    assert read(text, "force=Force", "position=Fast", name="a.lvm").test.sample_rate_hz == 1000.0
    with pytest.raises(UnusableInputError, check=coded("import.lvm_clocks", one="Force", other="Slow")):
        read(text, "force=Force", "position=Slow", name="a.lvm")
    with pytest.raises(UnusableInputError, check=coded("import.lvm_clocks")):
        read(text, "force=Force", "position=Slow", name="a.lvm", rate_hz=1000.0)
    only_slow = read(rates(["0.001", "0.01", "0.01"]), "input=Fast", "output=Slow", name="a.lvm")
    assert only_slow.test.sample_rate_hz == 100.0


def test_several_triggers_under_one_heading_are_segments(read):
    segment = ["Channels\t2\t\t", "Samples\t20\t20\t", "Y_Unit_Label\tNewtons\tMillimeters\t", "X0\t0.0\t0.0\t"]
    rows = [f"\t{FORCES[k]}\t{POSITIONS[k]}" for k in TIMES]
    heads = "X_Value\tForce\tDisp\tComment"
    text = lvm(["Multi_Headings\tNo", "X_Columns\tNo"], [*segment, "Delta_X\t0.001\t0.001\t"], heads, rows)
    with pytest.raises(UnusableInputError, check=coded("import.segments", count=2, rows="0, 20")):
        read(text, "force=Force", "position=Disp", name="a.lvm")
    second = read(text, "force=Force", "position=Disp", name="a.lvm", rows="@20:40")
    np.testing.assert_array_equal(values(second, "force"), FORCES[20:])
    assert second.test.sample_rate_hz == 1000.0


@pytest.mark.parametrize("notes", ["Notes\tvalid for Dev1 only", "Notes\tvalid for\nDev1 only"])
def test_notes_between_the_headers(read, notes):
    segment = [notes, "Channels\t2\t\t", "Samples\t40\t40\t", "Y_Unit_Label\tNewtons\tMillimeters\t"]
    rows = [f"{k * 0.01:.3f}\t{FORCES[k]}\t{POSITIONS[k]}" for k in TIMES]
    text = lvm(["X_Columns\tOne"], [*segment, "Delta_X\t0.01\t0.01\t"], "X_Value\tForce\tPos\tComment", rows)
    found = read(text, "force=Force", "position=Pos", name="a.lvm")
    assert found.test.sample_rate_hz == 100.0
    np.testing.assert_array_equal(values(found, "position"), POSITIONS / 1000)


def test_a_column_of_frequencies_is_no_time(read):
    segment = ["Channels\t2\t\t", "Samples\t40\t40\t", "X_Dimension\tFrequency\tFrequency", "Delta_X\t1.0\t1.0\t"]
    rows = [f"{k:.3f}\t{FORCES[k]}\t{POSITIONS[k]}" for k in TIMES]
    text = lvm(["X_Columns\tOne"], segment, "X_Value\tForce\tPos\tComment", rows)
    with pytest.raises(UnusableInputError, check=coded("import.unit_not_known", unit="Frequency")):
        read(text, "force=Force:N", "position=Pos:mm", name="a.lvm")


# -- time --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("head", "step", "rate_hz"),
    [
        ("Time (minutes)", 0.1 / 60, 10.0),
        ("Time (h)", 0.1 / 3600, 10.0),
        ("Time [msecs]", 0.05, 20_000.0),
        ("Time (usec)", 50.0, 20_000.0),
        ("time_us", 50.0, 20_000.0),
        ("t/ns", 1000.0, 1e6),
        ("Time, Sec", 0.1, 10.0),
        ("TIME (SEC)", 0.1, 10.0),
        ("Elapsed Time (min)", 0.001, 1000 / 60),
        ("t_s", 0.1, 10.0),
        ("Time", 0.1, 10.0),
        ("timestamp", 0.001, 1000.0),
    ],
)
def test_time_in_any_unit(read, head, step, rate_hz):
    quoted = f'"{head}"'
    text = table(f"{quoted},Load (N),Extension (mm)", [f"{k * step:.10g}" for k in TIMES], FORCES, POSITIONS)
    assert read(text, "force=Load", "position=Extension").test.sample_rate_hz == pytest.approx(rate_hz, rel=1e-9)


@pytest.mark.parametrize(
    ("head", "code"),
    [
        ("Time (samples)", "import.unit_not_known"),
        ("Time (mS)", "import.wrong_unit"),
        ("Time (M)", "import.unit_not_known"),
        ("Time (Zeiteinheiten)", "import.unit_not_known"),
        ("Time [scans]", "import.unit_not_known"),
        ("Time (mm)", "import.wrong_unit"),
        ("t/T", "import.wrong_unit"),
    ],
)
def test_a_time_in_what_is_no_unit_is_refused_and_a_rate_reads_it(read, head, code):
    text = table(f"{head},Load (N),Extension (mm)", TIMES, FORCES, POSITIONS)
    with pytest.raises(UnusableInputError, check=coded(code)):
        read(text, "force=Load", "position=Extension")
    assert read(text, "force=Load", "position=Extension", rate_hz=50.0).test.sample_rate_hz == 50.0


@pytest.mark.parametrize("first", [1_732_700_000_000, 45_623.41])
def test_clocks_in_ms_and_days_are_not_read_as_seconds(read, first):
    text = table("timestamp,Load (N),Extension (mm)", first + TIMES / 86_400, FORCES, POSITIONS)
    with pytest.raises(UnusableInputError, check=coded("import.time_unit")):
        read(text, "force=Load", "position=Extension")


@pytest.mark.parametrize("form", ["{:%Y-%m-%dT%H:%M:%S.%f}Z", "{:%Y-%m-%d %H:%M:%S.%f}+01:00", "{:%H:%M:%S.%f}"])
@pytest.mark.parametrize("head", ["timestamp", "Recorded at"])
def test_times_of_iso_8601(read, form, head):
    begin = datetime(2025, 11, 12, 10, 3, 29, 555000)
    stamps = [form.format(begin + timedelta(milliseconds=10 * int(k))) for k in TIMES]
    found = read(table(f"{head},force (N),pos (mm)", stamps, FORCES, POSITIONS), "force=force", "position=pos")
    assert found.test.sample_rate_hz == 100.0
    np.testing.assert_array_equal(values(found, "force"), FORCES)


@pytest.mark.parametrize(
    ("at", "time", "expected"),
    [
        (ROWS, ROWS * 0.1 - 0.018, slice(0, ROWS)),
        (0, -0.0018, slice(0, ROWS)),
        (ROWS, (ROWS - 1) * 0.1, slice(0, ROWS)),
    ],
)
def test_one_odd_row_at_an_end_is_left_out_and_said(read, at, time, expected):
    times, forces, positions = (
        np.insert(column, at, value) for column, value in ((TIMES * 0.1, time), (FORCES, 9.0), (POSITIONS, 9.0))
    )
    text = table("Time (s),Force (N),Position (mm)", [f"{each:.5f}" for each in times], forces, positions)
    found = read(text, "force=Force", "position=Position")
    assert found.test.sample_rate_hz == pytest.approx(10.0)
    np.testing.assert_array_equal(values(found, "force"), FORCES[expected])
    assert next(one for one in found.notices if code_of(one) == "import.odd_row").values["row"] == at
    assert len(found.rows) == ROWS


def test_an_odd_row_in_the_middle_is_refused(read):
    times = np.delete(np.arange(ROWS + 1) * 0.1, 20)
    times[20] -= 0.03
    text = table("Time (s),Force (N),Position (mm)", np.round(times, 5), FORCES, POSITIONS)
    with pytest.raises(UnusableInputError, check=coded("import.irregular")):
        read(text, "force=Force", "position=Position")


# -- numbers -----------------------------------------------------------------------------------------------------------

LOADS = np.round(1500 + 900 * np.sin(0.3 * TIMES))


def grouped(delimiter="\t", sign=",", quote=""):
    numbers = [f"{quote}{load:,.0f}{quote}".replace(",", sign) for load in LOADS]
    return table(delimiter.join(["Reading", "Load (mN)", "Travel (um)"]), TIMES, numbers, numbers, delimiter=delimiter)


@pytest.mark.parametrize(
    "text", [grouped(), grouped(";"), grouped(",", quote='"'), grouped(sign="."), grouped(";", ".")]
)
def test_thousands_that_could_be_decimals_are_asked_about(read, text):
    options = ("force=Load", "position=Travel")
    with pytest.raises(UnusableInputError, check=coded("import.thousands")):
        read(text, *options, rate_hz=100.0)
    found = read(text, *options, rate_hz=100.0, decimal="." if "1,5" in text else ",")
    np.testing.assert_array_equal(values(found, "force"), LOADS / 1000)


def test_the_answer_can_be_decimals(read):
    text = table("Load (N)\tTravel (mm)", [f"{load:,.0f}" for load in LOADS], FORCES.astype(int), delimiter="\t")
    found = read(text, "force=Load", "position=Travel", rate_hz=100.0, decimal=",")
    expected = np.where(LOADS >= 1000, LOADS / 1000, LOADS)
    np.testing.assert_array_equal(values(found, "force"), expected)


def test_thousands_with_decimals_are_read_once_the_sign_is_known(read):
    text = table("Load (N);Travel (mm)", [f"{load:,.2f}" for load in LOADS], FORCES, delimiter=";")
    with pytest.raises(UnusableInputError, check=coded("import.thousands")):
        read(text, "force=Load", "position=Travel", rate_hz=100.0)
    found = read(text, "force=Load", "position=Travel", rate_hz=100.0, decimal=".")
    np.testing.assert_array_equal(values(found, "force"), LOADS)


@pytest.mark.parametrize("decimal", [",", "."])
def test_decimals_of_three_digits_are_read_where_other_cells_show_the_sign(read, decimal):
    loads = [f"{load / 1000:.3f}" for load in LOADS]
    columns = ([f"{k / 1000:.3f}" for k in TIMES], loads, loads)
    text = table("t\tLoad (N)\tTravel (mm)", *columns, delimiter="\t").replace(".", decimal)
    np.testing.assert_array_equal(values(read(text, "force=Load", "position=Travel"), "force"), LOADS / 1000)


@pytest.mark.parametrize("space", ["\u00a0", "\u202f", " "])
def test_spaces_between_thousands_never_make_columns(read, space):
    with pytest.raises(UnusableInputError):
        read(grouped(sign=space), "force=2", "position=3", rate_hz=100.0)


# -- units -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("extra", ["", "N/A", "widgets"])
def test_a_row_of_units_whatever_they_are(read, extra):
    seconds = [f"{k * 0.1:.5f}" for k in TIMES]
    heads = "Specimen,A\n\nTime,Extension,Load,Other\n(s),(in),(lbf)," + (f"({extra})" if extra else "")
    found = read(table(heads, seconds, POSITIONS, FORCES, FORCES), "force=Load", "position=Extension")
    np.testing.assert_allclose(values(found, "force"), FORCES * POUND, rtol=1e-12)
    np.testing.assert_allclose(values(found, "position"), POSITIONS * INCH, rtol=1e-12)
    assert found.test.sample_rate_hz == 10.0


def test_a_row_of_units_with_a_torque(read):
    heads = "Ch 1 Displacement \tCh 1 Force \tCh 2 Torque \tRunning Time \nmm\tkN\tkN·mm\tsec"
    text = table(heads, POSITIONS, FORCES, FORCES, [f"{k * 0.1:.4f}" for k in TIMES], delimiter="\t")
    found = read(text, "force=Ch 1 Force", "position=Ch 1 Displacement", "output=Ch 2 Torque", "time=Running Time")
    np.testing.assert_allclose(values(found, "force"), FORCES * 1000)
    assert found.test.units == {"output": "N m"}
    assert found.test.sample_rate_hz == 10.0


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("lbf", POUND),
        ("LBF", POUND),
        ("nN", 1e-9),
        ("pN", 1e-12),
        ("gf", 0.00980665),
        ("kgf", 9.80665),
        ("ozf", POUND / 16),
        ("cN", 0.01),
        ("kN", 1e3),
        ("Newtons", 1.0),
    ],
)
def test_forces(read, unit, factor):
    head = f"Time (s),Load ({unit}),Extension (mil)"
    found = read(table(head, TIMES, FORCES, POSITIONS), "force=Load", "position=Extension")
    np.testing.assert_allclose(values(found, "force"), FORCES * factor, rtol=1e-12)
    np.testing.assert_allclose(values(found, "position"), POSITIONS * 25.4e-6, rtol=1e-12)


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("psi", "Pa", POUND / INCH**2),
        ("MPa", "Pa", 1e6),
        ("mmHg", "Pa", 133.322387415),
        ("%", "1", 0.01),
        ("mm/mm", "1", 1.0),
        ("mV/V", "1", 1e-3),
        ("deg", "rad", np.pi / 180),
        ("rpm", "rad/s", np.pi / 30),
        ("Nm", "N m", 1.0),
        ("N·mm", "N m", 1e-3),
        ("in-lbf", "N m", POUND * INCH),
        ("N/mm", "N/m", 1e3),
        ("m/s^2", "m s-2", 1.0),
        ("mm/s²", "m s-2", 1e-3),
        ("kΩ", "ohm", 1e3),
        ("kHz", "Hz", 1e3),
    ],
)
def test_quantities_of_other_systems(read, unit, si, factor):
    text = table(f"Time (s),a (V),b ({unit})", TIMES, FORCES, POSITIONS)
    found = read(text, "input=a", "output=b")
    np.testing.assert_allclose(values(found, "output"), POSITIONS * factor, rtol=1e-9)
    assert found.test.unit("output") in ((si,) if si != "1" else ("", "1"))


@pytest.mark.parametrize(
    ("header", "role", "given"),
    [
        ("Load (lbf)", "force", "N"),
        ("Force (nN)", "force", "N"),
        ("force_lbf", "force", "N"),
        ("Force/kN", "force", "N"),
        ("Load (V)", "force", "N"),
        ("Load (kg)", "force", "N"),
        ("Extension (mil)", "position", "mm"),
        ("y (deg)", "output", "1"),
    ],
)
def test_a_header_is_never_replaced(read, header, role, given):
    text = table(f"Time (s),{header},other", TIMES, FORCES, POSITIONS)
    with pytest.raises(UnusableInputError, check=coded("import.contradiction", column=header)):
        read(text, f"{role}=2:{given}", "voltage=3:V")


@pytest.mark.parametrize("unit", ["furlongs/fortnight", "KN", "MN", "raw", "counts", "Max", "mN or N", "dB"])
def test_what_a_header_states_and_nobody_knows_is_refused(read, unit):
    text = table(f"Time (s),Load ({unit}),Extension (mm)", TIMES, FORCES, POSITIONS)
    with pytest.raises(UnusableInputError, check=coded("import.unit_not_known", unit=unit)):
        read(text, "force=Load", "position=Extension")
    found = read(text, "force=2:mN", "position=3")
    assert "import.other_unit" in [code_of(one) for one in found.notices]
    np.testing.assert_array_equal(values(found, "force"), FORCES / 1000)


def test_a_name_is_no_unit(read):
    text = table("time,y_m,V_C", TIMES, FORCES, POSITIONS)
    for options in (("input=y_m", "output=V_C:V"), ("input=y_m:V", "output=V_C"), ("position=y_m", "output=V_C:V")):
        with pytest.raises(UnusableInputError, check=coded("import.no_unit")):
            read(text, *options)
    found = read(text, "input=y_m:V", "output=V_C:V")
    np.testing.assert_array_equal(values(found, "output"), POSITIONS)


@pytest.mark.parametrize("unit", ["C", "F", "g", "h", "in", "min", "Min", "mil"])
def test_a_text_of_several_meanings_is_asked_about(read, unit):
    text = table(f"Time (s),a ({unit}),b (V)", TIMES, FORCES, POSITIONS)
    with pytest.raises(UnusableInputError, check=coded("import.unit_not_known", unit=unit)):
        read(text, "input=a", "output=b")
    with pytest.raises(UnusableInputError, check=coded("import.ambiguous_unit", unit=unit)):
        parse_map([f"input=a:{unit}", "output=b:V"])


def test_the_quantity_tells_what_is_meant(read):
    text = table("Time (s),Temp (C),Acc (g)", TIMES, FORCES, POSITIONS)
    found = read(text, "temperature=Temp", "acceleration_x=Acc")
    np.testing.assert_array_equal(values(found, "temperature"), FORCES)
    np.testing.assert_allclose(values(found, "acceleration_x"), POSITIONS * 9.80665, rtol=1e-15)
    warm = read(text.replace("(C)", "(degF)"), "temperature=Temp", "acceleration_x=Acc")
    np.testing.assert_allclose(values(warm, "temperature"), (FORCES - 32) / 1.8, atol=1e-8)


# -- exports of programs -----------------------------------------------------------------------------------------------

EXPORTS = {
    "quoted, units below": ('"Time","Extension","Load"\n"(s)","(mm)","(kN)"', "txf", ",", ".", ("Load", "Extension")),
    "two brackets": ("Time (s),Force (Load cell) (kN),Disp (Crosshead) (mm)", "tfx", ",", ".", ("2", "3")),
    "German, units below": ('"Zeit";"Standardkraft";"Standardweg"\n"s";"kN";"mm"', "tfx", ";", ",", ("2", "3")),
    "title, tabs": ("Time: 60.0 Sec\n\nTime\tCh 1 Disp\tCh 1 Force\nSec\tmm\tkN", "txf", "\t", ".", ("3", "2")),
    "capitals": ("TIME (SEC),LOAD (KILONEWTON),EXT (MILLIMETER)", "tfx", ",", ".", ("LOAD", "EXT")),
    "DIN": ("t / s;F / kN;s / mm", "tfx", ";", ",", ("F", "s")),
    "words": ("Elapsed Time [seconds]\tLoad [kilonewtons]\tStroke [millimetres]", "tfx", "\t", ".", ("Load", "Stroke")),
    "suffixes": ("time_s|force_kN|pos_mm", "tfx", "|", ".", ("force", "pos")),
    "other columns": ("Time (s),Load (kN),Pos (mm),Load (V),Status (-)", "tfxfx", ",", ".", ("2", "3")),
}


@pytest.mark.parametrize("export", EXPORTS.values(), ids=EXPORTS)
def test_exports_of_machines(read, export):
    head, order, delimiter, decimal, (force, position) = export
    columns = {"t": [f"{k / 100:.3f}" for k in TIMES], "f": FORCES, "x": POSITIONS}
    rows = table("", *(columns[name] for name in order), delimiter=delimiter)
    found = read(head + rows.replace(".", decimal), f"force={force}", f"position={position}")
    assert found.test.sample_rate_hz == 100.0
    np.testing.assert_allclose(values(found, "force"), FORCES * 1000, rtol=1e-15)
    np.testing.assert_array_equal(values(found, "position"), POSITIONS / 1000)


@pytest.mark.parametrize(
    ("head", "code"),
    [
        ("Time (s),Load (KN),Pos (mm)", "import.unit_not_known"),
        ("Time (s),Load (g),Pos (mm)", "import.wrong_unit"),
        ("Time (s),Load (mV/V),Pos (mm)", "import.wrong_unit"),
        ("Time (s),Load (x10^3 N),Pos (mm)", "import.unit_not_known"),
        ("Time (s),Load N,Pos (mm)", "import.no_unit"),
        ("Time (hh:mm:ss),Load (N),Pos (mm)", "import.unit_not_known"),
        ("Time (s.ms),Load (N),Pos (mm)", "import.wrong_unit"),
        ("Sample,Load (N),Pos (mm)", "import.no_time"),
    ],
)
def test_exports_that_are_refused(read, head, code):
    with pytest.raises(UnusableInputError, check=coded(code)):
        read(table(head, [f"{k / 100:.3f}" for k in TIMES], FORCES, POSITIONS), "force=2", "position=3")
