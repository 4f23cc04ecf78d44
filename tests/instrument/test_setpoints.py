"""Set-points from the host: over a link that loses and repeats, in this process, and from a computer too slow."""

import random
from functools import partial

import numpy as np
import pytest
from coded import coded, holding
from support import connect, softly

from tissueid import wire
from tissueid.device import DeviceDescription
from tissueid.errors import FirmwareFaultError, InstrumentError, LimitError
from tissueid.instrument import CLINICAL, Limits, ReplayInstrument, SimulatedInstrument, run_machine
from tissueid.wire import Fault, Flag, MessageType, Result, State

PRELOAD, BLOCK, COUNT = 200, 50, 1000
STEP_V = 60 / 32768
unexpected = partial(coded, "instrument.unexpected_set_points")


def over_a_link():
    return connect("linear-demo")


def in_process():
    return SimulatedInstrument("forearm")


both = pytest.mark.parametrize("opened", [over_a_link, in_process])


def wave(count=COUNT):
    return 12.0 + 6.0 * np.sin(2 * np.pi * np.arange(count) / 400)


def begin(instrument, count=COUNT, hold_v=10.0, limits=CLINICAL):
    """A run under way whose set-points are still to be sent."""
    instrument.load(np.full(PRELOAD, 10.0))
    instrument.follow(count, hold_v)
    instrument.arm(limits)
    return instrument.start()


def play(instrument, run, volts, *, lead=2, skip=(), until=None):
    """Send ``lead`` blocks ahead of what is received, as a test does; gives the samples of the run, and what follows.

    Blocks in ``skip`` are not sent; ``until`` is the sample after which the run is ended by ``finish``.
    """
    blocks, made, last = [], 0, run.first_index
    end = run.end_index + 200
    while last < end:
        samples = instrument.poll(0.05)
        blocks.append(samples)
        last = int(samples["index"][-1]) + 1 if samples.size else last
        played = last - run.first_index
        if until is not None and played >= until:
            until, end = None, run.first_index + instrument.finish() + 200
            volts = volts[:0]
        while made * BLOCK < volts.size and (made - lead) * BLOCK <= played - PRELOAD:
            if made not in skip:
                instrument.send(PRELOAD + made * BLOCK, volts[made * BLOCK : (made + 1) * BLOCK])
            made += 1
    samples = np.concatenate(blocks)
    return samples[samples["index"] >= run.first_index]


def flagged(samples, flag):
    return (samples["flags"] & flag) > 0


@both
def test_set_points_are_played_sample_by_sample(opened):
    instrument = opened()
    run = begin(instrument)
    assert run.samples == PRELOAD + COUNT
    samples = play(instrument, run, wave())
    np.testing.assert_allclose(samples["command"][:PRELOAD], softly(np.full(PRELOAD, 10.0)), atol=STEP_V)
    softened = flagged(samples, Flag.SOFT_START)
    assert softened[:98].all()  # what is lowered by less than a step of the converter is not lowered
    assert not softened[99:].any()
    np.testing.assert_allclose(samples["command"][PRELOAD : run.samples], wave(), atol=STEP_V)
    assert np.array_equal(flagged(samples, Flag.PLAYING), np.arange(samples.size) < run.samples)
    assert not flagged(samples, Flag.HELD).any()
    assert instrument.late_blocks == instrument.held_samples == 0


@both
def test_the_end_is_a_soft_release(opened):
    instrument = opened()
    run = begin(instrument)
    samples = play(instrument, run, wave())[run.samples :]
    released = samples[: int(flagged(samples, Flag.ENERGISED).sum())]
    assert released.size == 100
    np.testing.assert_allclose(released["command"], wave()[-1] * np.arange(99, -1, -1) / 100, atol=STEP_V)
    assert np.all(samples["command"][100:] == 0.0)


@both
def test_missing_blocks_are_held_softly(opened):
    instrument = opened()
    run = begin(instrument, hold_v=4.0)
    samples = play(instrument, run, np.full(COUNT, 16.0), skip=(4, 5, 6, 12))
    command = samples["command"]
    gone = PRELOAD + 200
    np.testing.assert_allclose(command[gone : gone + 100], 16.0 - 12.0 * np.arange(1, 101) / 100, atol=STEP_V)
    np.testing.assert_allclose(command[gone + 100 : gone + 150], 4.0, atol=STEP_V)
    np.testing.assert_allclose(command[gone + 150 : gone + 160], 4.0 + 12.0 * np.arange(1, 11) / 11, atol=STEP_V)
    half = PRELOAD + 600
    np.testing.assert_allclose(command[half : half + 50], 16.0 - 12.0 * np.arange(1, 51) / 100, atol=STEP_V)
    np.testing.assert_allclose(command[half + 50 : half + 60], 10.0 + 6.0 * np.arange(1, 11) / 11, atol=STEP_V)
    held = np.flatnonzero(flagged(samples, Flag.HELD)) - PRELOAD
    assert np.array_equal(held, [*range(200, 360), *range(600, 660)])
    assert np.all(flagged(samples, Flag.PLAYING)[held + PRELOAD])
    assert instrument.held_samples == 220
    assert instrument.late_blocks == 0


@both
def test_late_blocks_are_counted_and_their_rest_is_played(opened):
    instrument = opened()
    run = begin(instrument)
    while instrument.poll(0.0)["index"][-1] + 1 < run.first_index + PRELOAD + 60:
        pass
    instrument.send(PRELOAD, np.full(50, 18.0))
    instrument.send(PRELOAD + 50, np.full(50, 18.0))
    instrument.send(PRELOAD + 100, np.full(COUNT - 100, 18.0))
    samples = play(instrument, run, np.zeros(0))
    assert instrument.late_blocks == 2
    assert 70 <= instrument.held_samples <= 100
    own = samples[samples["index"] < run.end_index]
    again = int(np.argmin(flagged(own, Flag.HELD)))
    assert int(own["index"][again]) - run.first_index == PRELOAD + instrument.held_samples
    np.testing.assert_allclose(own["command"][again:], 18.0, atol=STEP_V)


@both
def test_a_computer_that_is_too_slow_releases_the_coil(opened):
    instrument = opened()
    run = begin(instrument, count=4000)
    with pytest.raises(FirmwareFaultError, check=holding("fault.starved")):
        play(instrument, run, wave(100))
    instrument.release()
    samples = np.concatenate([instrument.poll(0.05) for _ in range(5)]) if opened is in_process else None
    assert samples is None or not flagged(samples, Flag.ENERGISED).any()
    assert opened is in_process or instrument.link.firmware.faults == Fault.STARVED
    assert instrument.held_samples in range(980, 1001)


@both
@pytest.mark.parametrize("until", [100, PRELOAD + 300])
def test_finish_ends_the_run_softly_and_says_how_much_was_played(opened, until):
    instrument = opened()
    run = begin(instrument)
    samples = play(instrument, run, wave(), until=until)
    played = int(flagged(samples, Flag.PLAYING).sum())
    assert until <= played <= until + 120
    assert flagged(samples, Flag.PLAYING)[:played].all()
    np.testing.assert_allclose(
        samples["command"][played : played + 100],
        samples["command"][played - 1] * np.arange(99, -1, -1) / 100,
        atol=STEP_V,
    )
    assert not flagged(samples, Flag.ENERGISED)[played + 100 :].any()
    assert instrument.late_blocks == instrument.held_samples == 0
    assert instrument.finish() == played, "a run that is over is not shortened again"
    run = begin(instrument)
    assert run.samples == PRELOAD + COUNT


@both
def test_finish_ends_a_stimulus_that_was_loaded_whole(opened):
    instrument = opened()
    instrument.load(wave(4000))
    instrument.arm(CLINICAL)
    run = instrument.start()
    samples = play(instrument, run, np.zeros(0), until=2000)
    played = int(flagged(samples, Flag.PLAYING).sum())
    assert 2000 <= played < 2100
    np.testing.assert_allclose(samples["command"][:played], softly(wave(4000))[:played], atol=STEP_V)


@both
def test_finish_before_the_start_takes_the_arming_back(opened):
    instrument = opened()
    instrument.load(np.full(PRELOAD, 10.0))
    instrument.arm(CLINICAL)
    assert instrument.finish() == 0
    with pytest.raises(InstrumentError):
        instrument.start()


@both
def test_set_points_are_announced_for_one_run_only(opened):
    instrument = opened()
    run = begin(instrument)
    play(instrument, run, wave())
    with pytest.raises(InstrumentError, check=unexpected(first=PRELOAD, end=PRELOAD + 50)):
        instrument.send(PRELOAD, wave(50))
    instrument.arm(CLINICAL)
    assert instrument.start().samples == PRELOAD
    instrument.release()
    instrument.follow(COUNT, 10.0)
    instrument.load(np.full(PRELOAD, 10.0))
    instrument.arm(CLINICAL)
    assert instrument.start().samples == PRELOAD


@both
def test_following_needs_something_to_follow(opened):
    with pytest.raises(InstrumentError, check=coded("instrument.nothing_loaded")):
        opened().follow(100, 0.0)


@both
@pytest.mark.parametrize(
    ("count", "hold_v", "limits", "check"),
    [
        (COUNT, 10.0, Limits(max_seconds=0.5), coded("limit.stimulus_time", seconds=0.6, limit=0.5)),
        (COUNT, 40.0, Limits(max_force_n=8.0), coded("limit.stimulus_force", force=10.0, limit=8.0)),
        (COUNT, np.nan, CLINICAL, None),
    ],
)
def test_arming_checks_the_announced_set_points(opened, count, hold_v, limits, check):
    instrument = opened()
    instrument.load(np.full(PRELOAD, 10.0))
    if check is None:
        check = coded("limit.command" if isinstance(instrument, SimulatedInstrument) else "limit.converter")
    with pytest.raises(LimitError, check=check):
        instrument.follow(count, hold_v)
        instrument.arm(limits)


@both
@pytest.mark.parametrize(
    ("offset", "volts", "error", "check"),
    [
        (PRELOAD, np.full(50, 47.0), LimitError, coded("limit.stimulus_force", force=11.75, limit=8.0)),
        (PRELOAD, np.full(50, np.nan), LimitError, coded("limit.command")),
        (PRELOAD, np.full(50, 50.0), LimitError, coded("limit.voltage", voltage=50.0)),
        (PRELOAD - 1, np.full(50, 5.0), InstrumentError, unexpected(first=199, end=249)),
        (PRELOAD + COUNT - 49, np.full(50, 5.0), InstrumentError, unexpected()),
        (PRELOAD, np.zeros(0), InstrumentError, unexpected()),
    ],
)
def test_the_host_checks_set_points_before_it_sends_them(opened, offset, volts, error, check):
    instrument = opened()
    begin(instrument, limits=Limits(max_force_n=8.0))
    with pytest.raises(error, check=check):
        instrument.send(offset, volts)
    assert instrument.poll(0.05).size, "nothing was sent, and the run goes on"


@both
def test_set_points_need_arming(opened):
    instrument = opened()
    instrument.load(np.full(PRELOAD, 10.0))
    instrument.follow(COUNT, 10.0)
    with pytest.raises(InstrumentError, check=unexpected()):
        instrument.send(PRELOAD, wave(50))
    instrument.arm(CLINICAL)
    instrument.send(PRELOAD, wave(50))


def test_what_is_armed_waits_for_its_start_in_process():
    instrument = SimulatedInstrument()
    run = begin(instrument)
    instrument.poll(0.0)
    instrument.finish()
    begin(instrument, count=0)
    instrument.release()
    instrument.arm(CLINICAL)
    assert not flagged(instrument.poll(0.0), Flag.ENERGISED).any()
    assert instrument.start().first_index == run.first_index + 40


def test_the_same_answers_play_the_same_in_process():
    first, second = (play(i, begin(i), wave(), skip=(3,)) for i in (SimulatedInstrument(), SimulatedInstrument()))
    assert np.array_equal(first, second)


# -- the link, and the firmware at its other end ----------------------------------------------------------------------


def test_the_firmware_refuses_what_the_host_let_through(monkeypatch):
    monkeypatch.setattr(run_machine, "check_command", lambda *_: None)
    instrument = connect("linear-demo")
    begin(instrument, limits=Limits(max_force_n=8.0))
    instrument.send(PRELOAD, np.full(50, 47.0))
    with pytest.raises(LimitError, check=coded("refused.beyond_limits", request="SETPOINTS")):
        for _ in range(3):
            instrument.poll(0.05)
    firmware = instrument.link.firmware
    assert not firmware.energised
    assert firmware.faults == Fault.NONE


def test_lost_blocks_are_sent_again_in_time():
    instrument = connect("linear-demo")
    run = begin(instrument)
    rng = random.Random(5)
    instrument.link.to_device = lambda data: b"" if rng.random() < 0.3 else data
    instrument.link.to_host = lambda data: b"" if rng.random() < 0.1 else data
    samples = play(instrument, run, wave(), lead=6)
    received = np.isfinite(samples["command"][: run.samples])
    expected = softly(np.concatenate((np.full(PRELOAD, 10.0), wave())), loaded=PRELOAD)
    np.testing.assert_allclose(samples["command"][: run.samples][received], expected[received], atol=STEP_V)
    assert instrument.late_blocks == instrument.held_samples == 0
    assert instrument.state.repeated_blocks > 3


def test_repeated_frames_do_no_harm():
    instrument = connect("linear-demo")
    instrument.link.to_device = lambda data: data * 3
    instrument.link.to_host = lambda data: data * 2
    run = begin(instrument)
    samples = play(instrument, run, wave())
    np.testing.assert_allclose(samples["command"][PRELOAD : run.samples], wave(), atol=STEP_V)
    assert instrument.late_blocks == instrument.held_samples == 0


def test_samples_that_were_held_are_counted_even_where_they_were_lost():
    instrument = connect("linear-demo")
    run = begin(instrument, hold_v=4.0)
    frames = iter(range(100_000))
    instrument.link.to_host = lambda data: b"" if 15 < next(frames) < 25 else data
    samples = play(instrument, run, wave(), lead=10, skip=(4, 5))
    assert flagged(samples, Flag.HELD).sum() < 110
    assert instrument.held_samples == 110


def test_the_margin_of_set_points_is_reported():
    instrument = connect("linear-demo")
    assert instrument.setpoint_margin_s is None
    run = begin(instrument)
    play(instrument, run, wave(), lead=3)
    assert instrument.setpoint_margin_s == pytest.approx(0.065, abs=0.011)


def without(kinds):
    """A firmware that knows nothing of these messages, and whose STATUS is as long as it was before there were any."""

    def old_status(data):
        frames = wire.FrameDecoder().feed(data)
        size = wire.STATUS.itemsize
        short = (
            wire.Frame(f.type, f.sequence, f.device_time_us, f.sample_index, f.payload[:size])
            if f.type == MessageType.STATUS
            else f
            for f in frames
        )
        return b"".join(wire.encode_frame(f) for f in short)

    instrument = connect("linear-demo")
    obey = instrument.link.firmware.obey
    instrument.link.firmware.obey = lambda frame, now: (Result.UNKNOWN, 0) if frame.type in kinds else obey(frame, now)
    instrument.link.to_host = old_status
    return instrument


def test_an_older_firmware_without_set_points_is_recognised():
    instrument = without({MessageType.FOLLOW, MessageType.SETPOINTS, MessageType.FINISH})
    instrument.load(np.full(PRELOAD, 10.0))
    with pytest.raises(InstrumentError, check=coded("firmware.no_feedback")):
        instrument.follow(COUNT, 10.0)
    instrument.arm(CLINICAL)
    run = instrument.start()
    assert run.samples == PRELOAD
    with pytest.raises(InstrumentError, check=coded("firmware.no_finish")):
        instrument.finish()
    samples = play(instrument, run, np.zeros(0))
    assert flagged(samples, Flag.PLAYING).sum() == PRELOAD
    assert instrument.status.state is State.LOADED
    assert instrument.status.late_blocks == instrument.late_blocks == 0


def test_more_set_points_than_the_device_plays_are_refused():
    instrument = connect("linear-demo")
    instrument.load(np.full(PRELOAD, 10.0))
    with pytest.raises(InstrumentError, check=coded("refused.too_large", request="FOLLOW")):
        instrument.follow(500_000, 10.0)


def test_an_unplugged_cable_in_the_middle_frees_the_coil():
    instrument = connect("linear-demo")
    begin(instrument)
    instrument.send(PRELOAD, wave(200))
    instrument.poll(0.3)
    link = instrument.link
    link.plugged = False
    with pytest.raises(InstrumentError, check=holding("link.broken", port="loopback")):
        for _ in range(20):
            instrument.poll(0.05)
    instrument.send(PRELOAD, wave(50))  # what is wrong comes with poll, and came
    link.run_for(1.0)
    assert not link.firmware.energised


def test_a_release_in_the_middle_leaves_nothing_behind():
    instrument = connect("linear-demo")
    begin(instrument)
    instrument.send(PRELOAD, wave(200))
    instrument.poll(0.1)
    instrument.release()
    assert not instrument.link.firmware.energised
    for _ in range(20):
        instrument.poll(0.05)
    run = begin(instrument)
    assert not flagged(play(instrument, run, wave()), Flag.HELD).any()


def test_a_replay_takes_no_set_points_but_can_be_ended():
    replay = ReplayInstrument(DeviceDescription(), {"position": np.zeros(200)})
    replay.load(np.zeros(200))
    with pytest.raises(InstrumentError, check=coded("replay.feedback")):
        replay.follow(100, 0.0)
    with pytest.raises(InstrumentError, check=coded("replay.set_points")):
        replay.send(200, np.zeros(50))
    replay.arm(CLINICAL)
    replay.start()
    replay.poll(0.0)
    replay.poll(0.0)
    assert replay.finish() == 40
    assert replay.poll(0.0).size == 0
    assert replay.late_blocks == replay.held_samples == 0
