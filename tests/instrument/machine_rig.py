"""A device that only answers, for the state machine of a run: frames made by hand, and a state in every mode."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from tissueid import wire
from tissueid.errors import LinkLostError
from tissueid.instrument import Limits
from tissueid.instrument import run_machine as machine
from tissueid.instrument.handshake import Handshake, parse_hello
from tissueid.instrument.run_machine import Mode, RunState, step
from tissueid.wire import Flag, Frame, MessageType, Result, State

LIMITS = Limits(max_force_n=8.0, max_seconds=20.0)
COMMAND = np.full(400, 6.0)
PLAYED = int(Flag.PLAYING | Flag.ENERGISED)
RESTING = {"position": 0.01, "temperature": 23.0}
BLOCK = 20


def _hello() -> bytes:
    firmware = Firmware(Bench("linear-demo", seed=1), seed=1)
    hello = wire.pack(wire.HELLO, protocol_min=1, protocol_max=1, host=b"test")
    firmware.receive(wire.encode_frame(Frame(MessageType.HELLO, payload=hello)), 0.0)
    frames = wire.FrameDecoder().feed(firmware.transmit(0.0))
    return next(frame.payload for frame in frames if frame.type == MessageType.HELLO_ACK)


HELLO_ACK = _hello()
HANDSHAKE: Handshake = parse_hello(HELLO_ACK, "port")


def data(first: int, flags: int = 0, count: int = BLOCK, **values: float) -> Frame:
    """DATA with the same reading in every sample but for its last digits, in SI units."""
    samples = np.zeros(count, wire.SAMPLE)
    for channel, name in enumerate(wire.SAMPLE.names[:7]):
        value = (RESTING | values).get(name, 0.0)
        code = (value - HANDSHAKE.offsets[channel]) / HANDSHAKE.gains[channel]
        samples[name] = np.rint(code) + (first + np.arange(count)) % 3
    samples["flags"] = flags
    return Frame(MessageType.DATA, sample_index=first, payload=samples.tobytes())


def status(index: int = 0, state: State = State.IDLE, faults: int = 0, boot_id: int | None = None, played: int = 0):
    """STATUS at a sample."""
    fields = dict.fromkeys(wire.STATUS.names, 0) | {
        "state": state,
        "faults": faults,
        "boot_id": HANDSHAKE.boot_id if boot_id is None else boot_id,
        "played_samples": played,
    }
    return Frame(MessageType.STATUS, sample_index=index, payload=wire.pack(wire.STATUS, **fields))


def ack(sent: machine.SendFrame, result: int = Result.OK, detail: int = 0, index: int = 0) -> Frame:
    """The answer to a request."""
    fields = {"request_type": sent.kind, "request_sequence": sent.sequence, "result": result, "detail": detail}
    return Frame(MessageType.ACK, sample_index=index, payload=wire.pack(wire.ACK, **fields))


class Host:
    """A state, a clock and what the machine asked for, by the names of the actions and messages."""

    def __init__(self, mode: Mode = Mode.OPENING) -> None:
        self.state = RunState("port")
        self.at = 0.0
        self.actions: list[machine.RunAction] = []
        if mode is not Mode.OPENING:
            self._open()
            self._reach(mode)
        self.actions.clear()
        assert self.state.mode is mode

    def do(self, event: machine.RunEvent) -> tuple[machine.RunAction, ...]:
        self.state, actions = step(self.state, event)
        self.actions += actions
        return actions

    def receive(self, frame: Frame) -> tuple[machine.RunAction, ...]:
        return self.do(machine.FrameReceived(self.at, frame))

    def tick(self, seconds: float = 0.01) -> tuple[machine.RunAction, ...]:
        self.at += seconds
        return self.do(machine.ClockTick(self.at))

    def play(self, flags: int = 0, count: int = BLOCK, lost: int = 0, **values: float) -> tuple[machine.RunAction, ...]:
        """The next samples arrive, ``lost`` ones missing before them, and a tick."""
        first = (self.state.next_index or 0) + lost
        return (*self.receive(data(first, flags, count, **values)), *self.tick())

    def answer(self, result: int = Result.OK, detail: int = 0) -> tuple[machine.RunAction, ...]:
        """Answer the pending request."""
        assert self.state.request is not None
        return self.receive(ack(self.state.request.sent, result, detail, self.state.next_index or 0))

    def answer_stop(self, result: int = Result.OK) -> tuple[machine.RunAction, ...]:
        assert self.state.stop is not None
        return self.receive(ack(self.state.stop.sent, result))

    def ask(self, event: machine.RunEvent, detail: int = 0) -> None:
        """Ask for something, and answer every request of it."""
        self.do(event)
        while self.state.request is not None:
            self.answer(detail=detail)

    def _open(self) -> None:
        self.do(machine.HelloAsked(self.at))
        self.receive(Frame(MessageType.HELLO_ACK, payload=HELLO_ACK))
        self.do(machine.Greeted(self.at, HANDSHAKE))
        self.ask(machine.RequestAsked(self.at, MessageType.STREAM))
        self.play()

    def arm(self, following: int = 0) -> None:
        self.ask(machine.LoadAsked(self.at, COMMAND))
        if following:
            self.ask(machine.FollowAsked(self.at, following, 4.0))
        self.ask(machine.ArmAsked(self.at, LIMITS))
        self.tick()

    def start(self) -> None:
        self.ask(machine.StartAsked(self.at), detail=self.state.next_index)

    def _reach(self, mode: Mode) -> None:
        if mode is Mode.FREE:
            return
        self.arm(following=200)
        if mode is Mode.STARTING:
            self.do(machine.StartAsked(self.at))
        elif mode is not Mode.ARMED:
            self.start()
            self.play(PLAYED)
        if mode is Mode.STOPPED:
            self.play(0)
        elif mode is Mode.FINISHING:
            self.do(machine.FinishAsked(self.at))
        elif mode is Mode.UNSEEN_END:
            while self.state.next_index < self.state.run.end_index - BLOCK:
                self.play(PLAYED)
            self.play(0, lost=BLOCK)
        elif mode is Mode.RELEASING:
            self.do(machine.StopAsked(self.at))
        elif mode is Mode.FAILED:
            self.play(PLAYED, current=5.0)
            self.answer_stop()
        elif mode is Mode.LOST:
            self.do(machine.StopAsked(self.at))
            self.do(machine.PortFailed(self.at, LinkLostError("broken")))


def names(actions: tuple[machine.RunAction, ...]) -> str:
    """Actions as text: the messages that are sent, and the names of the others, "stop" for a release with STOP."""
    return " ".join(_name(action) for action in actions)


def _name(action: machine.RunAction) -> str:
    match action:
        case machine.SendFrame():
            return action.kind.name
        case machine.ReleaseCoil():
            return "release" if action.stop is None else "stop"
        case machine.EndRun():
            return "end" if action.error is None else "fail"
        case machine.GiveAnswer():
            return "answer" if action.error is None else "refuse"
        case machine.DeliverSamples():
            return "samples"
        case _:
            return type(action).__name__.lower()


OTHER_VERSION = replace(Frame(0x7E), version=9)
