"""Rest between repeats: what is foreseen of the coil, against the simulated instrument's own model of it."""

import math

import numpy as np
import pytest
import support
from coded import coded, says, shows
from support import LONG_TICK_S, connect, connect_scenario

from firmware_sim.scenario import Scenario
from tissueid.acquisition import usual_noise
from tissueid.acquisition.background_work import predict_heating, rest, temperature_c
from tissueid.cli import main
from tissueid.device import DESKTOP, HANDHELD
from tissueid.errors import CancelledError
from tissueid.procedures import test_run
from tissueid.sessions import read_session
from tissueid.sessions.quality import quality_of
from tissueid.stimuli.base import to_voltage


def command(device, most_n=10.5, seconds=4.0):
    stimulus = usual_noise(device.sample_rate_hz, force_max_n=most_n, seconds=seconds)
    return to_voltage(stimulus.values, device)


def foreseen(repeats, rest_s=0.0, device=DESKTOP, begin_c=23.0, **noise):
    return predict_heating(
        command(device, **noise), device, repeats=repeats, rest_s=rest_s, begin_c=begin_c, limit_c=80.0
    )


def test_the_coil_warms_as_its_heat_capacity_says():
    joules = float(np.sum(command(DESKTOP) ** 2)) / 2000.0 / 12.0
    first = foreseen(1).temperatures_c[0]
    assert first == pytest.approx(23.0 + joules / 16.5, abs=1.0)  # less what it lost, more what warm copper adds
    assert foreseen(1).warning == ""


def test_five_default_repeats_on_the_desktop_need_a_rest():
    found = foreseen(5)
    assert found.first_too_hot == 5
    assert says(found.warning, "test.needs_rest", test=5, count=5, rest=found.rest_s)
    assert foreseen(4).warning == ""
    assert foreseen(5, rest_s=found.rest_s).warning == ""
    assert foreseen(5, rest_s=found.rest_s - 5.0).warning != ""


def test_heat_that_no_rest_prevents_is_reported():
    found = foreseen(1, begin_c=70.0)
    assert found.rest_s is None
    assert says(found.warning, "test.too_warm", test=1)


def test_many_repeats_come_to_a_balance():
    found = foreseen(100)
    assert found.rest_s is not None
    assert foreseen(100, rest_s=found.rest_s).first_too_hot is None


def test_a_smaller_coil_warms_by_its_own_size():
    assert foreseen(3, device=HANDHELD, most_n=7.9).temperatures_c[-1] > foreseen(3, most_n=7.9).temperatures_c[-1]


def test_rest_lasts_by_the_clock_of_the_instrument_and_can_be_cancelled():
    instrument = connect()
    assert temperature_c(instrument) == pytest.approx(23.0, abs=1.0)
    before, seen = instrument.link.now, []
    rest(instrument, 2.0, progress=seen.append)
    assert instrument.link.now - before == pytest.approx(2.0, abs=0.1)
    assert seen[-1] == 1.0
    with pytest.raises(CancelledError, check=coded("test.cancelled_between")):
        rest(instrument, 2.0, cancelled=lambda: True)


@pytest.fixture
def desktop(monkeypatch):
    monkeypatch.setattr(support, "TICK_S", LONG_TICK_S)
    monkeypatch.setattr(test_run, "open_instrument", lambda _: connect_scenario(Scenario(seed=3)))


def run(tmp_path, *arguments):
    files = ["--out", tmp_path / "s.h5", "--json", tmp_path / "s.json"]
    return main([*map(str, ["test", "--device", "x", "--site", "arm", *files, *arguments])])


def test_without_rest_a_warning_precedes_the_stop_and_the_recording_is_kept(desktop, tmp_path, capsys):
    assert run(tmp_path, "--repeats", 2, "--min-force", 8.5, "--max-force", 12) == 2
    printed = capsys.readouterr().err
    assert printed.startswith("warning: ")
    assert shows(printed, "test.needs_rest", test=2, count=2)
    tests = read_session(tmp_path / "s.h5").tests
    assert [test.status for test in tests] == ["completed", "aborted"]
    codes = {finding.message.code for finding in quality_of(tests[-1]).findings}
    assert "quality.coil_warm.calculated" in codes
    assert (tmp_path / "s.json").read_text().count('"status": "completed"') == 1


@pytest.mark.soak
def test_with_the_rest_that_is_advised_all_repeats_are_completed(desktop, tmp_path, capsys):
    advised = foreseen(5).rest_s
    assert run(tmp_path, "--repeats", 5, "--rest", advised) == 0
    assert "warning" not in capsys.readouterr().err
    assert [test.status for test in read_session(tmp_path / "s.h5").tests] == 5 * ["completed"]


def test_rest_without_repeats_is_refused(desktop, tmp_path, capsys):
    assert run(tmp_path, "--rest", 5) == 2
    assert "it needs --repeats" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_an_unreadable_sensor_foretells_nothing():
    instrument = connect()
    blank = instrument.poll(0.05).copy()
    blank["temperature"] = np.nan
    instrument.poll = lambda _: blank
    assert math.isnan(temperature_c(instrument))
