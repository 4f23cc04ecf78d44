"""The driver against the simulated firmware, on a link that loses, damages and repeats what it carries."""

import random
from dataclasses import replace

import numpy as np
import pytest
from coded import coded, holding
from support import connect

from firmware_sim import limits as firmware_sim_limits
from firmware_sim.firmware import WATCHDOG_S
from firmware_sim.identity import Identity
from tissueid import wire
from tissueid.errors import (
    FirmwareFaultError,
    InstrumentError,
    LimitError,
    LinkLostError,
    ProtocolVersionError,
)
from tissueid.instrument import CLINICAL, RESEARCH, SAMPLE, Limits, SerialInstrument, run_machine
from tissueid.instrument.replies import describe_faults
from tissueid.instrument.sample_monitor import SampleMonitor
from tissueid.wire import Fault, Flag, State

SECOND = 2000


def hold(volts: float, seconds: float = 1.0) -> np.ndarray:
    return np.full(round(seconds * SECOND), volts)


def collect(instrument, run):
    blocks = []
    while not blocks or blocks[-1]["index"][-1] + 1 < run.end_index:
        block = instrument.poll(0.05)
        if block.size:
            blocks.append(block)
    return np.concatenate(blocks)


def play(instrument, command, limits=CLINICAL):
    instrument.load(command)
    instrument.arm(limits)
    run = instrument.start()
    samples = collect(instrument, run)
    return run, samples[(samples["index"] >= run.first_index) & (samples["index"] < run.end_index)]


def test_handshake_tells_the_device_figures():
    instrument = connect()
    assert instrument.device.coil_resistance_ohm == 12.0
    assert instrument.device.force_constant_n_per_a == 3.0
    assert instrument.device.sample_rate_hz == 2000.0
    assert instrument.device.stroke_m == 0.032
    assert instrument.device.protocol_version == "1"
    assert instrument.device.serial_number == "SIM-0001"


def test_a_run_plays_the_stimulus_sample_by_sample():
    instrument = connect()
    command = np.linspace(0.0, 20.0, 1234)
    run, samples = play(instrument, command)
    assert samples.size == 1234
    assert np.array_equal(samples["index"], run.first_index + np.arange(1234))
    np.testing.assert_allclose(samples["command"], command, atol=60 / 32768)
    np.testing.assert_allclose(samples["voltage"][100:], command[100:], atol=0.1)
    assert np.all(samples["flags"] & Flag.PLAYING)
    assert instrument.gaps == []


def test_the_coil_is_free_after_a_run():
    instrument = connect()
    play(instrument, hold(10.0, 0.2))
    for _ in range(20):
        instrument.poll(0.05)
    assert not instrument.link.firmware.energised
    last = instrument.poll(0.05)
    assert not np.any(last["flags"] & Flag.ENERGISED)
    assert np.all(np.abs(last["voltage"]) < 0.05)


def test_a_second_test_can_follow_at_once():
    instrument = connect()
    play(instrument, hold(4.0, 0.1))
    play(instrument, hold(8.0, 0.1))


@pytest.mark.parametrize("loss", [0.05, 0.3])
def test_requests_survive_a_lossy_link_and_act_once(loss):
    instrument = connect()
    rng = random.Random(3)
    link = instrument.link
    link.to_device = lambda data: b"" if rng.random() < loss else data
    instrument.load(hold(5.0, 2.0))
    instrument.arm(RESEARCH)
    run = instrument.start()
    assert instrument.repeated_requests > 0
    assert link.firmware.state is State.RUNNING
    assert link.firmware.start_index == run.first_index
    assert link.firmware.stimulus.size == 4000


def test_a_new_host_finds_a_device_that_still_streams_for_a_dead_one():
    dead = connect()
    dead.load(hold(10.0, 2.0))
    dead.arm(CLINICAL)
    dead.start()
    link = dead.link
    link.run_for(0.3)
    instrument = SerialInstrument(link, clock=link.clock)
    assert not link.firmware.energised
    _, samples = play(instrument, hold(5.0, 0.3))
    assert not np.isnan(samples["position"]).any()
    assert instrument.gaps == []


def test_a_repeated_start_does_not_start_again():
    instrument = connect()
    instrument.load(hold(5.0))
    instrument.arm(CLINICAL)
    instrument.start()
    firmware = instrument.link.firmware
    instrument.poll(0.3)
    cursor = firmware.player.cursor
    payload = wire.pack(wire.START, token=instrument.state.token)
    start = wire.encode_frame(wire.Frame(wire.MessageType.START, instrument.state.sequence - 1, payload=payload))
    firmware.receive(start, instrument.link.now)
    assert firmware.player.cursor == cursor


def test_lost_samples_are_nan_and_logged():
    instrument = connect()
    link = instrument.link
    instrument.load(hold(5.0, 0.5))
    instrument.arm(CLINICAL)
    run = instrument.start()
    frames = iter(range(10_000))
    link.to_host = lambda data: b"" if next(frames) in (10, 11, 30) else data
    samples = collect(instrument, run)
    samples = samples[(samples["index"] >= run.first_index) & (samples["index"] < run.end_index)]
    assert samples.size == 1000
    lost = np.isnan(samples["position"])
    assert sum(gap.count for gap in instrument.gaps) == lost.sum() > 0
    assert np.array_equal(np.isnan(samples["current"]), lost)
    for gap in instrument.gaps:
        inside = (samples["index"] >= gap.first_index) & (samples["index"] < gap.first_index + gap.count)
        assert lost[inside].all()


def test_duplicated_frames_are_taken_once():
    instrument = connect()
    instrument.link.to_host = lambda data: data + data
    _, samples = play(instrument, hold(5.0, 0.3))
    assert samples.size == 600
    assert not np.isnan(samples["position"]).any()


def test_a_stop_whose_message_was_lost_is_noticed():
    instrument = connect()
    running(instrument)
    link = instrument.link

    def without_status(data):
        frames = wire.FrameDecoder().feed(data)
        return b"".join(wire.encode_frame(f) for f in frames if f.type != wire.MessageType.STATUS)

    link.to_host = without_status
    link.firmware.trip(Fault.STROKE)
    instrument.poll(0.05)
    link.to_host = lambda data: data
    with pytest.raises(FirmwareFaultError, check=holding("fault.stroke")):
        for _ in range(10):
            instrument.poll(0.05)


def test_a_stop_without_a_request_is_not_a_completed_test():
    instrument = connect()
    running(instrument)
    instrument.link.firmware.release(forget=False)
    with pytest.raises(FirmwareFaultError, check=coded("instrument.stopped")):
        for _ in range(20):
            instrument.poll(0.05)


@pytest.mark.parametrize(("oldest", "newest", "what"), [(2, 3, "software"), (0, 0, "firmware")])
def test_a_version_that_it_does_not_speak_is_refused(oldest, newest, what):
    code = f"handshake.{what}_too_old"
    with pytest.raises(ProtocolVersionError, check=coded(code, oldest=oldest, newest=newest)):
        connect(identity=Identity(protocol_min=oldest, protocol_max=newest))


def test_a_firmware_that_does_not_share_a_version_obeys_nothing():
    with pytest.raises(ProtocolVersionError):
        connect(identity=Identity(protocol_min=2, protocol_max=3))


def test_a_program_that_is_interrupted_in_a_request_goes_on():
    instrument = connect()

    def interrupt(data):
        raise KeyboardInterrupt

    instrument.link.to_host = interrupt
    with pytest.raises(KeyboardInterrupt):
        instrument.load(hold(5.0, 0.3))
    instrument.link.to_host = lambda data: data
    instrument.release()
    play(instrument, hold(5.0, 0.3))
    instrument.close()


def test_silence_is_a_lost_link():
    instrument = connect()
    instrument.link.to_host = lambda data: b""
    with pytest.raises(LinkLostError, check=holding("link.silent", seconds=1.0)):
        while True:
            instrument.poll(0.05)


def test_a_line_that_is_taken_says_that_another_program_may_have_it():
    from support import LoopbackLink

    from firmware_sim.bench import Bench
    from firmware_sim.firmware import Firmware

    link = LoopbackLink(Firmware(Bench()))
    link.plugged = False  # a socket whose other end is taken is closed at once
    link.write = lambda data: None
    with pytest.raises(LinkLostError, check=coded("link.maybe_in_use")):
        SerialInstrument(link, clock=link.clock)


def test_nothing_at_the_other_end():
    from support import LoopbackLink

    from firmware_sim.bench import Bench
    from firmware_sim.firmware import Firmware

    link = LoopbackLink(Firmware(Bench()))
    link.to_host = lambda data: b""
    with pytest.raises(LinkLostError, check=coded("link.no_instrument", port="loopback")):
        SerialInstrument(link, clock=link.clock)
    assert link.closed


# -- limits, in the host and in the firmware, each with the other out of the way --------------------------------------


@pytest.mark.parametrize(
    ("command", "limits", "check"),
    [
        (hold(47.0), CLINICAL, None),
        (hold(47.0), replace(CLINICAL, max_force_n=8.0), coded("limit.stimulus_force", force=11.75, limit=8.0)),
        (hold(-40.0), replace(CLINICAL, max_force_n=8.0), coded("limit.stimulus_force", force=10.0)),
        (hold(50.0), RESEARCH, coded("limit.voltage", voltage=50.0, limit=48.0)),
        (hold(1.0, 31.0), RESEARCH, coded("limit.stimulus_time", seconds=31.0, limit=30.0)),
        (np.array([1.0, np.nan]), RESEARCH, coded("limit.command")),
    ],
)
def test_the_host_checks_before_sending(command, limits, check):
    from tissueid.instrument import check_stimulus

    device = connect().device
    if check is None:
        check_stimulus(command, device, limits)
        return
    with pytest.raises(LimitError, check=check):
        check_stimulus(command, device, limits)


def without_host_checks(monkeypatch):
    monkeypatch.setattr(run_machine, "check_stimulus", lambda *_: None)
    monkeypatch.setattr(SampleMonitor, "check", lambda *_: None)


def test_the_firmware_refuses_a_stimulus_beyond_the_limits(monkeypatch):
    without_host_checks(monkeypatch)
    instrument = connect()
    instrument.load(hold(40.0))
    with pytest.raises(LimitError, check=coded("refused.beyond_limits", request="ARM")):
        instrument.arm(Limits(max_force_n=8.0))
    # A host that does not know the limits of the device asks for more.
    instrument.state.handshake = replace(instrument.state.handshake, max_force_n=1000.0)
    with pytest.raises(LimitError, check=coded("refused.beyond_limits", request="ARM")):
        instrument.arm(Limits(max_force_n=16.0))
    assert not instrument.link.firmware.energised


@pytest.mark.parametrize(
    ("limits", "fault"),
    [
        (Limits(max_position_m=0.0125), Fault.STROKE),
        (Limits(max_temperature_c=23.5), Fault.OVER_TEMPERATURE),
    ],
)
def test_the_firmware_releases_on_its_own(monkeypatch, limits, fault):
    without_host_checks(monkeypatch)
    instrument = connect()
    with pytest.raises(FirmwareFaultError, check=coded("instrument.released", why=describe_faults(fault))):
        play(instrument, hold(30.0, 3.0), limits)
    firmware = instrument.link.firmware
    assert firmware.faults == fault
    assert not firmware.energised


def test_the_firmware_trips_on_force_within_one_sample(monkeypatch):
    without_host_checks(monkeypatch)
    instrument = connect()
    monkeypatch.setattr(firmware_sim_limits, "FORCE_MARGIN", 1.0)
    instrument.load(hold(20.0))
    instrument.arm(Limits(max_force_n=5.05))
    firmware = instrument.link.firmware
    firmware.armed = replace(firmware.armed, max_force_n=3.0)
    run = instrument.start()
    blocks = []
    with pytest.raises(FirmwareFaultError, check=holding("fault.over_force")):
        while True:
            blocks.append(instrument.poll(0.05))
    samples = np.concatenate(blocks)
    force = np.abs(samples["current"]) * 3.0
    first = int(np.argmax(force > 3.0))
    assert samples["index"][first] >= run.first_index
    assert samples["flags"][first] & Flag.ENERGISED
    assert not np.any(samples["flags"][first + 1 :] & Flag.ENERGISED)


@pytest.mark.parametrize(
    ("limits", "check"),
    [
        (Limits(max_position_m=0.0125), coded("limit.position", position=pytest.approx(13.4, abs=0.1))),
        (Limits(max_temperature_c=23.5), coded("limit.winding_temperature", temperature=pytest.approx(24.0, abs=0.5))),
        (Limits(max_force_n=3.0), coded("limit.force", limit=3.0)),
    ],
)
def test_the_host_releases_on_its_own(monkeypatch, limits, check):
    monkeypatch.setattr(firmware_sim_limits.ArmedLimits, "first_violation", lambda *_: (0, Fault.NONE))
    monkeypatch.setattr(run_machine, "check_stimulus", lambda *_: None)
    instrument = connect()
    instrument.load(hold(30.0, 3.0))
    firmware = instrument.link.firmware
    instrument.arm(RESEARCH)
    instrument.state.limits = limits
    run = instrument.start()
    with pytest.raises(LimitError, check=check):
        collect(instrument, run)
    assert not firmware.energised


def test_the_watchdog_latches_and_needs_re_arming():
    instrument = connect()
    instrument.load(hold(10.0, 5.0))
    instrument.arm(CLINICAL)
    instrument.start()
    link, firmware = instrument.link, instrument.link.firmware
    link.run_for(WATCHDOG_S - 0.05)
    assert firmware.energised
    link.run_for(0.1)
    assert not firmware.energised
    assert firmware.faults == Fault.WATCHDOG
    with pytest.raises(FirmwareFaultError, check=holding("fault.watchdog")):
        while True:
            instrument.poll(0.05)
    with pytest.raises(FirmwareFaultError, check=coded("refused.fault", request="START")):
        instrument.start()
    instrument.clear_faults()
    assert firmware.state is State.IDLE
    with pytest.raises(InstrumentError, check=coded("refused.state", request="START")):
        instrument.start()
    play(instrument, hold(10.0, 0.1))


def test_an_armed_device_does_not_wait_for_a_dead_host():
    instrument = connect()
    instrument.load(hold(10.0))
    instrument.arm(CLINICAL)
    instrument.link.run_for(1.0)
    assert instrument.link.firmware.state is State.FAULT


# -- everything that can go wrong, in every state ---------------------------------------------------------------------


def loaded(instrument):
    instrument.load(hold(10.0, 2.0))


def armed(instrument):
    loaded(instrument)
    instrument.arm(CLINICAL)


def running(instrument):
    armed(instrument)
    instrument.start()
    instrument.poll(0.3)


def unplug(instrument):
    instrument.link.plugged = False


def reset(instrument):
    instrument.link.firmware.reboot()


def stall(instrument):
    instrument.link.firmware.stall(instrument.link.now + 3.0)


def change_version(instrument):
    def to_version_9(data):
        frames = wire.FrameDecoder().feed(data)
        return b"".join(wire.encode_frame(replace(frame, version=9)) for frame in frames)

    instrument.link.to_host = to_version_9


def go_on(instrument):
    """What a host would do next, whatever the state; ends in an error when something went wrong."""
    for _ in range(100):
        instrument.poll(0.05)
    instrument.load(hold(1.0, 0.1))


@pytest.mark.parametrize("state", [lambda _: None, loaded, armed, running], ids=["idle", "loaded", "armed", "running"])
@pytest.mark.parametrize(
    ("mishap", "error", "check"),
    [
        (unplug, LinkLostError, holding("link.broken", port="loopback")),
        (reset, FirmwareFaultError, coded("instrument.restarted")),
        (stall, LinkLostError, holding("link.silent")),
        (change_version, ProtocolVersionError, coded("link.version_changed", version=9)),
    ],
    ids=["unplug", "reset", "stall", "version"],
)
def test_mishaps_in_every_state(state, mishap, error, check):
    instrument = connect()
    state(instrument)
    mishap(instrument)
    with pytest.raises(error, check=check):
        go_on(instrument)
    link = instrument.link
    link.run_for(1.0)
    assert not link.firmware.energised, "the coil must be free"
    instrument.release()
    instrument.close()
    assert link.closed


def test_what_arrived_before_a_mishap_is_delivered_first():
    instrument = connect()
    running(instrument)
    link = instrument.link
    link.tick()
    link.tick()
    on_the_way = [link.firmware.transmit(link.now)]
    link.firmware.reboot()
    link.to_host = lambda data: (on_the_way.pop() if on_the_way else b"") + data
    received = 0
    with pytest.raises(FirmwareFaultError):
        while True:
            received += instrument.poll(0.05).size
    assert received >= 40


def test_the_button_ends_a_run():
    instrument = connect()
    running(instrument)
    instrument.link.firmware.bench.button = True
    with pytest.raises(FirmwareFaultError, check=holding("fault.button")):
        while True:
            instrument.poll(0.05)
    assert not instrument.link.firmware.energised


# -- a hostile device -------------------------------------------------------------------------------------------------


def test_absurd_frames_do_no_harm():
    instrument = connect()
    link = instrument.link
    junk = [
        wire.Frame(0x83, payload=b"half a sample"),
        wire.Frame(0x83, sample_index=2**63, payload=bytes(16)),
        wire.Frame(0x84, payload=b"?"),
        wire.Frame(0x84, payload=b"\x63" + bytes(19)),  # an unknown state
        wire.Frame(0x82, payload=b""),
        wire.Frame(0xEE, payload=b"from the future"),
    ]
    pending = [b"".join(wire.encode_frame(frame) for frame in junk)]
    link.to_host = lambda data: data + (pending.pop() if pending else b"")
    with pytest.raises(LinkLostError, check=holding("link.gap")):
        for _ in range(10):
            instrument.poll(0.05)


@pytest.mark.parametrize(
    ("spoil", "code"),
    [
        (lambda payload: payload[:60], "damaged"),
        (lambda payload: payload[: wire.HELLO_ACK.itemsize + 5], "damaged"),
        (lambda payload: payload.replace(b"position", b"weather\0"), "channels"),
        (lambda payload: payload[:76] + b"\xff" * 8 + payload[84:], "impossible"),
    ],
    ids=["short", "cut table", "other channels", "rate not a number"],
)
def test_a_damaged_handshake_is_refused(spoil, code):
    from support import LoopbackLink

    from firmware_sim.bench import Bench
    from firmware_sim.firmware import Firmware

    link = LoopbackLink(Firmware(Bench()))

    def tamper(data):
        frames = wire.FrameDecoder().feed(data)
        return b"".join(
            wire.encode_frame(replace(f, payload=spoil(f.payload)) if f.type == wire.MessageType.HELLO_ACK else f)
            for f in frames
        )

    link.to_host = tamper
    with pytest.raises(InstrumentError, check=coded(f"handshake.{code}")):
        SerialInstrument(link, clock=link.clock)


def test_samples_have_the_documented_layout():
    assert SAMPLE.names[0] == "index"
    assert SAMPLE.names[-1] == "flags"
