"""``tissueid calibrate sweep`` as technicians and scripts meet it."""

import json
import time

import numpy as np
import pytest
from coded import made as message_of
from coded import shows
from spring_rig import Rig, swept
from support import connect_scenario

from firmware_sim.scenario import Scenario
from tissueid.calibration import read_calibration, spring_points
from tissueid.calibration.sweep import ProbePosition, Sweep
from tissueid.cli import main
from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError
from tissueid.procedures import calibrations
from tissueid.sessions import Session, Test, read_session, write_session

SPRING = Scenario(preset="calibration-spring", coil="finite", seed=5)
SHORT = ["--from", "8", "--to", "24", "--step", "4", "--seconds", "1"]


@pytest.fixture(scope="module", autouse=True)
def _quicker(long_frames):
    """Long frames and shorter gentle tests: nothing here depends on either."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spring_points, "GENTLE_S", 0.5)
        yield


@pytest.fixture
def device(monkeypatch):
    """An instrument behind the URL ``spring``, and the scenario that it is made of."""
    scenario = [SPRING]

    def opened(url):
        assert url == "spring"
        scenario.append(connect_scenario(scenario[0]))
        return scenario[-1]

    monkeypatch.setattr(calibrations, "open_instrument", opened)
    return scenario


def sweep(*arguments):
    return main(["calibrate", "sweep", *map(str, arguments)])


def complaint(capsys, *arguments):
    assert sweep(*arguments) == 2
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert lines[-1].startswith("tissueid: ")
    assert "Traceback" not in captured.err
    return lines[-1]


def test_it_runs_unattended_and_leaves_calibration_report_session_and_answer(device, tmp_path, capsys):
    out, page, kept = tmp_path / "sweep.toml", tmp_path / "sweep.html", tmp_path / "sweep.h5"
    arguments = ["--device", "spring", "--out", out, "--report", page, "--session", kept, "--json", "-", *SHORT]
    assert sweep(*arguments) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["verdict"] == "passed"
    assert answer["quantities"]["force_constant_n_per_a"]["value"] == pytest.approx(3.0, rel=0.02)
    assert len(answer["tables"]["sweep"]["vaf_percent"]) == 5
    assert answer["seconds"] > answer["measuring_seconds"] > 0
    made = read_calibration(out)
    assert made.kind == "sweep"
    assert made.serial_number == "SIM-0001"
    assert made.conditions["by"] == "motorised stage"
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert "Dynamic sweep of" in page.read_text(encoding="utf-8")
    assert len(read_session(kept).tests) == 5

    again = tmp_path / "again.toml"  # from what was kept, without a device
    assert sweep("--kept", kept, "--out", again) == 0
    told = capsys.readouterr().out
    assert "linear from 8.0" in told
    assert "or less to 24.0" in told
    assert shows(told, "calibration.headline", kind="Dynamic sweep", verdict=message_of("calibration.verdict.passed"))
    assert read_calibration(again).quantities == made.quantities
    assert device[-1].link.firmware.bench.tissue.surface_m == pytest.approx(0.0154, abs=0.3e-3)  # and its sag


def test_without_a_stage_a_person_on_a_terminal_moves_the_spring(device, tmp_path, monkeypatch, capsys):
    device[0] = SPRING.model_copy(update={"stage": False})
    asked = []

    def there(instrument, place_m, tell, cancelled):
        asked.append(place_m)
        instrument.link.firmware.bench.place_fixture(place_m - 0.6e-3)
        tell(ProbePosition(place_m - 1.4e-3, False))

    monkeypatch.setattr(calibrations, "wait_for_position", there)
    for stream in ("stdin", "stderr"):
        monkeypatch.setattr(f"sys.{stream}.isatty", lambda: True, raising=False)
    out = tmp_path / "sweep.toml"
    assert sweep("--device", "spring", "--out", out, *SHORT) == 0
    assert asked == pytest.approx([8e-3, 12e-3, 16e-3, 20e-3, 24e-3])
    assert shows(capsys.readouterr().err, "calibration.move_spring", position=12.0)
    assert read_calibration(out).conditions["by"] == "hand"


def test_without_a_stage_and_a_terminal_it_refuses(device, tmp_path, capsys):
    device[0] = SPRING.model_copy(update={"stage": False})
    said = complaint(capsys, "--device", "spring", "--out", tmp_path / "sweep.toml", *SHORT)
    assert shows(said, "sweep.no_person")
    assert not list(tmp_path.iterdir())


def test_a_static_calibration_in_force_corrects_what_is_read(device, tmp_path, capsys):
    (tmp_path / "calibrations").mkdir()
    static = tmp_path / "calibrations" / "static.toml"
    static.write_text(
        'format = "tissueid-calibration"\nformat_version = "1.0"\nkind = "static"\n'
        'model = "desktop indenter (simulated)"\nserial_number = "SIM-0001"\ndate = "2026-01-01T00:00:00Z"\n'
        'valid_days = 3650\nsoftware = "test"\nverdict = "passed"\n'
        "[quantities.position_gain]\nvalue = 1.01\nstd = 0.001\n",
        encoding="utf-8",
    )
    device[0] = Scenario.model_validate(
        {"preset": "calibration-spring", "seed": 5, "channels": {"position": {"gain_error": 0.01}}}
    )
    out = tmp_path / "sweep.toml"
    options = ["--calibrations", static.parent, "--spring-uncertainty", "0.1"]
    assert sweep("--device", "spring", "--out", out, *options, *SHORT) == 0
    made = read_calibration(out)
    assert made.conditions["static_file"] == "static.toml"
    assert made.quantities["position_over_stage"].value == pytest.approx(1.0, abs=1e-3)


def test_what_goes_wrong_leaves_no_calibration_and_keeps_the_session(device, tmp_path, monkeypatch, capsys):
    kept, out = tmp_path / "sweep.h5", tmp_path / "sweep.toml"
    calls = []

    def second(self, *arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return measure(self, *arguments)

    measure = Sweep.measure
    monkeypatch.setattr(Sweep, "measure", second)
    assert sweep("--device", "spring", "--out", out, "--session", kept, *SHORT) != 0
    said = " ".join(capsys.readouterr().err.split())
    assert shows(said, "sweep.kept", path=str(kept))
    assert shows(said, "sweep.stage_stays", position="7.4 mm")
    assert not out.exists()
    assert [test.status for test in read_session(kept).tests] == ["completed"]
    assert shows(complaint(capsys, "--kept", kept, "--out", out), "sweep.too_few", least=5, count=1)


def test_after_a_failure_the_stage_is_back_in_mid_stroke(device, tmp_path, monkeypatch, capsys):
    measure = Sweep.measure

    def second(self, place_m, done, *arguments):
        measure(self, place_m, done, *arguments)
        if done == 1:
            raise InstrumentError("the coil's connector fell off")

    monkeypatch.setattr(Sweep, "measure", second)
    assert "fell off" in complaint(capsys, "--device", "spring", "--out", tmp_path / "sweep.toml", *SHORT)
    assert device[-1].link.firmware.bench.tissue.surface_m == pytest.approx(0.0154, abs=0.3e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "give either --device, or --kept for a saved sweep"),
        (["--device", "spring", "--kept", "x.h5"], "give either --device, or --kept"),
        (["--kept", "x.h5", "--session", "y.h5"], "--session saves a new recording: leave it out with --kept"),
        (["--device", "spring", "--from", "20", "--to", "10"], "must end at a larger position"),
        (["--device", "spring", "--step", "0.1"], "0.5 to 5 mm"),
        (["--device", "spring", "--spring", "1"], "10 to 100000 N/m"),
        (["--device", "spring", "--spring-uncertainty", "60"], "better than 50 %"),
        (["--device", "spring", "--spring-mass", "-1"], "0 to 200 g"),
        (["--kept", "nowhere.h5"], "nowhere.h5"),
    ],
)
def test_what_cannot_be_used_is_said_in_a_line(device, tmp_path, capsys, arguments, words):
    assert words in complaint(capsys, "--out", tmp_path / "sweep.toml", *arguments)
    assert len(device) == 1


def test_another_file_is_not_written_over(device, tmp_path, capsys):
    out = tmp_path / "notes.txt"
    out.write_text("mine", encoding="utf-8")
    assert "not overwritten" in complaint(capsys, "--device", "spring", "--out", out)
    assert out.read_text(encoding="utf-8") == "mine"


def kept_elsewhere(path, device=None, **about):
    """A session of a sweep, as others may have written it."""
    recorded = swept(Rig(), 1e-3 * np.array([8, 12, 16, 20, 24]), 1.0)
    tests = tuple(
        Test(
            number,
            "spring",
            {name: getattr(test, name) for name in ("voltage", "current", "position")},
            2000.0,
            surface_position_m=test.rest_m,
            notes={"stage_m": test.stage_m},
        )
        for number, test in enumerate(recorded, start=1)
    )
    described = {"model": "desktop", "serial_number": "D-7"} | (device or {})
    write_session(path, Session(DeviceDescription(**described), tests=tests, **about))
    return path


def test_a_kept_sweep_carries_its_time_as_utc_and_the_static_calibration_that_corrected_it(
    tmp_path, monkeypatch, capsys
):
    known = {"static_file": "static.toml", "static_date": "2026-02-01T00:00:00Z", "force_constant_n_per_a": 2.9}
    kept = kept_elsewhere(tmp_path / "kept.h5", {"calibration": known}, created="2026-03-01T12:00:00")
    out = tmp_path / "sweep.toml"
    try:
        monkeypatch.setenv("TZ", "America/New_York")
        time.tzset()
        assert sweep("--kept", kept, "--out", out) == 0
    finally:
        monkeypatch.undo()
        time.tzset()
    made = read_calibration(out)
    assert made.date == "2026-03-01T12:00:00Z"
    assert made.verdict == "passed"
    assert made.conditions["static_file"] == "static.toml"
    assert made.conditions["static_date"] == "2026-02-01T00:00:00Z"


@pytest.mark.parametrize(
    ("about", "device", "words"),
    [
        ({"created": "yesterday"}, {}, "the date of the session is not valid: 'yesterday'"),
        ({"created": ""}, {}, "the date of the session is not valid: ''"),
        ({"created": "0001-01-01T00:00:00+14:00"}, {}, "is not valid: '0001-01-01T00:00:00+14:00'"),
        ({"created": "0001-01-01T00:00:00Z"}, {}, "the date of the session is not plausible: 1"),
        ({"session_id": 1000 * "x"}, {}, "the sweep cannot be stored: field 'conditions.session_id'"),
        ({}, {"serial_number": "D-7\nD-8"}, "it must be a line of 1 to 200 characters"),
        ({}, {"coil_resistance_ohm": 0.0}, "coil_resistance_ohm is 0, which is impossible"),
    ],
)
def test_a_foreign_session_that_cannot_be_used_is_said_in_a_line(tmp_path, capsys, about, device, words):
    kept, out = kept_elsewhere(tmp_path / "kept.h5", device, **about), tmp_path / "sweep.toml"
    assert words in complaint(capsys, "--kept", kept, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["--json", "sweep.toml"],
        ["--report", "sweep.toml"],
        ["--session", "sweep.toml"],
        ["--session", "a.h5", "--json", "../{0}/a.h5"],
    ],
)
def test_one_file_for_two_things_is_refused_before_anything_is_done(device, tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    named = [argument.format(tmp_path.name) for argument in arguments]
    said = complaint(capsys, "--device", "spring", "--out", "sweep.toml", *named)
    assert shows(said, "file.twice", path=arguments[1])
    assert len(device) == 1
    assert not list(tmp_path.iterdir())
