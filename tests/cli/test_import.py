"""``tissueid import`` and ``tissueid export`` as people and scripts meet them."""

import json
import math

import h5py
import numpy as np
import pytest
from coded import shows
from outside_data import REAL
from shell import answer, complaint

from tissueid.cli import main
from tissueid.sessions import Session, Test, read_session, write_session
from tissueid.sessions.imports.export_attributes import unknown_device

MAP = ["--map", "force=force:N", "--map", "position=disp:mm"]


@pytest.fixture
def table(tmp_path):
    rng = np.random.default_rng(3)
    force = rng.normal(2.0, 1.0, 1500)
    position = np.zeros(1500)
    for k in range(2, 1500):  # mass, damper, spring, stepped
        position[k] = 1.86 * position[k - 1] - 0.88 * position[k - 2] + 1e-2 * force[k - 1]
    rows = [f"{k / 1000},{f!r},{x!r}" for k, (f, x) in enumerate(zip(force.tolist(), position.tolist(), strict=True))]
    path = tmp_path / "record.csv"
    path.write_text("time,force,disp\n" + "\n".join(rows) + "\n")
    return path


def test_import_then_identify(table, tmp_path, capsys):
    out = tmp_path / "s.h5"
    found = answer(capsys, "import", str(table), "--out", str(out), *MAP)
    (described,) = found["tests"]
    assert (described["test"], described["samples"], described["sample_rate_hz"], described["rows"]) == (
        1,
        1500,
        1000.0,
        [0, 1500],
    )
    assert described["signals"]["position"]["column"] == "disp"
    assert described["signals"]["position"]["unit"] == "mm"
    assert found["session_id"] == read_session(out).session_id
    assert answer(capsys, "identify", str(out), "--engine", "lms")["vaf_validation_percent"] > 99


def test_every_file_argument_is_one_test(table, tmp_path):
    out = tmp_path / "s.h5"
    kinds = ["--kind", "stochastic", "--kind", "quiet", "--site", "forearm", "--preload", "0.1", "--preload", "0"]
    more = [
        "--subject",
        "P-9",
        "--instrument",
        "moving_mass_kg=0.05",
        "--instrument",
        "model=rig two",
        "--surface",
        "0.01",
    ]
    assert main(["import", f"{table}@0:1000", f"{table}@-500:", "--out", str(out), *MAP, *kinds, *more]) == 0
    session = read_session(out)
    assert [(t.number, t.kind, t.site, t.samples, t.preload_s) for t in session.tests] == [
        (1, "stochastic", "forearm", 1000, 0.1),
        (2, "quiet", "forearm", 500, 0.0),
    ]
    assert [t.surface_position_m for t in session.tests] == [0.01, 0.01]
    assert session.subject.pseudonym == "P-9"
    assert (session.instrument.model, session.instrument.moving_mass_kg) == ("rig two", 0.05)
    assert session.instrument.sample_rate_hz == 1000.0
    assert math.isnan(session.instrument.force_constant_n_per_a)  # nobody said it, and it is not made up


def test_bare_input_and_output(table, tmp_path, capsys):
    out = tmp_path / "s.h5"
    assert main(["import", str(table), "--out", str(out), "--map", "input=force:mV", "--map", "output=3:kPa"]) == 0
    with h5py.File(out) as file:
        signals = file["tests/0001/signals"]
        assert {name: signals[name].attrs["units"] for name in signals} == {"input": "V", "output": "Pa", "time": "s"}
        notes = file["tests/0001"].attrs
        assert json.loads(notes["source_columns"])["input"] == {"column": "force", "unit": "mV"}
    capsys.readouterr()
    found = answer(capsys, "identify", str(out), "--engine", "lms")
    assert found["vaf_validation_percent"] > 99
    assert "stiffness_n_per_m" not in found["parameters"]
    record = read_session(out).test().record()
    assert (record.input_name, record.input_unit, record.output_name, record.output_unit) == (
        "input",
        "V",
        "output",
        "Pa",
    )
    assert shows(
        complaint(capsys, "identify", out, "--engine", "lms", "--input", "voltage"),
        "session.no_signal",
        signal="voltage",
        signals="input, output",
    )


def test_what_is_doubtful_is_said(table, tmp_path, capsys):
    assert main(["import", str(table), "--out", str(tmp_path / "s.h5"), *MAP[:2], "--map", "position=disp:m"]) == 0
    printed = capsys.readouterr().out
    assert shows(printed, "import.time_found", column="time", unit="s")
    assert main(["import", str(table), "--out", str(tmp_path / "t.h5"), "--map", "force=force:mN", *MAP[2:]]) == 0
    assert shows(capsys.readouterr().out, "import.implausible", unit="mN", others="N, gf, kgf, lbf")


def test_a_column_s_name_is_no_markup(tmp_path, capsys):
    path = tmp_path / "a.csv"
    path.write_text("time,[red]force[/red],[bold]x\n0,1,2\n0.1,2,3\n")
    assert (
        main(["import", str(path), "--out", str(tmp_path / "s.h5"), "--map", "force=2:N", "--map", "position=3:mm"])
        == 0
    )
    assert "[red]force[/red]" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nothing.csv", *MAP], "nothing.csv: no such file"),
        (["FOLDER", *MAP], "is a folder"),
        (["TABLE"], "choose what its columns are ('--map ROLE=COLUMN:UNIT')"),
        (["TABLE", *MAP, "--rate", "0"], "the sample rate must be between"),
        (["TABLE", *MAP, "--rate", "nan"], "the sample rate must be between"),
        (["TABLE", *MAP, "--resample", "-1"], "the rate of resampling must be between"),
        (["TABLE", *MAP, "--kind", "fast"], "'fast' is not known: choose one of stochastic, quiet"),
        (["TABLE", *MAP, "--kind", "quiet", "--kind", "quiet"], "--kind is given 2 times"),
        (["TABLE", *MAP, "--configuration", "sideways"], "'sideways' is not known"),
        (["TABLE", *MAP, "--preload", "-1"], "the preload must be 0 s or more"),
        (["TABLE", *MAP, "--surface", "inf"], "the surface must be a position"),
        (["TABLE", *MAP, "--instrument", "colour=red"], "--instrument is KEY=VALUE"),
        (["TABLE", *MAP, "--instrument", "stroke_m=wide"], "stroke_m is a number"),
        (["TABLE", *MAP, "--instrument", "stroke_m=nan"], "stroke_m is a number"),
        (["TABLE@0:99999", *MAP], "row 99999 is beyond the 1500 rows"),
        (["TABLE", "--map", "force=torque:N", *MAP[2:]], "no column 'torque'"),
        (["TABLE", "--map", "force=force:mm", *MAP[2:]], "force is measured in N"),
        (["TABLE", "TABLE@9:3", *MAP], "rows 9:3 of 1500 are empty"),
        ([*MAP], "FILE"),
    ],
)
def test_refusals_are_one_line_and_leave_nothing(table, tmp_path, capsys, arguments, words):
    filled = [a.replace("TABLE", str(table)).replace("FOLDER", str(tmp_path)) for a in arguments]
    assert words in complaint(capsys, "import", *filled, "--out", tmp_path / "s.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["record.csv"]


def test_nothing_is_written_over(table, tmp_path, capsys):
    out = tmp_path / "s.h5"
    out.write_text("mine")
    assert "never overwritten" in complaint(capsys, "import", table, "--out", out, *MAP)
    assert out.read_text() == "mine"
    assert "no folder" in complaint(capsys, "import", table, "--out", tmp_path / "no" / "s.h5", *MAP)
    new = tmp_path / "n.json"
    assert "two outputs" in complaint(capsys, "import", table, "--out", new, *MAP, "--json", new)


def test_export_and_back(table, tmp_path, capsys):
    out, again = tmp_path / "s.h5", tmp_path / "t.h5"
    assert main(["import", f"{table}@0:100", f"{table}@100:300", "--out", str(out), *MAP]) == 0
    for kind in ("csv", "mat"):
        folder = tmp_path / kind
        capsys.readouterr()
        files = answer(capsys, "export", str(out), "--out", str(folder), "--format", kind)["files"]
        assert sorted(files) == sorted(path.name for path in folder.iterdir())
        assert main(["import", *map(str, sorted(folder.glob(f"*.{kind}"))), "--out", str(again)]) == 0
        first, second = read_session(out), read_session(again)
        assert (first.session_id, first.created) == (second.session_id, second.created)
        for a, b in zip(first.tests, second.tests, strict=True):
            assert a.notes == b.notes
            assert a.signals.keys() == b.signals.keys()
            for name in a.signals:
                np.testing.assert_array_equal(a.signals[name], b.signals[name])
        again.unlink()


def test_export_refuses_in_one_line(table, tmp_path, capsys):
    assert "no such file" in complaint(capsys, "export", "no.h5", "--out", tmp_path / "x", "--format", "csv")
    write_session(tmp_path / "e.h5", Session(unknown_device()))
    assert "no tests" in complaint(capsys, "export", tmp_path / "e.h5", "--out", tmp_path / "x", "--format", "csv")
    test = Test(1, "quiet", {"force": np.zeros(3), "position": np.ones(3)}, 10.0)
    write_session(tmp_path / "s.h5", Session(unknown_device(), tests=(test,)))
    assert "no format 'xls'" in complaint(
        capsys, "export", tmp_path / "s.h5", "--out", tmp_path / "x", "--format", "xls"
    )
    assert shows(
        complaint(capsys, "export", tmp_path / "s.h5", "--out", tmp_path, "--format", "csv"), "export.folder_exists"
    )


def test_both_are_in_the_audit_log_without_names_of_files(table, tmp_path, audit_file):
    out = tmp_path / "s.h5"
    assert main(["import", str(table), "--out", str(out), *MAP]) == 0
    assert main(["export", str(out), "--out", str(tmp_path / "x"), "--format", "csv"]) == 0
    lines = [json.loads(line) for line in audit_file.read_bytes().splitlines()]
    found = {line["what"]: line["subject"] for line in lines}
    assert found["session.imported"] == found["session.exported"] == read_session(out).session_id
    assert b"record" not in audit_file.read_bytes()


@pytest.mark.skipif(not REAL.is_dir(), reason="needs the real records")
def test_the_real_records(tmp_path, capsys):
    box, skin = REAL / "SNLS80mV.mat", REAL / "healthy_skin.csv"
    parts = [f"{box}@0:40000", f"{box}@40000:131072"]
    roles = ["--map", "input=V1:V", "--map", "output=V2:V", "--rate", "610.3515625"]
    assert main(["import", *parts, "--out", str(tmp_path / "s.h5"), *roles]) == 0
    assert [test.samples for test in read_session(tmp_path / "s.h5").tests] == [40000, 91072]
    roles = ["--map", "force=force_N:N", "--map", "position=disp_mm:mm", "--kind", "slow_ramp"]
    assert main(["import", str(skin), "--out", str(tmp_path / "h.h5"), *roles]) == 0
    (test,) = read_session(tmp_path / "h.h5").tests
    assert (test.samples, test.sample_rate_hz) == (34740, 100.0)
    truth = np.loadtxt(skin, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(test.signals["force"], truth[:, 2])
    np.testing.assert_array_equal(test.signals["position"], truth[:, 1] / 1000)
    capsys.readouterr()
    roles = ["--map", "input=V1:V", "--map", "output=V2:V", "--rate", "610.3515625", "--out", str(tmp_path / "t.h5")]
    assert main(["import", f"{box}@60000:63000", *roles]) == 0
    capsys.readouterr()
    found = answer(capsys, "identify", str(tmp_path / "t.h5"), "--engine", "lms")["parameters"]
    natural = found["natural_frequency_rad_per_s"]["value"] / (2 * math.pi)
    assert 65 < natural < 75
