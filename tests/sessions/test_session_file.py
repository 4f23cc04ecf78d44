"""The session file: the contract's layout, both ways, and a reader that trusts nothing."""

import os
import weakref
from dataclasses import replace

import h5py
import numpy as np
import pytest
import xarray as xr
from coded import coded
from outside_data import RIG

from tissueid.device import DeviceDescription
from tissueid.errors import SessionFormatError, UnusableInputError
from tissueid.sessions import Session, Subject, Test, read_session, write_session
from tissueid.sessions import hdf5_session as session_file

BLIND = sorted(RIG.glob("*.h5"))


def a_test(number=1, n=900, **changes):
    rng = np.random.default_rng(number)
    signals = {name: rng.standard_normal(n) for name in ("command", "voltage", "current", "force", "position")}
    signals["position"][100:110] = np.nan
    values = dict(kind="stochastic", sample_rate_hz=2000.0, site="left forearm", preload_s=0.05, seed=3)
    return Test(number=number, signals=signals, stimulus={"type": "gaussian"}, **(values | changes))


@pytest.fixture
def session():
    device = replace(DeviceDescription(), serial_number="T-1", calibration={"kind": "check", "ohm": 12.1})
    tests = (a_test(1), a_test(2, repeat_of=1, status="aborted", notes={"reason": "button", "samples_lost": 10.0}))
    return Session(device, Subject("B5978", {"age": 31.0, "handedness": "right"}), tests)


@pytest.fixture
def path(tmp_path, session):
    path = tmp_path / "session.h5"
    write_session(path, session)
    return path


def test_what_is_written_is_read(path, session):
    read = read_session(path)
    assert (read.session_id, read.created, read.software) == (session.session_id, session.created, session.software)
    assert read.instrument == session.instrument
    assert read.subject == session.subject
    for ours, theirs in zip(session.tests, read.tests, strict=True):
        assert theirs.signals.keys() == ours.signals.keys() | {"time"}
        for name, values in ours.signals.items():
            np.testing.assert_array_equal(theirs.signals[name], values)
        assert replace(theirs, signals={}, surface_position_m=0.0) == replace(ours, signals={}, surface_position_m=0.0)


def test_the_layout_is_the_contract_s(path):
    with h5py.File(path) as file:
        assert file.attrs["format"] == "tissueid-session"
        assert file.attrs["format_version"] == "1.0"
        assert {"session_id", "created", "software"} <= set(file.attrs)
        assert {
            "model",
            "serial_number",
            "coil_resistance_ohm",
            "coil_inductance_h",
            "force_constant_n_per_a",
            "moving_mass_kg",
            "bearing_damping_n_s_per_m",
            "amplifier_gain",
            "amplifier_limit_v",
            "stroke_m",
            "sample_rate_hz",
            "calibration_spring_n_per_m",
            "calibration_relative_uncertainty",
            "firmware_version",
            "protocol_version",
        } <= set(file["instrument"].attrs)
        assert file["subject"].attrs["pseudonym"] == "B5978"
        assert list(file["tests"]) == ["0001", "0002"]
        group = file["tests/0002"]
        assert {
            "kind",
            "configuration",
            "site",
            "sample_rate_hz",
            "preload_s",
            "surface_position_m",
            "stimulus",
            "seed",
            "repeat_of",
            "status",
        } <= set(group.attrs)
        assert group.attrs["repeat_of"] == "0001"
        assert file["tests/0001"].attrs["repeat_of"] == ""
        assert group["signals/force"].attrs["units"] == "N"
        assert group["signals/force"].attrs["long_name"]
        assert group["signals/force"].dims[0][0].name == "/tests/0002/signals/time"


def test_xarray_opens_it(path):
    with xr.open_dataset(path, group="tests/0001/signals", engine="h5netcdf") as signals:
        assert signals["force"].dims == ("time",)
        assert signals["position"].attrs["units"] == "m"
        np.testing.assert_allclose(signals["time"].values[:3], [0, 0.0005, 0.001])


def test_a_session_is_never_overwritten(path, session):
    before = path.read_bytes()
    with pytest.raises(SessionFormatError, check=coded("session.exists")):
        write_session(path, session)
    assert path.read_bytes() == before


def test_nothing_is_left_when_writing_fails(tmp_path, session, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_session(tmp_path / "session.h5", session)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("change", [lambda values: values[:-1], lambda values: values + 1e-12, lambda values: -values])
def test_what_reads_back_differently_is_not_kept(tmp_path, session, monkeypatch, change):
    def damaged(group, read=session_file.read_signals):
        signals = read(group)
        return signals | {"force": change(signals["force"])}

    monkeypatch.setattr(session_file, "read_signals", damaged)
    with pytest.raises(SessionFormatError, check=coded("session.test_differs", number=1, signal="force")):
        write_session(tmp_path / "session.h5", session)
    assert list(tmp_path.iterdir()) == []


def test_tests_are_asked_for_one_by_one(tmp_path, session):
    path, alive = tmp_path / "session.h5", []

    def tests():
        for number in (1, 2, 3):
            test = a_test(number)
            alive.append(weakref.ref(test.signals["force"]))
            yield test
            del test
            assert sum(signal() is not None for signal in alive) <= 1

    write_session(path, session, tests=tests())
    assert [test.number for test in read_session(path).tests] == [1, 2, 3]
    assert read_session(path).session_id == session.session_id


def test_a_record_leaves_out_the_preload(session):
    record = session.test().record()
    assert len(record) == 900 - 100
    assert (record.input_unit, record.output_unit) == ("N", "m")
    assert len(session.test(1).record(preload=True)) == 900


def test_the_first_stochastic_test_is_the_default(session):
    quiet = a_test(1, kind="quiet")
    assert Session(session.instrument, tests=(quiet, a_test(2))).test().number == 2
    assert Session(session.instrument, tests=(quiet,)).test().number == 1


@pytest.mark.parametrize(
    ("ask", "code", "values"),
    [
        (lambda s: s.test(9), "session.no_test", {"number": 9, "numbers": "1, 2"}),
        (lambda s: replace(s, tests=()).test(), "session.empty", {}),
        (lambda s: s.test().record("torque"), "session.no_signal", {"signal": "torque"}),
        (lambda s: replace(s.test(), preload_s=9.0).record(), "session.only_preload", {}),
    ],
)
def test_missing_parts_are_reported(session, ask, code, values):
    with pytest.raises(UnusableInputError, check=coded(code, **values)):
        ask(session)


def spoil(path, how):
    with h5py.File(path, "r+") as file:
        how(file)


def replace_dataset(name, **kwargs):
    def how(file):
        del file[name]
        file.create_dataset(name, **kwargs)

    return how


def remove(*names):
    def how(file):
        for name in names:
            del file[name]

    return how


@pytest.mark.parametrize(
    ("how", "code", "values"),
    [
        (lambda f: f.attrs.__delitem__("format"), "session.not_one", {}),
        (lambda f: f.attrs.__setitem__("format", 7), "session.attribute_not_text", {"name": "format"}),
        (lambda f: f.attrs.__setitem__("format_version", "2.0"), "session.version", {"version": "2.0", "known": "1.0"}),
        (remove("tests"), "session.no_group", {"name": "tests"}),
        (remove("instrument"), "session.no_group", {"name": "instrument"}),
        (remove("tests/0001/signals"), "session.no_group", {"name": "signals"}),
        (lambda f: f.move("tests/0001", "tests/first"), "session.test_name", {"test": "first"}),
        (lambda f: f["tests/0001"].attrs.__delitem__("kind"), "session.attribute_missing", {"name": "kind"}),
        (lambda f: f["tests/0001"].attrs.__setitem__("sample_rate_hz", -1.0), "session.sample_rate", {"rate": -1.0}),
        (
            lambda f: f["tests/0001"].attrs.__setitem__("sample_rate_hz", "fast"),
            "session.attribute_not_a_number",
            {"name": "sample_rate_hz"},
        ),
        (replace_dataset("tests/0001/signals/force", data=np.zeros(7)), "session.signal_length", {}),
        (
            replace_dataset("tests/0001/signals/force", data=np.zeros((900, 2))),
            "session.signal_type",
            {"signal": "force"},
        ),
        (
            replace_dataset("tests/0001/signals/force", data=np.array([b"a"] * 900)),
            "session.signal_type",
            {"signal": "force"},
        ),
        (
            replace_dataset("tests/0001/signals/force", shape=(10**12,), dtype="f4", chunks=(1000,)),
            "session.too_many_numbers",
            {"numbers": 1_000_000_009_900},
        ),
        (
            remove(*(f"tests/0001/signals/{n}" for n in ("command", "voltage", "current", "force"))),
            "session.few_signals",
            {},
        ),
        (lambda f: f.__setitem__("tests/0003", h5py.ExternalLink("other.h5", "/")), "session.link", {"name": "0003"}),
        (lambda f: f.__setitem__("tests/0001/signals/x", h5py.SoftLink("/tests/0002")), "session.link", {}),
    ],
)
def test_a_file_that_breaks_the_format_is_refused(path, how, code, values):
    spoil(path, how)
    with pytest.raises(SessionFormatError, check=coded(code, path=str(path), **values)) as caught:
        read_session(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_many_large_empty_signals_are_not_loaded(path):
    def bomb(file):
        for number in range(3, 60):
            signals = file.create_group(f"tests/{number:04d}/signals")
            signals.parent.attrs.update(kind="quiet", sample_rate_hz=2000.0)
            for name in ("force", "position"):
                signals.create_dataset(name, shape=(15_000_000,), dtype="f4", chunks=(10_000,), compression="gzip")

    spoil(path, bomb)
    with pytest.raises(SessionFormatError, check=coded("session.too_many_numbers")):
        read_session(path)


def test_data_outside_the_file_is_not_followed(path, tmp_path):
    (tmp_path / "secret").write_bytes(bytes(8 * 900))

    def how(file):
        del file["tests/0001/signals/force"]
        file["tests/0001/signals"].create_dataset("force", (900,), "f8", external=[(str(tmp_path / "secret"), 0, 7200)])

    spoil(path, how)
    with pytest.raises(SessionFormatError, check=coded("session.points_outside")):
        read_session(path)


def test_unknown_groups_and_attributes_are_passed_over(path, session):
    def grow(file):
        file.attrs["future"] = "yes"
        file.create_group("tests/0001/signals/spectra")
        file.create_group("calibrations")
        file["tests/0001"].attrs["mood"] = "calm"

    spoil(path, grow)
    read = read_session(path)
    assert len(read.tests) == len(session.tests)
    assert read.tests[0].notes == {"mood": "calm"}


@pytest.mark.parametrize("content", [b"", b"not hdf5 at all", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_rubbish_is_refused_in_one_line(tmp_path, content):
    path = tmp_path / "rubbish.h5"
    path.write_bytes(content)
    with pytest.raises(SessionFormatError, check=coded("session.damaged", path=str(path))):
        read_session(path)


def test_every_truncation_is_refused_or_whole(path, tmp_path):
    whole = path.read_bytes()
    for share in np.linspace(0.01, 0.99, 25):
        cut = tmp_path / "cut.h5"
        cut.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(SessionFormatError):
            read_session(cut)


def test_a_missing_file_and_a_folder(tmp_path):
    with pytest.raises(SessionFormatError, check=coded("file.missing")):
        read_session(tmp_path / "nothing.h5")
    with pytest.raises(SessionFormatError, check=coded("session.folder")):
        read_session(tmp_path)


@pytest.mark.skipif(not BLIND, reason="the independent rig's sessions are not next to the project")
@pytest.mark.parametrize("path", BLIND, ids=lambda path: path.stem)
def test_sessions_of_an_independent_rig_are_read(path):
    session = read_session(path)
    record = session.test().record()
    assert len(record) >= 2000
    assert session.test().kind == "stochastic"
    assert session.instrument.model.endswith(" indenter")
