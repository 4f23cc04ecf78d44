"""The in-process instrument, the replay, and discovery."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from tissueid import instrument as instruments
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


def test_the_same_seed_plays_the_same():
    def once(seed):
        instrument = SimulatedInstrument("forearm", seed=seed)
        instrument.load(np.full(200, 10.0))
        instrument.arm(CLINICAL)
        instrument.start()
        return np.concatenate([instrument.poll(0.0) for _ in range(10)])["position"]

    assert np.array_equal(once(1), once(1))
    assert not np.array_equal(once(1), once(2))


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
