"""Set-points in the firmware, frame by frame: what is played is what was sent, or held, and never beyond the limits."""

import itertools
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import softly

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from firmware_sim.setpoints import BUFFER_SAMPLES
from tissueid import wire
from tissueid.wire import Fault, Flag, MessageType, Result, State

RATE = 2000
VOLTS_PER_CODE = 60 / 32768
NEWTONS_PER_VOLT = 3.0 / 12.0
TOKEN = 77


def codes(volts):
    return np.rint(np.asarray(volts, float) / VOLTS_PER_CODE).astype("<i2")


class Desk:
    """A host that sends given frames and keeps all that it receives."""

    def __init__(self):
        self.firmware = Firmware(Bench("linear-demo"))
        self.now = 0.0
        self.acks = {}
        self.status = None
        self.samples = [np.zeros(0, wire.SAMPLE)]
        self._decoder = wire.FrameDecoder()
        self._sequence = itertools.count()
        hello = wire.pack(wire.HELLO, protocol_min=1, protocol_max=1, host=b"test")
        self.say(MessageType.HELLO, hello)
        self.ask(MessageType.STREAM, wire.pack(wire.STREAM, on=1))

    def say(self, kind, payload=b"", sequence=None):
        sequence = next(self._sequence) if sequence is None else sequence
        self.firmware.receive(wire.encode_frame(wire.Frame(kind, sequence, payload=payload)), self.now)
        self._listen()
        return sequence

    def ask(self, kind, payload=b""):
        """The result and the detail of the answer."""
        return self.acks[self.say(kind, payload)]

    def _listen(self):
        for frame in self._decoder.feed(self.firmware.transmit(self.now)):
            if frame.type == MessageType.ACK:
                ack, _ = wire.unpack(wire.ACK, frame.payload)
                self.acks[ack["request_sequence"]] = (ack["result"], ack["detail"])
            elif frame.type == MessageType.STATUS:
                first, rest = wire.unpack(wire.STATUS, frame.payload, tail=True)
                self.status = first | wire.unpack(wire.STATUS_SETPOINTS, rest)[0]
            elif frame.type == MessageType.DATA:
                self.samples.append(np.frombuffer(frame.payload, wire.SAMPLE))

    def live(self, samples):
        """The device's clock goes on, and the host's heart beats."""
        while samples > 0:
            step = min(samples, 20)
            self.now += step / RATE
            self.say(MessageType.HEARTBEAT)
            self.firmware.advance(step, self.now)
            samples -= step
        self._listen()

    def load(self, volts):
        data = codes(volts).tobytes()
        begin = wire.pack(wire.STIMULUS_BEGIN, stimulus_id=1, samples=len(data) // 2, crc32=zlib.crc32(data))
        assert self.ask(MessageType.STIMULUS_BEGIN, begin)[0] == Result.OK
        self.ask(MessageType.STIMULUS_CHUNK, wire.pack(wire.STIMULUS_CHUNK, stimulus_id=1, offset=0) + data)
        assert self.ask(MessageType.STIMULUS_COMMIT, wire.pack(wire.STIMULUS_COMMIT, stimulus_id=1))[0] == Result.OK

    def follow(self, samples, hold_v=0.0, stimulus_id=1):
        hold = int(codes([hold_v])[0])
        return self.ask(
            MessageType.FOLLOW, wire.pack(wire.FOLLOW, stimulus_id=stimulus_id, samples=samples, hold_code=hold)
        )

    def arm(self, max_force_n=8.0, max_samples=20000):
        limits = {"max_force_n": max_force_n, "min_position_m": 0.0, "max_position_m": 0.032, "max_temperature_c": 80}
        arm = wire.pack(wire.ARM, token=TOKEN, stimulus_id=1, max_samples=max_samples, **limits)
        return self.ask(MessageType.ARM, arm)[0]

    def start(self):
        result, first = self.ask(MessageType.START, wire.pack(wire.START, token=TOKEN))
        assert result == Result.OK
        return first

    def send(self, offset, volts, token=TOKEN, sequence=None):
        payload = wire.pack(wire.SETPOINTS, token=token, offset=offset) + codes(volts).tobytes()
        return self.acks[self.say(MessageType.SETPOINTS, payload, sequence)]

    def running(self, preload=40, samples=600, hold_v=0.0, max_force_n=8.0):
        """A run under way, its set-points still to be sent."""
        self.load(np.full(preload, 10.0))
        assert self.follow(samples, hold_v) == (Result.OK, preload + samples)
        assert self.arm(max_force_n) == Result.OK
        return self.start()

    def run(self):
        """The samples of the newest run, release included."""
        samples = np.concatenate(self.samples)
        return samples[(samples["flags"] & Flag.ENERGISED) > 0]


def played(samples):
    return samples[(samples["flags"] & Flag.PLAYING) > 0]


def held(samples):
    return (samples["flags"] & Flag.HELD) > 0


def test_set_points_are_played_as_they_were_sent_and_then_released():
    desk = Desk()
    desk.running()
    volts = 10.0 + np.linspace(0.0, 8.0, 600)
    for k in range(0, 600, 50):
        assert desk.send(40 + k, volts[k : k + 50]) == (Result.OK, 40 + k + 50)
        desk.live(50)
    desk.live(300)
    samples = desk.run()
    whole = np.append(np.full(40, 10.0), volts)
    np.testing.assert_allclose(samples["command"][:640], codes(softly(whole, loaded=40)), atol=1)
    assert np.array_equal(samples["command"][100:640], codes(whole[100:]))
    assert played(samples).size == 640
    assert not held(samples).any()
    assert samples.size == 640 + 100
    np.testing.assert_allclose(samples["command"][640:], samples["command"][639] * np.arange(99, -1, -1) / 100, atol=1)
    assert desk.status["state"] == State.LOADED
    assert desk.status["played_samples"] == 640
    assert desk.status["late_blocks"] == desk.status["held_samples"] == 0


def test_a_block_that_never_came_is_held_softly_and_left_softly():
    desk = Desk()
    desk.running(hold_v=4.0)
    for k in (0, 50, 300, 350, 400, 450, 500, 550):
        desk.send(40 + k, np.full(50, 20.0))
    desk.live(800)
    samples = desk.run()
    volts = samples["command"] * VOLTS_PER_CODE
    gone = slice(140, 340)
    assert np.array_equal(np.flatnonzero(held(samples)), np.arange(140, 350))
    # 50 ms down in a straight line, there until a set-point comes, 5 ms up again.
    expected = 20.0 - 16.0 * np.minimum(np.arange(1, 201), 100) / 100
    np.testing.assert_allclose(volts[gone], expected, atol=VOLTS_PER_CODE)
    np.testing.assert_allclose(volts[340:350], 4.0 + 16.0 * np.arange(1, 11) / 11, atol=VOLTS_PER_CODE)
    np.testing.assert_allclose(volts[350:640], 20.0, atol=VOLTS_PER_CODE)
    assert desk.status["held_samples"] == 210
    assert desk.status["late_blocks"] == 0


def test_half_a_second_without_a_block_releases_with_a_fault():
    desk = Desk()
    desk.running(samples=4000, hold_v=6.0)
    desk.send(40, np.full(50, 12.0))
    desk.live(90 + 900)
    desk.send(3000, np.full(50, 12.0))  # a sign of life
    desk.live(990)
    assert desk.firmware.energised
    desk.live(20)
    assert desk.firmware.faults == Fault.STARVED
    assert not desk.firmware.energised
    samples = desk.run()
    assert samples.size == 90 + 900 + 1000
    assert held(samples)[90:].all()
    assert desk.send(3100, np.full(50, 12.0)) == (Result.FAULT_LATCHED, Fault.STARVED)
    desk.ask(MessageType.CLEAR_FAULTS)
    assert desk.firmware.state is State.IDLE


def test_without_any_set_point_the_load_goes_to_the_hold_level():
    desk = Desk()
    desk.running(preload=140, samples=200, hold_v=5.0)
    desk.live(500)
    volts = desk.run()["command"] * VOLTS_PER_CODE
    np.testing.assert_allclose(volts[140:240], 10.0 - 5.0 * np.arange(1, 101) / 100, atol=VOLTS_PER_CODE)
    np.testing.assert_allclose(volts[240:340], 5.0, atol=VOLTS_PER_CODE)
    assert desk.firmware.state is State.LOADED


def test_what_comes_too_late_is_counted_and_what_is_left_of_it_is_played():
    desk = Desk()
    desk.running(hold_v=10.0)
    desk.live(40 + 70)
    assert desk.send(40, np.full(50, 20.0)) == (Result.LATE, 110)
    assert desk.send(90, np.full(50, 20.0)) == (Result.LATE, 140)
    desk.send(140, np.full(500, 20.0))
    desk.live(700)
    samples = desk.run()
    assert np.array_equal(np.flatnonzero(held(samples)), np.arange(40, 120))
    assert np.all(samples["command"][120:640] == codes([20.0]))
    assert desk.status["late_blocks"] == 2
    assert desk.status["held_samples"] == 80


def test_a_block_beyond_the_force_limit_is_refused_whole():
    desk = Desk()
    desk.running()
    block = np.full(50, 5.0)
    block[49] = -40.0
    assert desk.send(40, block) == (Result.BEYOND_LIMITS, 40)
    desk.live(100)
    assert held(desk.run())[40:].all()


@pytest.mark.parametrize(
    ("offset", "count", "result"),
    [
        (39, 50, Result.BAD_ARGUMENT),  # part of the stimulus
        (20_001, 40, Result.BAD_ARGUMENT),  # beyond what was asked for
        (2**32 - 1, 10, Result.BAD_ARGUMENT),
        (40, 0, Result.BAD_ARGUMENT),
        (40 + BUFFER_SAMPLES - 49, 50, Result.TOO_LARGE),
        (40 + BUFFER_SAMPLES - 50, 50, Result.OK),
    ],
)
def test_set_points_that_were_not_announced_are_refused(offset, count, result):
    desk = Desk()
    desk.load(np.full(40, 10.0))
    desk.follow(20_000 - 40)
    desk.arm()
    assert desk.send(offset, np.full(count, 5.0)) == (result, 40)
    assert desk.ask(MessageType.SETPOINTS, wire.pack(wire.SETPOINTS, token=TOKEN, offset=40) + b"odd")[0] == (
        Result.BAD_ARGUMENT
    )


def test_the_buffer_goes_round():
    desk = Desk()
    count = 2 * BUFFER_SAMPLES
    desk.running(samples=count)
    volts = 10.0 + np.arange(count) % 997 / 100
    sent = 0
    while desk.firmware.state is State.RUNNING:
        while sent < count and (answer := desk.send(40 + sent, volts[sent : sent + 500]))[0] == Result.OK:
            sent += min(500, count - sent)
            assert answer[1] == 40 + sent
        desk.live(1000)
    samples = played(desk.run())
    assert not held(samples).any()
    assert np.array_equal(samples["command"][100:], codes(volts[60:]))
    np.testing.assert_allclose(
        samples["command"][:100], codes(softly(np.append(np.full(40, 10.0), volts), loaded=40)[:100]), atol=1
    )


def test_set_points_are_agreed_for_one_run():
    desk = Desk()
    assert desk.follow(100)[0] == Result.BAD_STATE
    desk.load(np.full(40, 10.0))
    assert desk.follow(100, stimulus_id=2)[0] == Result.BAD_STATE
    assert desk.follow(200_000)[0] == Result.TOO_LARGE
    desk.follow(300)
    assert desk.follow(100) == (Result.OK, 140), "the newest word counts"
    desk.follow(10, hold_v=47.0)
    assert desk.follow(0, hold_v=47.0) == (Result.OK, 40)
    assert desk.arm() == Result.OK, "no set-points, no level to hold"
    desk.ask(MessageType.FINISH)
    desk.follow(100)

    def plays():
        assert desk.arm() == Result.OK
        desk.start()
        before = np.concatenate(desk.samples).size
        desk.live(600)
        samples = np.concatenate(desk.samples)[before:]
        return np.count_nonzero(samples["flags"] & Flag.PLAYING)

    assert plays() == 140
    assert plays() == 40, "a run that is over takes its set-points with it"
    desk.follow(100)
    desk.load(np.full(40, 10.0))
    assert plays() == 40
    desk.follow(100)
    desk.ask(MessageType.STOP)
    assert plays() == 40


@pytest.mark.parametrize(("samples", "hold_v"), [(100, 40.0), (100, -34.0), (19_961, 0.0)])
def test_arm_judges_what_is_to_follow(samples, hold_v):
    desk = Desk()
    desk.load(np.full(40, 10.0))
    desk.follow(samples, hold_v)
    assert desk.arm() == Result.BEYOND_LIMITS
    desk.follow(100, 30.0)
    assert desk.arm() == Result.OK


def test_set_points_need_a_run_and_its_token():
    desk = Desk()
    assert desk.send(40, np.zeros(50))[0] == Result.BAD_STATE
    desk.running()
    assert desk.send(40, np.zeros(50), token=TOKEN + 1)[0] == Result.BAD_STATE
    desk.ask(MessageType.STOP)
    assert desk.send(40, np.zeros(50)) == (Result.LATE, 0), "still on the way when the run was ended: no harm"
    desk.firmware.reboot()
    desk.say(MessageType.HELLO, wire.pack(wire.HELLO, protocol_min=1, protocol_max=1, host=b""))
    assert desk.send(40, np.zeros(50))[0] == Result.BAD_STATE


def test_finish_releases_softly_wherever_the_run_is():
    for after in (0, 25, 40 + 30, 40 + 130, 640, 660):
        desk = Desk()
        desk.running(hold_v=4.0)
        for k in (0, 50):
            desk.send(40 + k, np.full(50, 18.0))
        if after > 300:
            desk.send(140, np.full(500, 18.0))
        desk.live(after)
        expected = min(after, 640)
        assert desk.ask(MessageType.FINISH) == (Result.OK, expected)
        assert desk.send(400, np.full(50, 18.0))[0] == Result.LATE
        assert desk.firmware.energised
        desk.live(200)
        assert not desk.firmware.energised
        assert desk.status["state"] == State.LOADED
        assert desk.status["played_samples"] == expected
        assert desk.status["late_blocks"] == 0
        samples = desk.run()
        assert played(samples).size == expected
        assert samples.size == expected + 100
        volts = np.append(0.0, samples["command"] * VOLTS_PER_CODE)
        ramp = volts[expected] * np.arange(99, -1, -1) / 100
        np.testing.assert_allclose(volts[expected + 1 :], ramp, atol=VOLTS_PER_CODE)


def test_finish_does_no_harm_outside_a_run():
    desk = Desk()
    assert desk.ask(MessageType.FINISH) == (Result.OK, 0)
    desk.load(np.full(40, 10.0))
    assert desk.ask(MessageType.FINISH) == (Result.OK, 0)
    assert desk.firmware.state is State.LOADED
    desk.arm()
    assert desk.ask(MessageType.FINISH) == (Result.OK, 0)
    assert desk.firmware.state is State.LOADED, "an armed device has nothing to end but its being armed"
    desk.arm()
    desk.start()
    desk.live(300)
    assert desk.ask(MessageType.FINISH) == (Result.OK, 40)


def test_an_open_loop_stimulus_can_be_ended_too():
    desk = Desk()
    desk.load(np.linspace(0.0, 20.0, 480))
    desk.arm()
    desk.start()
    desk.live(200)
    assert desk.ask(MessageType.FINISH) == (Result.OK, 200)
    desk.live(200)
    samples = desk.run()
    assert samples.size == 300
    assert np.array_equal(samples["command"][:200], codes(np.linspace(0.0, 20.0, 480))[:200])
    assert np.all(np.diff(samples["command"][199:].astype(int)) < 0)


BLOCK, BLOCKS, PRELOAD, MOST_N = 50, 10, 40, 4.0


@given(
    deliveries=st.lists(
        st.tuples(st.integers(0, 30), st.integers(0, BLOCKS - 1), st.integers(-20, 20), st.booleans()), max_size=30
    ),
    forces=st.lists(st.sampled_from([0.0, 5.0, -6.0, 11.0, 18.0, -30.0]), min_size=BLOCKS, max_size=BLOCKS),
    hold_v=st.sampled_from([0.0, -6.0, 10.0]),
)
@settings(max_examples=60)
def test_whatever_the_cable_does_only_what_was_sent_is_played_or_held(deliveries, forces, hold_v):
    """Blocks come in any order, shifted, more than once, too late or not at all, and some push too hard."""
    desk = Desk()
    desk.running(PRELOAD, BLOCK * BLOCKS, hold_v, max_force_n=MOST_N)
    sent: list[set[int]] = [set() for _ in range(PRELOAD + BLOCK * BLOCKS)]
    late = 0
    for tick in range(31):
        for _, block, shift, again in (item for item in deliveries if item[0] == tick):
            offset = PRELOAD + block * BLOCK + shift
            volts = forces[block] + 0.01 * np.arange(BLOCK)
            now = desk.firmware.sample_index - desk.firmware.start_index
            result, _ = desk.send(offset, volts, sequence=30_000 + block if again else None)
            late += result == Result.LATE and not again and now < PRELOAD + BLOCK * BLOCKS
            if result in (Result.OK, Result.LATE):
                for k, code in enumerate(codes(volts)):
                    if 0 <= offset + k < len(sent):
                        sent[offset + k].add(int(code))
        desk.live(20)
    desk.live(300)
    samples = desk.run()
    volts = samples["command"] * VOLTS_PER_CODE
    assert np.abs(volts).max() * NEWTONS_PER_VOLT <= MOST_N * 1.05
    own = played(samples)
    assert own.size == len(sent)
    softened = (own["flags"] & Flag.SOFT_START) > 0
    assert not softened[99:].any()
    for k in range(PRELOAD, own.size):
        share = np.sin(np.pi / 2 * (k + 1) / 100)
        soft = (
            {round(np.sign(code) * share * max(abs(code), codes([10.0])[0])) for code in sent[k]} if k < 99 else set()
        )
        allowed = {code + step for code in soft for step in (-1, 0, 1)} if softened[k] else sent[k]
        assert held(own)[k] or int(own["command"][k]) in allowed
    assert all(held(own)[k] for k in range(PRELOAD, own.size) if not sent[k])
    assert desk.status["held_samples"] == held(own).sum()
    assert desk.status["late_blocks"] >= late
    # No jump but those that are between values that were sent: a hold goes down in 50 ms and is left in 5 ms.
    span = 2 * MOST_N * 1.05 / NEWTONS_PER_VOLT
    steps = np.abs(np.diff(volts[PRELOAD - 1 : own.size]))
    inside = held(own)[PRELOAD:]
    assert steps[inside].max(initial=0.0) <= span / 11 + 0.05
    assert not desk.firmware.energised
