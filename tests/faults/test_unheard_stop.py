"""What a device did while nothing was heard of it: stopped a test, or played it to its end."""

import numpy as np
import pytest
from coded import says
from faults.cells import SURFACE_M, fault, feedback, open_loop, rest
from faults.desk import Desk

from tissueid import wire
from tissueid.acquisition import run_guided_test
from tissueid.errors import FirmwareFaultError, InstrumentError
from tissueid.instrument.replies import describe_faults
from tissueid.wire import Fault, MessageType, State

STIMULUS_SAMPLES = 2600


class Deaf:
    """A line that loses the next ``most`` STATUS messages on their way to the host."""

    def __init__(self, most=np.inf):
        self.lost, self._most = 0, most
        self._decoder = wire.FrameDecoder()

    def __call__(self, data):
        return b"".join(wire.encode_frame(item) for item in self._decoder.feed(data) if not self._loses(item))

    def _loses(self, frame):
        lost = frame.type == MessageType.STATUS and self.lost < self._most
        self.lost += lost
        return lost


def stopped_test(tmp_path, at, deaf):
    """A test whose device loses its supply at that sample of the run, through a line that loses what it says of it."""
    desk = Desk(seed=2)
    instrument = desk.open()
    recorder = desk.recorder(tmp_path / "sitting.h5", instrument)

    def sag():
        desk.link.to_host = deaf
        desk.befall(fault("brown_out", seconds=0.1))

    desk.link.moments.append((lambda link: link.running > at, sag))
    with pytest.raises(FirmwareFaultError) as caught:
        run_guided_test(instrument, open_loop(seed=1), recorder, surface_m=SURFACE_M)
    assert not desk.firmware.energised
    assert desk.firmware.state is State.FAULT
    desk.link.to_host = lambda data: data
    instrument.clear_faults()
    rest(instrument, 0.2)
    instrument.close()
    (test,) = recorder.finish().tests
    return test, caught.value.message


@pytest.mark.parametrize("lost", [1, 2, 10, 50])
def test_what_the_device_says_is_asked_for_until_it_comes(tmp_path, lost):
    deaf = Deaf(lost)
    test, message = stopped_test(tmp_path, 1000, deaf)
    assert says(message, "instrument.released", why=describe_faults(Fault.BROWN_OUT))
    assert deaf.lost == lost
    assert test.status == "aborted"
    assert 1000 < test.samples < 1100 + 25 * lost


@pytest.mark.parametrize("before_the_end", [1500, 300, 60, 30])
def test_without_a_word_from_the_device_its_samples_tell(tmp_path, before_the_end):
    test, message = stopped_test(tmp_path, STIMULUS_SAMPLES - before_the_end, Deaf())
    assert says(message, "instrument.stopped")
    assert test.status == "aborted"
    stopped_at = STIMULUS_SAMPLES - before_the_end
    assert stopped_at < test.samples <= stopped_at + 40, "what came after the release is no part of the test"
    assert 20 <= test.notes["samples_after_release"] <= before_the_end
    assert np.nanmin(np.abs(np.asarray(test.signals["command"])[-10:])) > 0.0


@pytest.mark.parametrize("before_the_end", [60, 300, 700])
def test_a_device_that_is_heard_again_when_its_run_is_over_is_sent_no_more_set_points(tmp_path, before_the_end):
    desk = Desk(seed=2)
    instrument = desk.open()
    recorder = desk.recorder(tmp_path / "sitting.h5", instrument)
    hang = fault("stall", seconds=0.45)
    desk.link.moments.append((lambda link: link.running > STIMULUS_SAMPLES - before_the_end, lambda: desk.befall(hang)))
    run_guided_test(instrument, feedback(), recorder, surface_m=SURFACE_M)
    instrument.close()
    (test,) = recorder.finish().tests
    lost = np.isnan(np.asarray(test.signals["position"]))
    assert (test.status, test.samples) == ("completed", STIMULUS_SAMPLES)
    assert before_the_end - 40 <= np.count_nonzero(lost) <= before_the_end + 20
    assert lost[-1]


def end_unseen(tmp_path, *, trips, words_lost):
    """Run a test whose last samples and the next ``words_lost`` STATUS messages are lost; it may have stopped."""
    desk = Desk(seed=2)
    instrument = desk.open()
    recorder = desk.recorder(tmp_path / "sitting.h5", instrument)
    decoder, words, lost_to = wire.FrameDecoder(), Deaf(words_lost), [0]

    def loses(data):
        kept = []
        for frame in decoder.feed(words(data)):
            lost = frame.type == MessageType.DATA and frame.sample_index <= lost_to[0]
            kept += [] if lost else [wire.encode_frame(frame)]
        return b"".join(kept)

    def befall():
        lost_to[0] = desk.firmware.sample_index + 70
        desk.link.to_host = loses
        if trips:
            desk.befall(fault("brown_out", seconds=0.02))

    desk.link.moments.append((lambda link: link.running > STIMULUS_SAMPLES - 50, befall))
    error = None
    try:
        run_guided_test(instrument, open_loop(seed=1), recorder, surface_m=SURFACE_M)
    except InstrumentError as caught:
        error = caught
    desk.link.to_host = lambda data: data
    rest(instrument, 0.2) if error is None else instrument.clear_faults()
    instrument.close()
    (test,) = recorder.finish().tests
    return test, error


@pytest.mark.parametrize("trips", [True, False])
def test_a_test_whose_unseen_end_is_not_confirmed_is_not_complete(tmp_path, trips):
    test, error = end_unseen(tmp_path, trips=trips, words_lost=np.inf)
    assert test.status == "aborted"
    received = np.flatnonzero(np.isfinite(np.asarray(test.signals["position"])))
    missing = STIMULUS_SAMPLES - 1 - received[-1]
    assert says(error.message, "instrument.end_unseen", missing=missing)
    assert test.notes["reason"] == str(error)
    assert 30 <= missing <= 70


def test_an_unseen_stop_is_reported_by_the_requested_status(tmp_path):
    test, error = end_unseen(tmp_path, trips=True, words_lost=2)
    assert isinstance(error, FirmwareFaultError)
    assert error.faults == Fault.BROWN_OUT
    assert test.status == "aborted"


def test_a_test_whose_unseen_end_is_confirmed_is_complete(tmp_path):
    test, error = end_unseen(tmp_path, trips=False, words_lost=2)
    assert error is None
    lost = np.isnan(np.asarray(test.signals["position"]))
    assert (test.status, test.samples) == ("completed", STIMULUS_SAMPLES)
    assert lost[-20:].all()
    assert test.notes["samples_lost"] == np.count_nonzero(lost)
