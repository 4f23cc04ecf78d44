"""How long the host waits for a device that does not do what it should, and what it says then."""

import numpy as np
import pytest
from coded import coded, holding
from faults.cells import ADVICE, fault
from faults.desk import LIMITS, LONGEST_WAIT_S, Desk

from tissueid import wire
from tissueid.errors import FirmwareFaultError, InstrumentError, LinkLostError
from tissueid.instrument.replies import describe_faults
from tissueid.wire import Fault, MessageType


@pytest.fixture
def desk():
    return Desk(seed=5)


def loaded(desk, samples=2000):
    instrument = desk.open()
    instrument.load(np.full(samples, 8.0))
    return instrument


def without(kind):
    """What passes everything to the host but one kind of message."""
    decoder = wire.FrameDecoder()
    return lambda data: b"".join(wire.encode_frame(item) for item in decoder.feed(data) if item.type != kind)


def test_nothing_is_energised_where_no_samples_arrive(desk):
    instrument = loaded(desk)
    desk.link.to_host = without(MessageType.DATA)
    with pytest.raises(LinkLostError, check=coded("link.no_samples", port="loopback")):
        instrument.arm(LIMITS)
    assert not desk.bench.energised().any()


def test_answers_are_no_samples(desk):
    instrument = loaded(desk, 8000)
    instrument.arm(LIMITS)
    instrument.start()
    desk.link.to_host = without(MessageType.DATA)
    began = desk.link.now
    with pytest.raises(LinkLostError, check=holding("link.silent", seconds=0.5)):
        while True:
            instrument.request_status()
            instrument.poll(0.05)
    assert desk.link.now - began < 0.6
    instrument.close()
    assert not desk.firmware.energised


def test_a_restart_is_the_reason_why_a_request_is_refused(desk):
    instrument = loaded(desk)
    desk.befall(fault("reset"))
    with pytest.raises(FirmwareFaultError, check=coded("instrument.restarted")):
        instrument.arm(LIMITS)
        instrument.start()


def test_a_device_that_does_not_answer_is_given_up_in_time(desk):
    instrument = loaded(desk)
    instrument.arm(LIMITS)
    desk.befall(fault("drops", share=1.0, direction="to_device", seconds=100.0))
    began = desk.link.now
    with pytest.raises(InstrumentError, check=holding("fault.watchdog")):
        instrument.start()
    instrument.release()
    assert desk.link.now - began < LONGEST_WAIT_S


def test_what_arrived_while_a_stimulus_was_sent_does_not_wait_for_the_run(desk):
    instrument = loaded(desk, 60_000 // 4)
    before = desk.firmware.sample_index
    instrument.arm(LIMITS)
    run = instrument.start()
    first = instrument.poll(0.05)["index"][0]
    assert before < first
    assert run.first_index - first < 100
    assert instrument.gaps == []
    instrument.close()


@pytest.mark.parametrize("one", [item for item in Fault if item])
def test_every_fault_is_described_with_a_remedy(one):
    assert ADVICE.search(describe_faults(one))
