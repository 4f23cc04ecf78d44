"""The in-process instrument, the replay, and discovery."""

import json
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from coded import coded, holding

from tissueid import instrument as instruments
from tissueid.acquisition import GuidedTest, SessionRecorder, run_guided_test, usual_noise
from tissueid.acquisition.background_work import run_while_polling
from tissueid.acquisition.surface_detection import place
from tissueid.analysis import analyse_all
from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LimitError, UnusableInputError
from tissueid.instrument import (
    CLINICAL,
    PROFILES,
    Limits,
    ReplayInstrument,
    SimulatedInstrument,
    discovery,
    find_instruments,
    open_instrument,
)
from tissueid.instrument.tissues import TISSUES
from tissueid.messages import joined
from tissueid.reports.verdict import judge
from tissueid.sessions.quality import quality_of
from tissueid.test_settings import TestSettings


def test_the_same_seed_plays_the_same():
    def once(seed):
        instrument = SimulatedInstrument("forearm", seed=seed)
        instrument.load(np.full(200, 10.0))
        instrument.arm(CLINICAL)
        instrument.start()
        return np.concatenate([instrument.poll(0.0) for _ in range(10)])["position"]

    assert np.array_equal(once(1), once(1))
    assert not np.array_equal(once(1), once(2))


def a_run(url):
    """Position of a tenth of a second under a steady voltage, shape (200,)."""
    instrument = open_instrument(url)
    instrument.load(np.full(200, 20.0))
    instrument.arm(CLINICAL)
    instrument.start()
    return np.concatenate([instrument.poll(0.0) for _ in range(10)])["position"]


@pytest.mark.parametrize("tissue", ["forearm", "anterior-forearm", "baseline"])
def test_without_a_seed_every_opening_differs(tissue):
    first, second = a_run(f"simulated://{tissue}"), a_run(f"simulated://{tissue}")
    assert not np.array_equal(first, second)
    assert np.array_equal(a_run(f"simulated://{tissue}?seed=4"), a_run(f"simulated://{tissue}?seed=4"))
    assert open_instrument(f"simulated://{tissue}").device.serial_number == "TWIN-0"


def sitting(path, tests):
    """Guided tests with one command on the default tissue, by one seed."""
    instrument = open_instrument("simulated://forearm?seed=6")
    recorder = SessionRecorder(path, instrument.device)
    surface_m = place(instrument).surface_m
    test = GuidedTest(usual_noise(2000.0), TestSettings(site="left forearm"))
    for _ in range(tests):
        run_guided_test(instrument, test, recorder, surface_m=surface_m)
    return recorder.finish()


def test_repeats_on_the_default_tissue_are_good_skin_that_varies_as_skin_does(tmp_path):
    """Mass, damping, stiffness of Chen 2010, 3.1.3, VAF of Table 3.1, coefficients of variation of Table 7.1."""
    session = sitting(tmp_path / "s.h5", 6)
    assert session.instrument.simulated
    found = [analyse_all(session, ("lms", "wiener"), test=test) for test in session.tests]
    assert [quality_of(test).verdict for test in session.tests] == ["good"] * 6
    assert {judge(test, analyses).level for test, analyses in zip(session.tests, found, strict=True)} == {"good"}
    linear = [analyses["lms"].model.report for analyses in found]
    for name, thesis in (("mass_kg", 0.0912), ("damping_n_s_per_m", 22.77), ("stiffness_n_per_m", 4670.0)):
        assert np.mean([report.parameters[name].value for report in linear]) == pytest.approx(thesis, rel=0.1)
    assert 83.0 < np.mean([report.vaf_validation_percent for report in linear]) < 92.0
    wiener = [analyses["wiener"].model.report for analyses in found]
    gain = np.mean(
        [w.vaf_validation_percent - lms.vaf_validation_percent for w, lms in zip(wiener, linear, strict=True)]
    )
    assert 1.0 < gain < 10.0
    table = {
        "damping_ratio": 0.044,
        "natural_frequency_rad_per_s": 0.013,
        "scaled_mass_s2": 0.025,
        "scaled_damping_s": 0.044,
        "c1_m": 0.031,
        "c2_per_n": 0.093,
    }
    for name, thesis in table.items():
        values = np.array([report.parameters[name].value for report in wiener])
        # Six repeats: a standard deviation of them is itself off by 30 %.
        assert thesis / 2.2 < values.std(ddof=1) / values.mean() < 2.2 * thesis, name


def pressed(url, tests=2):
    """Final positions of steady presses of 4 N, m."""
    instrument = open_instrument(url)
    found = []
    for _ in range(tests):
        instrument.load(np.full(6000, instrument.device.voltage_for_force(4.0)))
        instrument.arm(CLINICAL)
        instrument.start()
        found.append(np.concatenate([instrument.poll(0.0) for _ in range(300)])["position"][-200:].mean())
    return np.array(found)


def test_people_and_variation_are_asked_for_in_the_address():
    plain = pressed("simulated://forearm?seed=3")
    assert np.array_equal(plain, pressed("simulated://forearm?seed=3"))
    first, second = (pressed(f"simulated://forearm?seed=3&subject={subject}&variation=0") for subject in (1, 2))
    assert abs(first[0] - second[0]) > 0.1e-3
    assert np.ptp(first) < 2e-6  # a person without variation
    varied = [pressed("simulated://forearm?seed=3&subject=1&variation=1") for _ in range(2)]
    assert np.array_equal(*varied)
    assert np.ptp(varied[0]) > 20e-6


def test_an_instrument_says_that_it_is_simulated():
    assert open_instrument("simulated://spring").device.simulated
    assert DeviceDescription(model="desktop indenter (simulated)", serial_number="SIM-0001").simulated
    assert not DeviceDescription(serial_number="D-17").simulated


def test_a_steady_force_meets_the_twin_s_own_stiffness():
    instrument = SimulatedInstrument("spring")
    command = np.full(4000, instrument.device.voltage_for_force(5.0))
    instrument.load(command)
    instrument.arm(CLINICAL)
    instrument.start()
    position = np.concatenate([instrument.poll(0.0) for _ in range(200)])["position"]
    weight = 0.060 * 9.81
    assert position[-200:].mean() == pytest.approx(0.005 + (5.0 + weight) / 1000.0, abs=2e-5)


def test_starting_needs_arming():
    for instrument in (SimulatedInstrument(), ReplayInstrument(DeviceDescription(), {"position": np.zeros(40)})):
        with pytest.raises(InstrumentError, check=coded("instrument.not_armed")):
            instrument.start()


def test_the_in_process_instrument_holds_its_limits():
    instrument = SimulatedInstrument()
    instrument.load(np.full(2000, 47.0))
    with pytest.raises(LimitError, check=coded("limit.stimulus_force", force=11.75, limit=8.0)):
        instrument.arm(Limits(max_force_n=8.0))


def test_a_replay_delivers_what_was_recorded():
    position = np.linspace(0.01, 0.02, 101)
    replay = ReplayInstrument(DeviceDescription(), {"position": position})
    replay.load(np.zeros(1000))
    replay.arm(CLINICAL)
    run = replay.start()
    assert run.samples == 101
    blocks = []
    while (block := replay.poll(0.0)).size:
        blocks.append(block)
    samples = np.concatenate(blocks)
    np.testing.assert_array_equal(samples["position"], position)
    assert np.isnan(samples["current"]).all()


def test_a_replay_needs_something_to_play():
    with pytest.raises(UnusableInputError, check=coded("replay.no_signal")):
        ReplayInstrument(DeviceDescription(), {"mood": np.zeros(3)})


def test_urls_open_what_they_name():
    assert open_instrument("simulated://spring?seed=3").device.serial_number == "TWIN-3"
    with pytest.raises(
        UnusableInputError, check=coded("simulation.unknown_tissue", name="moon", known=joined(TISSUES))
    ):
        open_instrument("simulated://moon")
    with pytest.raises(UnusableInputError, check=coded("simulation.seed", address="simulated://forearm?seed=x")):
        open_instrument("simulated://forearm?seed=x")
    with pytest.raises(InstrumentError, check=coded("link.not_opened", port="/dev/nothing-here")):
        open_instrument("/dev/nothing-here")
    with pytest.raises(InstrumentError, check=coded("link.not_opened", port="socket://127.0.0.1:1")):
        open_instrument("socket://127.0.0.1:1")


def test_discovery_asks_each_port_and_says_why_one_does_not_answer(tmp_path, monkeypatch):
    monkeypatch.setattr(discovery, "user_cache_path", lambda *_, **__: tmp_path)
    monkeypatch.setattr(discovery.list_ports, "comports", list)
    monkeypatch.setattr(discovery, "_alive", lambda pid, _started: pid != 999)
    folder = tmp_path / "simulated"
    folder.mkdir()

    def note(name, pid, url):
        (folder / name).write_text(json.dumps({"url": url, "pid": pid, "preset": "buna", "serial_number": "S"}))

    note("1.json", 1, "good://")
    note("2.json", 2, "silent://")
    note("3.json", 999, "dead://")
    (folder / "4.json").write_text("{half")
    (folder / "5.json").write_text("[]")

    def opener(url):
        if url == "silent://":
            raise InstrumentError("no answer")
        return SimulatedInstrument()

    found = find_instruments(opener=opener)
    answers = {item.url: item.answers for item in found}
    assert answers["good://"] is True
    assert answers["silent://"] is False
    assert "dead://" not in answers
    assert answers["simulated://forearm"] is True
    assert next(item for item in found if item.url == "silent://").detail == "no answer"
    assert find_instruments(probe=False, opener=opener)[0].answers is None
    names = {item.url: item.name for item in found}
    assert names["good://"] == "desktop indenter (in-process simulation), TWIN-0"
    assert names["silent://"] == "simulated firmware, S"
    assert names["simulated://forearm"] == "simulation, forearm"
    assert all(item.name for item in find_instruments(probe=False, opener=opener))
    assert sorted(path.name for path in folder.iterdir()) == ["1.json", "2.json", "4.json", "5.json"]


def started(pid):
    """When a process began, by its own account of proc(5)."""
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19])


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_note_counts_only_while_the_process_that_left_it_lives(tmp_path, monkeypatch):
    monkeypatch.setattr(discovery, "user_cache_path", lambda *_, **__: tmp_path)
    monkeypatch.setattr(discovery.list_ports, "comports", list)
    folder = tmp_path / "simulated"
    folder.mkdir()

    def note(name, **fields):
        text = json.dumps({"url": f"{name}://", "preset": "buna", "serial_number": name} | fields)
        (folder / f"{name}.json").write_text(text)

    parent = os.getppid()
    note("lives", pid=parent, started=started(parent))
    note("number-of-another", pid=parent, started=started(parent) - 100)
    note("without-a-start", pid=parent)
    note("dead", pid=2**22 + 1, started=5)
    note("own", pid=os.getpid(), started=started(os.getpid()))
    found = [item.url for item in find_instruments(probe=False) if not item.url.startswith("simulated")]
    assert found == ["lives://"]
    assert sorted(path.stem for path in folder.iterdir()) == ["lives", "own"]


@pytest.mark.parametrize(
    ("url", "code"),
    [
        ("simulated:///any/path", "simulation.path"),
        ("simulated:///etc/passwd", "simulation.path"),
        ("simulated://forearm/more", "simulation.path"),
        ("simulated://forearm#more", "simulation.path"),
        ("simulated://unknown", "simulation.unknown_tissue"),
        ("simulated://forearm?speed=3", "simulation.parameter"),
        ("simulated://[", "simulation.address"),
        ("simulated://forearm?seed=\u00b2", "simulation.seed"),
        ("simulated://forearm?seed=", "simulation.seed"),
        ("simulated://forearm?seed=-1", "simulation.seed"),
        ("simulated://forearm?seed=" + "1" * 5000, "simulation.seed"),
        ("simulated://forearm?subject=x", "simulation.seed"),
        ("simulated://forearm?variation=", "simulation.variation"),
        ("simulated://forearm?variation=nan", "simulation.variation"),
        ("simulated://forearm?variation=9", "simulation.variation"),
        ("simulated:///nothing/here.toml", "twin.unreadable"),
        ("simulated:///no%00thing.toml", "twin.unreadable"),
        ("simulated://\x1b[31mforearm", "simulation.address"),
    ],
)
def test_an_address_of_no_simulation_is_refused_in_one_short_line(url, code):
    with pytest.raises(UnusableInputError, check=coded(code)) as caught:
        open_instrument(url)
    assert len(caught.value.message) < 300
    assert "\n" not in caught.value.message


@pytest.mark.parametrize("scheme", ["spy", "SPY", "loop", "alt", "hwgrep", "file", "http"])
def test_unsupported_schemes_of_an_address_are_refused(tmp_path, scheme):
    file = tmp_path / "written"
    with pytest.raises(InstrumentError, check=holding("link.scheme")):
        open_instrument(f"{scheme}:///dev/null?file={file}")
    assert not file.exists()


def test_the_detail_of_a_found_instrument_is_empty_by_default():
    assert instruments.FoundInstrument("a", "b", None).detail == ""


def test_the_simulation_is_held_to_real_time():
    now = [100.0]
    waits = []

    def wait(seconds):
        waits.append(seconds)
        now[0] += seconds

    paced = SimulatedInstrument()
    paced.play_in_real_time(wait, clock=lambda: now[0])
    paced.load(np.zeros(4000))
    paced.arm(PROFILES["clinical"])
    paced.start()
    for _ in range(100):
        paced.poll(0.05)
    assert now[0] == pytest.approx(101.0)
    assert max(waits) == pytest.approx(0.01)
    now[0] += 5.0  # a slow moment is not made up for by waiting
    waits.clear()
    paced.poll(0.05)
    assert waits == [0.0]


def test_work_before_a_run_does_not_change_what_a_simulation_in_real_time_plays():
    def once(work_s):
        instrument = SimulatedInstrument("forearm", seed=1)
        instrument.play_in_real_time(lambda _: None)
        run_while_polling(instrument, lambda: threading.Event().wait(work_s))
        instrument.load(np.full(200, 10.0))
        instrument.arm(CLINICAL)
        instrument.start()
        return np.concatenate([instrument.poll(0.0) for _ in range(10)])["position"]

    assert np.array_equal(once(0.0), once(0.1))
