"""Sessions out to other programs and back: what comes back is what went out, to the last bit."""

import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from coded import coded, says
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tissueid.device import DESKTOP
from tissueid.errors import UnusableInputError
from tissueid.sessions import Session, Subject, Test, read_session, write_session
from tissueid.sessions.imports import Choices, Source, assembled, export_session, import_test, parse_map


def a_session(*tests):
    device = replace(DESKTOP, serial_number="T-1", calibration={"kind": "check", "ohm": 12.1})
    return Session(device, Subject("P-7", {"age": 31.0, "hand": "rechts"}), tests)


def a_test(number=1, n=50, rate=2000.0, **more):
    rng = np.random.default_rng(number)
    signals = {name: rng.standard_normal(n) for name in ("command", "current", "force", "position", "acceleration_x")}
    signals["position"][3:5] = np.nan
    values = {"kind": "quiet", "site": "Arm, links", "preload_s": 0.01, "surface_position_m": 0.002, "seed": 5}
    values |= {"stimulus": {"type": "noise", "low": 0.5}, "notes": {"reason": "button", "samples_lost": 10.0}}
    return Test(number=number, signals=signals, sample_rate_hz=rate, **(values | more))


def brought_back(folder, kind):
    files = sorted(folder.glob(f"*.{kind}"))
    session, notices = assembled([import_test(Source.parsed(str(file)), None, Choices()) for file in files], {}, None)
    assert notices == []
    return session


def same(ours, theirs):
    def plain(session):
        return replace(session, tests=(), instrument=DESKTOP), repr(session.instrument)

    assert plain(theirs) == plain(ours)
    assert len(theirs.tests) == len(ours.tests)
    for a, b in zip(ours.tests, theirs.tests, strict=True):
        assert repr(replace(b, signals={})) == repr(replace(a, signals={}))
        assert b.signals.keys() - {"time"} == a.signals.keys() - {"time"}
        for name in a.signals.keys() - {"time"}:
            np.testing.assert_array_equal(b.signals[name], a.signals[name])
            assert (np.signbit(b.signals[name]) == np.signbit(a.signals[name]))[np.isfinite(a.signals[name])].all()


@pytest.mark.parametrize("kind", ["csv", "mat"])
def test_what_comes_back_is_what_went_out(tmp_path, kind):
    path = tmp_path / "a.h5"
    tests = (
        a_test(1, rate=610.3515625),
        a_test(3, rate=1 / 3, repeat_of=1, status="aborted", surface_position_m=math.nan),
        a_test(4, n=1),
    )
    write_session(path, a_session(*tests))
    session = read_session(path)
    export_session(session, tmp_path / "out", kind)
    again = brought_back(tmp_path / "out", kind)
    same(session, again)
    write_session(tmp_path / "b.h5", again)
    same(session, read_session(tmp_path / "b.h5"))


NAMES = st.one_of(
    st.sampled_from(
        ["force", "position", "temperature", "input", "output", "emg", "a (1)", "A (1)", "x,y", 'q"', " s "]
    ),
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="/\0"), min_size=1, max_size=70),
).filter(lambda name: name not in ("time", ".", ".."))
NUMBERS = st.floats(allow_subnormal=True)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), kind=st.sampled_from(["csv", "mat"]), rate=st.floats(1e-3, 1e6))
def test_any_session_comes_back(tmp_path_factory, data, kind, rate):
    n = data.draw(st.integers(1, 8))
    names = data.draw(st.lists(NAMES, min_size=2, max_size=4, unique=True))
    signals = {name: np.array(data.draw(st.lists(NUMBERS, min_size=n, max_size=n))) for name in names}
    units = {name: "V" for name in names if name in ("input", "output")}
    test = Test(7, "stochastic", signals, rate, units=units, site=data.draw(st.text(st.characters(codec="utf-8"))))
    session = a_session(replace(test, site=test.site.replace("\0", "")))
    folder = tmp_path_factory.mktemp("round") / "out"
    export_session(session, folder, kind)
    same(session, brought_back(folder, kind))


def test_units_are_in_the_names(tmp_path):
    test = a_test()
    session = a_session(test)
    export_session(session, tmp_path / "c", "csv")
    export_session(session, tmp_path / "m", "mat")
    assert sorted(p.name for p in (tmp_path / "c").iterdir()) == ["test-0001.csv", "test-0001.json"]
    head, first = (tmp_path / "c" / "test-0001.csv").read_text().splitlines()[:2]
    assert head == "time (s),command (V),current (A),force (N),position (m),acceleration_x (m s-2)"
    assert [float(cell) for cell in first.split(",")] == [0.0, *(values[0] for values in test.signals.values())]
    variables = scipy.io.loadmat(tmp_path / "m" / "test-0001.mat")
    np.testing.assert_array_equal(variables["force_N"][:, 0], test.signals["force"])
    assert {"time_s", "position_m", "acceleration_x_m_per_s2"} <= variables.keys()
    attributes_file = json.loads((tmp_path / "c" / "test-0001.json").read_text())
    assert attributes_file["test"]["site"] == "Arm, links"
    assert attributes_file["columns"]["force"] == {"column": "force (N)", "unit": "N"}
    assert attributes_file["instrument"]["serial_number"] == "T-1"


def test_an_export_reads_with_a_map_too(tmp_path):
    test = a_test()
    export_session(a_session(test), tmp_path / "out", "csv")
    found = import_test(
        Source.parsed(str(tmp_path / "out" / "test-0001.csv")),
        parse_map(["force=force", "position=position"]),
        Choices(),
    )
    assert found.test.sample_rate_hz == 2000.0
    assert found.attributes is None
    np.testing.assert_array_equal(found.test.signals["force"], test.signals["force"])


def test_rows_of_an_export(tmp_path):
    export_session(a_session(a_test()), tmp_path / "out", "csv")
    found = import_test(Source.parsed(f"{tmp_path}/out/test-0001.csv@10:30"), None, Choices(site="leg"))
    assert (found.test.samples, found.test.site, found.test.preload_s) == (20, "leg", 0.005)


def test_rows_of_an_export_are_counted_at_its_own_rate(tmp_path):
    export_session(a_session(a_test()), tmp_path / "out", "csv")
    rows = Source.parsed(f"{tmp_path}/out/test-0001.csv@10:30")
    found = import_test(rows, None, Choices(), resample_hz=4000.0)
    assert (found.test.sample_rate_hz, found.test.preload_s) == (4000.0, 0.005)


def test_tests_of_two_sessions_get_new_numbers(tmp_path):
    export_session(a_session(a_test(1)), tmp_path / "a", "csv")
    export_session(a_session(a_test(1, repeat_of=4)), tmp_path / "b", "csv")
    files = [tmp_path / "a" / "test-0001.csv", tmp_path / "b" / "test-0001.csv"]
    session, notices = assembled([import_test(Source.parsed(str(f)), None, Choices()) for f in files], {}, None)
    assert [(test.number, test.repeat_of) for test in session.tests] == [(1, None), (2, None)]
    (notice,) = notices
    assert says(notice, "import.renumbered")
    other = json.loads((tmp_path / "b" / "test-0001.json").read_text())
    other["subject"]["pseudonym"] = "P-8"
    (tmp_path / "b" / "test-0001.json").write_text(json.dumps(other))
    with pytest.raises(UnusableInputError, check=coded("import.subjects")):
        assembled([import_test(Source.parsed(str(f)), None, Choices()) for f in files], {}, None)


@pytest.mark.parametrize(
    ("change", "code", "values"),
    [
        (
            lambda stored: stored["test"].update(sample_rate_hz=-1),
            "import.attributes_invalid",
            {"field": "test.sample_rate_hz"},
        ),
        (lambda stored: stored["test"].update(sample_rate_hz=1000.0), "import.rate_differs", {"stated": 1000.0}),
        (lambda stored: stored["test"].pop("kind"), "import.attributes_invalid", {"field": "test.kind"}),
        (lambda stored: stored["test"].update(seed=2**80), "import.attributes_invalid", {"field": "test.seed"}),
        (lambda stored: stored["test"].update(site="a\0b"), "import.attributes_invalid", {"field": "test.site"}),
        (lambda stored: stored["test"]["notes"].update({"a\0b": 1.0}), "import.attributes_invalid", {}),
        (lambda stored: stored["columns"].update({"a/b": stored["columns"]["force"]}), "import.attributes_invalid", {}),
        (
            lambda stored: stored["columns"]["force"].update(column="elsewhere"),
            "import.no_column",
            {"column": "elsewhere"},
        ),
        (
            lambda stored: stored["columns"]["force"].update(unit="mN"),
            "import.not_si",
            {"signal": "force", "unit": "mN"},
        ),
        (lambda stored: stored.update(columns={}), "import.few_signals", {}),
        (lambda stored: stored.update(format="other"), "import.no_map", {}),
        (lambda stored: stored.update(format_version="9.0"), "import.attributes_invalid", {"field": "format_version"}),
        (lambda stored: stored.pop("session"), "import.attributes_invalid", {"field": "session"}),
        (lambda stored: stored.update(session={}), "import.attributes_invalid", {"field": "session"}),
        (lambda stored: stored["session"].pop("session_id"), "import.attributes_invalid", {"field": "session"}),
        (lambda stored: stored["session"].pop("created"), "import.attributes_invalid", {"field": "session"}),
    ],
)
def test_invalid_attributes_are_refused(tmp_path, change, code, values):
    export_session(a_session(a_test()), tmp_path / "out", "csv")
    attributes_file = tmp_path / "out" / "test-0001.json"
    stored = json.loads(attributes_file.read_text())
    change(stored)
    attributes_file.write_text(json.dumps(stored))
    with pytest.raises(UnusableInputError, check=coded(code, **values)):
        import_test(Source.parsed(str(tmp_path / "out" / "test-0001.csv")), None, Choices())


@pytest.mark.parametrize("ohm", [["twelve"], 10**400])
def test_an_invalid_instrument_is_refused(tmp_path, ohm):
    export_session(a_session(a_test()), tmp_path / "out", "csv")
    attributes_file = tmp_path / "out" / "test-0001.json"
    stored = json.loads(attributes_file.read_text())
    stored["instrument"]["coil_resistance_ohm"] = ohm
    attributes_file.write_text(json.dumps(stored))
    found = import_test(Source.parsed(str(tmp_path / "out" / "test-0001.csv")), None, Choices())
    with pytest.raises(UnusableInputError, check=coded("import.instrument_value", name="coil_resistance_ohm")):
        assembled([found], {}, None)


def test_whole_or_not_at_all(tmp_path, monkeypatch):
    session = a_session(a_test(1), a_test(2))
    calls = []

    def failing(*_, **__):
        calls.append(1)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(scipy.io, "savemat", failing)
    with pytest.raises(OSError, match="No space"):
        export_session(session, tmp_path / "out", "mat")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_written_over(tmp_path):
    session = a_session(a_test())
    (tmp_path / "empty").mkdir()
    export_session(session, tmp_path / "empty", "csv")
    with pytest.raises(UnusableInputError, check=coded("export.folder_exists")):
        export_session(session, tmp_path / "empty", "csv")
    (tmp_path / "file").write_text("x")
    with pytest.raises(UnusableInputError, check=coded("export.folder_exists")):
        export_session(session, tmp_path / "file", "csv")
    with pytest.raises(UnusableInputError, check=coded("file.no_folder")):
        export_session(session, tmp_path / "no" / "where", "csv")
    with pytest.raises(UnusableInputError, check=coded("export.format", kind="xls", formats="csv, mat, parquet")):
        export_session(session, tmp_path / "x", "xls")
    with pytest.raises(UnusableInputError, check=coded("session.empty")):
        export_session(a_session(), tmp_path / "x", "csv")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(UnusableInputError, check=coded("export.folder_exists")):
        export_session(session, tmp_path / "link", "csv")


def test_parquet_names_its_extra_where_it_is_missing(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(UnusableInputError, check=coded("export.no_pyarrow")) as raised:
        export_session(a_session(a_test()), tmp_path / "out", "parquet")
    assert "\n" not in str(raised.value)
    assert list(tmp_path.iterdir()) == []


def test_parquet(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    test = a_test()
    export_session(a_session(test), tmp_path / "out", "parquet")
    table = parquet.read_table(tmp_path / "out" / "test-0001.parquet")
    assert table.column_names[0] == "time (s)"
    np.testing.assert_array_equal(table["force (N)"].to_numpy(), test.signals["force"])
