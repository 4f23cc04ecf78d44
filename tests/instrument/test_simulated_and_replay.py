"""The in-process instrument, the replay, and discovery."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from tissueid import instrument as instruments
from tissueid.acquisition import GuidedTest, NoiseChoice, SessionRecorder, run_guided_test
from tissueid.acquisition.placing import place
from tissueid.analysis import analyse_all
from tissueid.device import DeviceDescription
from tissueid.errors import InstrumentError, LimitError, UnusableInputError
from tissueid.instrument import (
    CLINICAL,
    Limits,
    ReplayInstrument,
    SimulatedInstrument,
    discovery,
    find_instruments,
    open_instrument,
)
from tissueid.reports.verdict import judge
from tissueid.sessions.quality import quality_of


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
    test = GuidedTest(NoiseChoice().stimulus(2000.0), "left forearm")
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
        with pytest.raises(InstrumentError, match="arm before starting"):
            instrument.start()


def test_the_in_process_instrument_holds_its_limits():
    instrument = SimulatedInstrument()
    instrument.load(np.full(2000, 47.0))
    with pytest.raises(LimitError, match="reaches 11"):
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
    with pytest.raises(UnusableInputError, match="no signal"):
        ReplayInstrument(DeviceDescription(), {"mood": np.zeros(3)})


def test_urls_open_what_they_name():
    assert open_instrument("simulated://spring?seed=3").device.serial_number == "TWIN-3"
    with pytest.raises(UnusableInputError, match="no simulated tissue 'moon'; there are: forearm"):
        open_instrument("simulated://moon")
    with pytest.raises(UnusableInputError, match="whole number"):
        open_instrument("simulated://forearm?seed=x")
    with pytest.raises(InstrumentError, match="cannot open /dev/nothing-here"):
        open_instrument("/dev/nothing-here")
    with pytest.raises(InstrumentError, match=r"cannot open socket://127.0.0.1:1"):
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
            raise InstrumentError("nobody home")
        return SimulatedInstrument()

    found = find_instruments(opener=opener)
    answers = {item.url: item.answers for item in found}
    assert answers["good://"] is True
    assert answers["silent://"] is False
    assert "dead://" not in answers
    assert answers["simulated://forearm"] is True
    assert next(item for item in found if item.url == "silent://").detail == "nobody home"
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
    ("url", "words"),
    [
        ("simulated:///any/path", "neither a tissue nor a twin"),
        ("simulated:///etc/passwd", "neither a tissue nor a twin"),
        ("simulated://forearm/more", "neither a tissue nor a twin"),
        ("simulated://forearm#more", "neither a tissue nor a twin"),
        ("simulated://nobody", "no simulated tissue"),
        ("simulated://forearm?speed=3", "there is only seed"),
        ("simulated://[", "is no address"),
        ("simulated://forearm?seed=\u00b2", "must be a whole number"),
        ("simulated://forearm?seed=", "must be a whole number"),
        ("simulated://forearm?seed=-1", "must be a whole number"),
        ("simulated://forearm?seed=" + "1" * 5000, "must be a whole number"),
        ("simulated:///nothing/here.toml", "nothing/here.toml"),
        ("simulated:///no%00thing.toml", "toml"),
        ("simulated://\x1b[31mforearm", "is no address"),
    ],
)
def test_an_address_of_no_simulation_is_refused_in_one_short_line(url, words):
    with pytest.raises(UnusableInputError, match=words) as caught:
        open_instrument(url)
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("scheme", ["spy", "SPY", "loop", "alt", "hwgrep", "file", "http"])
def test_kinds_of_address_that_are_not_known_are_refused(tmp_path, scheme):
    file = tmp_path / "written"
    with pytest.raises(InstrumentError, match="no kind of address that is known"):
        open_instrument(f"{scheme}:///dev/null?file={file}")
    assert not file.exists()


def test_a_found_place_has_no_more_to_say_of_itself_than_is_known():
    assert instruments.Found("a", "b", None).detail == ""
