"""The conformance suite passes on both firmwares, and fails on each defect; a device that answers nonsense ends it."""

import json
import re
from pathlib import Path

import pytest
from coded import coded
from reference.lines import PythonLine, ReferenceLine, run_on
from reference.mutants import MUTANTS

from firmware_sim.reference.build import CORE, SOURCES, build_posix
from tissueid import wire
from tissueid.cli import main
from tissueid.errors import UnusableInputError
from tissueid.procedures.control import Control
from tissueid_lab.conformance.clause import CLAUSES
from tissueid_lab.conformance.device import Confirmed, DeviceUnderTest
from tissueid_lab.conformance.exchange import Unattended
from tissueid_lab.conformance.procedure import ConformancePlan, run_conformance
from tissueid_lab.conformance.suite import run_suite

DOCUMENT = Path(SOURCES).parents[1] / "docs" / "protocol.md"
QUICK = [identity for identity in CLAUSES if identity not in ("5.7a",)]
"""5.7a holds a force for 20 s of simulated time."""


@pytest.mark.parametrize("plant", ["free", "dummy"])
def test_the_reference_firmware_conforms(program, plant):
    results = run_on(ReferenceLine(program, "--plant", plant, "--stage", "0.05"))
    beyond_a_dummy = {"5.4f"} if plant == "dummy" else set()  # its potentiometer stays where it is
    assert {item.id for item in results.values() if item.outcome == "not tested"} == beyond_a_dummy
    assert {item.id: item.reason for item in results.values() if item.outcome == "failed"} == {}
    assert results.keys() == CLAUSES.keys()


def test_the_reference_firmware_conforms_at_another_rate(program):
    line = ReferenceLine(program, "--plant", "free", "--rate", "5000")
    line.rate_hz = 5000
    results = run_on(line, QUICK)
    assert {item.id: (item.outcome, item.reason) for item in results.values() if item.outcome != "passed"} == {}


SHORT = [
    item for item in QUICK if item.startswith(("4.1", "4.5", "4.7", "5.")) and item not in ("5.11a", "5.2c", "4.5h")
]


@pytest.mark.parametrize("clauses", [SHORT, pytest.param(list(CLAUSES), marks=pytest.mark.soak)])
def test_the_python_firmware_conforms(clauses):
    results = run_on(PythonLine(), clauses)
    assert {item.id: (item.outcome, item.reason) for item in results.values() if item.outcome != "passed"} == {}


@pytest.mark.parametrize("number", range(len(MUTANTS)), ids=[f"{item[0]}-{k}" for k, item in enumerate(MUTANTS)])
def test_a_defect_fails_its_clause(program, number):
    identity, name, text, defect = MUTANTS[number]
    original = (CORE / name).read_text(encoding="utf-8")
    assert original.count(text) == 1
    mutant = build_posix(options=("-O0", "-w"), replaced={name: original.replace(text, defect)})
    results = run_on(ReferenceLine(mutant, "--plant", "free", "--stage", "0.05"), [identity])
    assert results[identity].outcome == "failed"


def test_each_clause_passes_alone(program):
    """Without a defect: else a mutant that fails would show nothing."""
    found = {}
    for identity in CLAUSES:
        found |= run_on(ReferenceLine(program, "--plant", "free", "--stage", "0.05"), [identity])
    assert {item.id: item.reason for item in found.values() if item.outcome != "passed"} == {}


def test_each_clause_has_a_defect():
    assert set(CLAUSES) == {item[0] for item in MUTANTS}


def test_the_document_lists_the_clauses():
    rows = re.findall(r"^\| (\d[\d.]*[a-z]) \| (.+?) \|$", DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE)
    assert dict(rows) == {item.id: item.title for item in CLAUSES.values()}


class Device:
    """A line to something that is no indenter; time passes at every read."""

    def __init__(self, answer):
        self.answer, self.now, self.written = answer, 0.0, b""

    def read(self, timeout_s):
        self.now += max(timeout_s, 1e-3)
        return self.answer()

    def write(self, data):
        self.written += data

    def clock(self):
        return self.now

    def pause(self, seconds):
        self.now += seconds


HEARTBEATS = wire.encode_frame(wire.Frame(wire.MessageType.HEARTBEAT))


@pytest.mark.parametrize(
    "answer", [lambda: b"", lambda: b"\7" * 5000, lambda: HEARTBEATS * 20], ids=["none", "noise", "flood"]
)
def test_a_device_that_never_answers_ends_the_suite(answer):
    line = Device(answer)
    results = run_suite(DeviceUnderTest(line, Confirmed("free-coil", 1.0, 60.0), Unattended()))
    assert [item.outcome for item in results[:2]] == ["failed", "failed"]
    assert {item.outcome for item in results[2:]} == {"not tested"}
    assert line.now < 60.0


def test_a_handshake_of_nonsense_drives_nothing():
    hello = wire.encode_frame(wire.Frame(wire.MessageType.HELLO_ACK, payload=b"\1\1" + b"\xff" * 400))
    line = Device(lambda: hello)
    results = run_suite(DeviceUnderTest(line, Confirmed("free-coil", 1.0, 60.0), Unattended()))
    assert results[0].outcome == "failed"
    kinds = {frame.type for frame in wire.FrameDecoder().feed(line.written)}
    assert not kinds & {wire.MessageType.ARM, wire.MessageType.START, wire.MessageType.STAGE}


class Consenting(Device):
    """Completes the handshake of the Python firmware, then answers OK to everything, for ever."""

    def __init__(self):
        super().__init__(self.answers)
        bench = PythonLine()
        bench.write(wire.encode_frame(wire.Frame(wire.MessageType.HELLO, 1, payload=b"\1\1" + bytes(30))))
        (self.greeting,) = wire.FrameDecoder().feed(bench.received())
        self.decoder, self.read_to = wire.FrameDecoder(), 0

    def answers(self):
        new, self.read_to = self.written[self.read_to :], len(self.written)
        out = b""
        for frame in self.decoder.feed(new):
            if frame.type == wire.MessageType.HELLO:
                out += wire.encode_frame(self.greeting)
            elif frame.type == wire.MessageType.STATUS_REQUEST:
                out += wire.encode_frame(wire.Frame(wire.MessageType.STATUS, payload=bytes(28)))
            elif frame.type != wire.MessageType.HEARTBEAT:
                ack = wire.pack(wire.ACK, request_type=frame.type, result=0, request_sequence=frame.sequence, detail=0)
                out += wire.encode_frame(wire.Frame(wire.MessageType.ACK, payload=ack))
        return out


def test_a_device_that_answers_ok_to_everything_fails_in_time():
    line = Consenting()
    results = run_suite(DeviceUnderTest(line, Confirmed("free-coil", 1.0, 60.0), Unattended()))
    outcomes = {item.id: item.outcome for item in results}
    assert outcomes["5.3a"] == outcomes["4.3b"] == outcomes["5.2b"] == "failed"
    assert sum(item == "passed" for item in outcomes.values()) < 10
    assert line.now < 120.0


def test_nothing_exceeds_what_is_confirmed(program):
    line = ReferenceLine(program, "--plant", "free")
    written = []
    plain = line.write
    line.write = lambda data: (written.append(data), plain(data))
    run_on(line, QUICK, max_force_n=0.3)
    newton_per_code = 60.0 / 32768.0 / 12.0 * 3.0
    strongest = 0.0
    frames = wire.FrameDecoder().feed(b"".join(written))
    for frame in frames:
        if frame.type in (wire.MessageType.STIMULUS_CHUNK, wire.MessageType.SETPOINTS) and len(frame.payload) % 2 == 0:
            codes = memoryview(frame.payload[8:]).cast("h")
            strongest = max(strongest, *map(abs, codes), 0) if len(codes) else strongest
    assert 0.1 < strongest * newton_per_code <= 0.3 * 1.05 + newton_per_code


class Silent:
    def record(self, *_args, **_named):
        pass


def test_nothing_is_sent_before_a_person_has_confirmed(capsys):
    assert main(["conformance", "--device", "socket://127.0.0.1:9"]) == 2
    assert "--confirm" in capsys.readouterr().err
    assert main(["conformance", "--device", "socket://127.0.0.1:9", "--confirm", "arm"]) == 2


def test_the_port_is_not_opened_before_a_person_has_confirmed():
    def opener(url):
        raise AssertionError(url)

    with pytest.raises(UnusableInputError, check=coded("conformance.unconfirmed")):
        run_conformance(ConformancePlan(device="x"), Control(), Silent(), opener)


def test_the_result_is_a_page_and_a_status(program, tmp_path):
    line = ReferenceLine(program, "--plant", "free")

    class Port:
        name = "line"

        def read(self, timeout_s):
            return line.read(min(timeout_s, 0.01))

        def write(self, data):
            line.write(data)

        def close(self):
            line.device.close()

    page = tmp_path / "page.html"
    plan = ConformancePlan(device="x", attached="free-coil", clauses=("2a", "5.3a", "5.9a"), out=page)
    found = run_conformance(plan, Control(), Silent(), opener=lambda _url: Port())
    assert found.passed
    assert [item.outcome for item in found.results] == ["passed", "passed", "not tested"]
    assert "REF-0001" in page.read_text(encoding="utf-8")
    assert json.dumps(found.headline.as_dict())
