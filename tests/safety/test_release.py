"""A release that the line swallows, and samples that come while the host waits for an answer: the coil is freed."""

import random
from dataclasses import replace

import numpy as np
import pytest
from coded import coded, holding, says
from safety.rigs import WIDE, last_energised, rig, run_until_it_ends, volts, without_firmware

from firmware_sim.bench import Bench
from firmware_sim.firmware import WATCHDOG_S
from firmware_sim.plant import PlantParameters
from tissueid import wire
from tissueid.errors import LimitError, LinkLostError, TissueIDError
from tissueid.instrument.replies import describe_faults
from tissueid.messages import code_of
from tissueid.wire import Fault, MessageType, State

SHORTED = PlantParameters(resistance_ohm=8.0)
WEAK = replace(WIDE, max_force_n=5.0)


def without(*kinds):
    """What passes a line in whole frames that loses those of some types."""
    decoder = wire.FrameDecoder()

    def passes(data):
        return b"".join(wire.encode_frame(frame) for frame in decoder.feed(data) if frame.type not in kinds)

    return passes


def answers_lost(kind):
    """What passes a line that loses the answers to requests of one type."""
    decoder = wire.FrameDecoder()

    def passes(data):
        frames = (f for f in decoder.feed(data) if f.type != MessageType.ACK or f.payload[0] != kind)
        return b"".join(wire.encode_frame(frame) for frame in frames)

    return passes


def running(instrument=None, level=8.0, limits=WIDE):
    instrument = instrument or rig()
    instrument.load(volts(level, 3.0))
    instrument.arm(limits)
    instrument.start()
    for _ in range(3):
        instrument.poll(0.05)
    assert instrument.link.firmware.energised
    return instrument


def seconds_until_free(instrument):
    """From now on, while the host continues to poll."""
    link, began = instrument.link, instrument.link.now
    while link.firmware.energised and link.now - began < 5.0:
        try:
            instrument.poll(0.05)
        except TissueIDError:
            link.run_for(0.01)
    return link.now - began


def test_a_stop_that_is_lost_leaves_the_coil_to_the_watchdog():
    instrument = running()
    link, began = instrument.link, instrument.link.now
    link.to_device = without(MessageType.STOP)
    instrument.release()
    seconds_until_free(instrument)
    assert link.firmware.faults == Fault.WATCHDOG
    instrument.poll(0.0)  # what came before is delivered first
    assert link.now - began <= WATCHDOG_S + 0.1 + 0.02
    for call in (lambda: instrument.poll(0.05), instrument.clear_faults, lambda: instrument.load(volts(8.0, 1.0))):
        with pytest.raises(LinkLostError, check=holding("link.release_unconfirmed", port="loopback")):
            call()


def test_a_stop_that_is_lost_but_for_its_last_repeat_does_no_harm():
    instrument = running()
    link, began = instrument.link, instrument.link.now
    link.to_device = lambda data: b"" if link.now - began < 0.25 else data
    instrument.release()
    assert link.firmware.faults == Fault.NONE
    assert link.now - began < 0.35
    instrument.arm(WIDE)  # and the next test can be
    instrument.start()
    for _ in range(100):
        instrument.poll(0.05)
    assert link.firmware.energised


def test_whatever_is_lost_after_a_release_the_coil_is_free_in_time():
    for seed in range(50):
        instrument = running()
        link, chance = instrument.link, random.Random(seed)
        link.to_device = lambda data, chance=chance: b"" if chance.random() < 0.3 else data
        link.to_host = lambda data, chance=chance: b"" if chance.random() < 0.3 else data
        began = link.now
        instrument.release()
        seconds_until_free(instrument)
        assert not link.firmware.energised
        assert link.now - began <= 0.7, seed  # the release itself may wait 0.6 s for its answer
        assert link.firmware.faults in (Fault.NONE, Fault.WATCHDOG)


def test_a_coil_that_is_on_though_nothing_runs_is_released_again():
    for lost in (MessageType.DATA, MessageType.STATUS):  # the other one shows it
        instrument = running()
        instrument.release()
        link = instrument.link
        link.run_for(0.2)
        instrument.poll(0.05)
        link.to_host = without(lost)
        link.firmware.enter(State.RUNNING)
        assert seconds_until_free(instrument) < 0.2
        assert link.firmware.faults == Fault.NONE


def test_the_soft_release_of_a_run_is_no_reason_to_stop_it():
    instrument = rig()
    link, sent = instrument.link, []
    link.to_device = lambda data: sent.append(data) or data
    instrument.load(volts(8.0, 0.6))
    instrument.arm(WIDE)
    run = instrument.start()
    sent.clear()
    newest = run.first_index
    while newest < run.end_index + 400:
        newest = instrument.poll(0.05)["index"][-1]
        instrument.request_status()
    kinds = {frame.type for frame in wire.FrameDecoder().feed(b"".join(sent))}
    assert kinds == {MessageType.HEARTBEAT, MessageType.STATUS_REQUEST}


@pytest.mark.parametrize("kind", [MessageType.START, MessageType.FINISH], ids=lambda kind: kind.name)
def test_samples_are_judged_while_an_answer_is_waited_for(monkeypatch, kind):
    without_firmware(monkeypatch)
    bench = Bench(seed=1, parameters=SHORTED, nominal=PlantParameters())
    instrument = rig(bench, watchdog_s=1e9)
    link, firmware = instrument.link, instrument.link.firmware
    instrument.load(volts(19.5, 6.0))
    instrument.arm(WEAK)
    if kind == MessageType.START:
        link.to_host = answers_lost(kind)
        with pytest.raises(LimitError, check=coded("limit.force", force=pytest.approx(5.5, abs=0.5), limit=5.0)):
            instrument.start()
    else:
        instrument.start()
        while instrument.poll(0.05)["current"].max() * 3.0 < 4.5:
            pass
        link.to_device = without(kind)
        with pytest.raises(LimitError, check=coded("limit.force", force=pytest.approx(5.5, abs=0.5), limit=5.0)):
            instrument.finish()
    assert not firmware.energised
    delivered = []
    with pytest.raises(LimitError, check=coded("limit.force", limit=5.0)):
        while True:
            delivered.append(instrument.poll(0.05))
    samples = np.concatenate(delivered)
    assert np.array_equal(np.diff(samples["index"]), np.ones(samples.size - 1))
    broken = int(samples["index"][np.argmax(np.abs(samples["current"]) * 3.0 > 5.25)])
    assert last_energised(samples) - broken <= 60


def test_an_unanswered_start_is_followed_by_a_release():
    instrument = rig()
    link = instrument.link
    instrument.load(volts(8.0, 5.0))
    instrument.arm(WIDE)
    link.to_host = answers_lost(MessageType.START)
    with pytest.raises(LinkLostError, check=coded("link.no_answer", request="START")):
        instrument.start()
    assert not link.firmware.energised


def test_a_host_that_connects_while_the_coil_is_on_does_not_keep_it_on():
    link = running().link
    link.to_device = without(MessageType.RELEASE, MessageType.CLEAR_FAULTS)
    with pytest.raises(LinkLostError, check=coded("link.no_answer", request="RELEASE")):
        type(running())(link, clock=link.clock)
    assert link.firmware.faults == Fault.WATCHDOG


def test_the_calibrated_limit_is_held_on_what_is_measured(monkeypatch):
    without_firmware(monkeypatch)
    bench = Bench(seed=1, parameters=SHORTED, nominal=PlantParameters())
    instrument = rig(bench, watchdog_s=1e9)
    # 13.4 V asks for 3.4 N, or 4.0 N by the calibration; the shorted coil draws 5.0 N, or 6.0 N by the calibration.
    instrument.use_calibration(replace(instrument.device, force_constant_n_per_a=3.6), {})
    limits = replace(WIDE, max_force_n=5.4)
    samples, _, error = run_until_it_ends(instrument, volts(13.4, 2.0), limits)
    assert isinstance(error, LimitError)
    assert says(error.message, "limit.force", force=pytest.approx(5.5, abs=0.5))
    amperes = np.abs(samples["current"])
    assert amperes.max() * 3.0 < 5.4, "by the device's own figures nothing is wrong"
    broken = int(samples["index"][np.argmax(amperes * 3.6 > 5.4 * 1.05)])
    assert last_energised(samples) - broken <= 60


def test_an_unknown_fault_is_described_as_one():
    assert says(describe_faults(Fault.NONE), "fault.none")
    assert says(describe_faults(Fault(1024)), "fault.unknown")
    both = describe_faults(Fault.BUTTON | Fault(2048)).values["parts"]
    assert [code_of(part) for part in both.items] == ["fault.button", "fault.unknown"]
