"""The simulated firmware as a process: a real pseudo-terminal or socket, a real clock, real mishaps."""

import json
import socket
import subprocess
import sys
import threading

import numpy as np
import pytest
from coded import coded
from firmware_sim_process import firmware_process, firmware_thread

from firmware_sim.__main__ import main
from firmware_sim.bench import Bench
from firmware_sim.faults import PlannedFault
from firmware_sim.firmware import Firmware
from firmware_sim.scenario import Scenario
from firmware_sim.server import Server, TcpPort
from tissueid import wire
from tissueid.errors import FirmwareFaultError, InstrumentError, LinkLostError, ProtocolVersionError
from tissueid.instrument import CLINICAL, SerialInstrument, SerialLink

CABLES = ["--pty", "--tcp=0"] if sys.platform != "win32" else ["--tcp=0"]


def run_simulator(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "firmware_sim", *arguments], capture_output=True, text=True, check=False, timeout=60
    )


def stream(instrument, samples):
    """Poll until ``samples`` have come; returns how many were lost."""
    received = lost = 0
    while received < samples:
        block = instrument.poll(0.1)
        received += block.size
        lost += int(np.isnan(block["position"]).sum())
    return lost


@pytest.mark.parametrize("cable", [CABLES[0], *(pytest.param(cable, marks=pytest.mark.soak) for cable in CABLES[1:])])
def test_twenty_seconds_of_streaming_lose_nothing(cable):
    with firmware_process(cable, "--speed", "20") as (url, _), SerialInstrument(SerialLink(url)) as instrument:
        assert stream(instrument, 40_000) == 0
        assert instrument.gaps == []
        assert instrument.statistics.refused == 0


@pytest.mark.soak
@pytest.mark.parametrize("cable", CABLES)
def test_ten_minutes_of_streaming_lose_nothing(cable):
    with firmware_process(cable) as (url, _), SerialInstrument(SerialLink(url)) as instrument:
        assert stream(instrument, 600 * 2000) == 0
        assert instrument.statistics.refused == 0


def start_run(instrument):
    instrument.load(np.full(8000, 10.0))
    instrument.arm(CLINICAL)
    return instrument.start()


@pytest.mark.parametrize("cable", CABLES)
def test_a_killed_firmware_is_a_lost_link(cable):
    with firmware_process(cable, "--speed", "2") as (url, process):
        instrument = SerialInstrument(SerialLink(url))
        start_run(instrument)
        stream(instrument, 500)
        process.kill()
        with pytest.raises(LinkLostError):
            stream(instrument, 100_000)
        instrument.close()


@pytest.mark.parametrize(
    ("kind", "error", "words"),
    [
        ("reset", FirmwareFaultError, "restarted by itself"),
        ("stall", LinkLostError, "went silent"),
        ("unplug", LinkLostError, r"broke|went silent"),
        ("button", FirmwareFaultError, "button was pressed"),
        ("brown_out", FirmwareFaultError, "supply"),
        ("open_coil", FirmwareFaultError, "coil"),
        ("wrong_version_frames", ProtocolVersionError, "protocol 2"),
    ],
)
def test_planned_faults_happen(kind, error, words):
    with firmware_thread(CABLES[0], speed=4.0, faults=[{"kind": kind, "after_start_s": 0.5}]) as port:
        instrument = SerialInstrument(SerialLink(port.url))
        start_run(instrument)
        with pytest.raises(error, match=words):
            stream(instrument, 100_000)
        instrument.close()


@pytest.mark.parametrize("cable", CABLES)
def test_a_cable_that_is_put_back_can_be_opened_again(cable):
    unplug = {"kind": "unplug", "in_state": "running", "after_s": 0.3, "seconds": 1.0}
    with firmware_thread(cable, speed=4.0, faults=[unplug]) as port:
        back = threading.Event()
        put_back = port.replug
        port.replug = lambda: (put_back(), back.set())
        instrument = SerialInstrument(SerialLink(port.url))
        start_run(instrument)
        with pytest.raises(LinkLostError):
            stream(instrument, 100_000)
        instrument.close()
        assert back.wait(20.0)
        again = SerialInstrument(SerialLink(port.url))  # a serial port that comes back may have another name
        assert stream(again, 2000) == 0
        again.close()


def test_a_line_that_loses_and_damages_costs_samples_and_no_test():
    trouble = {"in_state": "running", "share": 0.05, "seconds": 20.0}
    faults = [{"kind": kind, **trouble} for kind in ("drops", "bit_flips")]
    with (
        firmware_thread(CABLES[0], speed=4.0, faults=faults) as port,
        SerialInstrument(SerialLink(port.url)) as instrument,
    ):
        run = start_run(instrument)
        samples = [instrument.poll(0.1)]
        while not samples[-1].size or samples[-1]["index"][-1] < run.end_index:
            samples.append(instrument.poll(0.1))
    samples = np.concatenate(samples)
    played = samples[(samples["index"] > run.first_index + 200) & (samples["index"] < run.end_index)]
    assert 0 < np.isnan(played["position"]).sum() < played.size / 3
    assert np.array_equal(np.diff(samples["index"]), np.ones(samples.size - 1))
    assert np.nanmax(np.abs(played["command"] - 10.0)) < 0.01


def test_a_drifting_clock_changes_the_device_s_pace_and_nothing_else():
    port = TimedPort()
    firmware = Firmware(Bench("linear-demo"))
    plan = PlannedFault(kind="drifting_clock", in_state="idle", clock_error=0.02, seconds=2.0)
    server = Server(firmware, port, Scenario(faults=(plan,)), clock=lambda: port.now)
    server.run(until=lambda: port.now > 2.0)
    assert firmware.sample_index == pytest.approx(2.0 * 2000 * 1.02, rel=2e-3)
    assert server.stopped_s == 0.0


class DeafPort:
    """A host that sends and never reads."""

    url = "deaf"

    def exchange(self, outgoing, timeout_s):
        return wire.encode_frame(wire.Frame(wire.MessageType.HEARTBEAT)), 0

    def unplug(self):
        pass


def test_a_host_that_does_not_read_loses_frames_and_fills_no_memory():
    clock = iter(np.arange(0.0, 1000.0, 0.005))
    firmware = Firmware(Bench())
    firmware.streaming = True
    server = Server(firmware, DeafPort(), Scenario(), clock=lambda: next(clock))
    rounds = iter(range(600))
    server.run(until=lambda: next(rounds, None) is None)
    assert firmware.dropped_frames > 0
    assert len(server.outgoing) < 200_000


class TimedPort:
    """The other end of a cable in a time of its own: keeps when what came, and speaks at odd moments."""

    url = "timed"

    def __init__(self):
        self.now = 0.0
        self.heard = []
        self.said = {}
        self._decoder = wire.FrameDecoder()

    def exchange(self, outgoing, timeout_s):
        self.heard += [(self.now, frame) for frame in self._decoder.feed(outgoing)]
        self.now += min(0.0001 if outgoing else timeout_s, 0.0037)
        sequence = len(self.said)
        self.said[sequence] = self.now
        hello = wire.pack(wire.HELLO, protocol_min=1, protocol_max=1, host=b"")
        words = [(wire.MessageType.HELLO, hello), (wire.MessageType.STREAM, b"\1"), (wire.MessageType.STOP, b"")]
        kind, payload = words[min(sequence, 2)]
        return wire.encode_frame(wire.Frame(kind, sequence, payload=payload)), len(outgoing)

    def unplug(self):
        pass


def test_frames_leave_when_they_are_whole_and_requests_act_when_they_come():
    port = TimedPort()
    firmware = Firmware(Bench("linear-demo"))
    Server(firmware, port, Scenario(), clock=lambda: port.now).run(until=lambda: port.now > 1.0)
    data = [(at, frame) for at, frame in port.heard if frame.type == wire.MessageType.DATA]
    assert len(data) >= 99
    for at, frame in data:
        assert 0.0 <= at - (frame.sample_index + 20) / 2000 < 0.0005 + 0.0001
    answers = [(at, frame) for at, frame in port.heard if frame.type == wire.MessageType.ACK]
    assert len(answers) > 200
    for at, frame in answers:
        said = port.said[wire.unpack(wire.ACK, frame.payload)[0]["request_sequence"]]
        # The device had lived until the request came, and no further.
        assert frame.sample_index in (int(said * 2000), int(said * 2000 + 1e-6))
        assert at - said < 0.0005


def test_a_machine_that_is_too_busy_stops_the_clock_and_says_so():
    port = TimedPort()
    firmware = Firmware(Bench("linear-demo"))
    server = Server(firmware, port, Scenario(), clock=lambda: port.now)
    server.run(until=lambda: port.now > 0.5)
    assert server.stopped_s == 0.0
    before = firmware.sample_index
    port.now += 0.3
    server.keep_up(port.now)
    assert firmware.sample_index - before == 40
    assert server.stopped_s == pytest.approx(0.28, abs=0.005)
    port.now += 0.01
    server.keep_up(port.now)
    assert firmware.sample_index - before == pytest.approx(60, abs=1)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_port_in_use_cannot_be_opened_twice():
    with firmware_thread("--pty") as port, SerialInstrument(SerialLink(port.url)) as instrument:
        with pytest.raises(InstrumentError, check=coded("link.in_use")):
            SerialLink(port.url)
        assert stream(instrument, 200) == 0


def test_a_second_host_on_a_socket_is_turned_away():
    with firmware_thread("--tcp=0") as port, SerialInstrument(SerialLink(port.url)) as instrument:
        with pytest.raises(LinkLostError):
            SerialInstrument(SerialLink(port.url))
        assert stream(instrument, 2000) == 0


def test_an_impossible_port_is_one_line():
    answer = run_simulator("--tcp", "99999")
    assert answer.returncode == 2
    assert "Traceback" not in answer.stderr


def test_one_host_after_another():
    with firmware_thread(CABLES[0], speed=5.0) as port:
        for _ in range(2):
            with SerialInstrument(SerialLink(port.url)) as instrument:
                run = start_run(instrument)
                assert stream(instrument, 2000) == 0
                assert run.samples == 8000


def test_the_plant_tells_its_own_values(capsys):
    assert main(["--preset", "linear-demo", "--local-values", "0.012"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert {"mass_kg", "damping_n_s_per_m", "stiffness_n_per_m"} <= values.keys()


def test_presets_are_listed(capsys):
    assert main(["--list"]) == 0
    assert "left-posterior-forearm" in capsys.readouterr().out.split()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ('preset = "moon"', "no preset 'moon'; there are: "),
        ("speed = -1", "speed cannot be used"),
        ("speed = nan", "speed cannot be used"),
        ("colour = 3", "colour cannot be used"),
        ('[[faults]]\nkind = "meteor"\nafter_start_s = 1', "faults.0.kind cannot be used"),
        ('[[faults]]\nkind = "reset"', "either after_start_s or in_state"),
        ("= broken", "cannot read the scenario"),
        (None, "cannot read the scenario"),
    ],
)
def test_a_bad_scenario_is_one_line_and_status_2(tmp_path, capsys, content, words):
    path = tmp_path / "scenario.toml"
    if content is not None:
        path.write_text(content)
    assert main(["--scenario", str(path)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert words in printed.err
    assert printed.err.count("\n") == 1


def test_the_status_is_that_of_the_process(tmp_path):
    answer = run_simulator("--scenario", str(tmp_path / "nothing.toml"))
    assert answer.returncode == 2
    assert answer.stderr.count("\n") == 1


def test_a_host_that_follows_another_at_once_is_let_in():
    port = TcpPort(0)
    connections = []
    port.connected = lambda: connections.append(1)
    address = ("127.0.0.1", int(port.url.rpartition(":")[2]))
    for number in range(20):
        host = socket.create_connection(address)
        assert len(connections) == max(0, number - 1), "reported after the last words of the one before"
        assert port.exchange(b"", 1.0) == (b"last words %d" % (number - 1) if number else b"", 0)
        host.sendall(b"last words %d" % number)
        host.close()
    # Each is connected before the port has looked at the end of the one before.
    with socket.create_connection(address) as last:
        assert port.exchange(b"for the one before", 1.0) == (b"last words 19", len(b"for the one before"))
        assert port.exchange(b"for this one", 1.0) == (b"", len(b"for this one"))
        assert last.recv(100) == b"for this one"
        with socket.create_connection(address) as second:
            port.exchange(b"", 1.0)
            assert second.recv(1) == b"", "one at a time"
    assert len(connections) == 21
    port.unplug()
