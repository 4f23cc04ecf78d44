"""The state machine of a run: every event in every mode, and what holds after any sequence of events."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from coded import coded, holding
from hypothesis import given, settings
from hypothesis import strategies as st
from instrument.machine_rig import (
    BLOCK,
    COMMAND,
    HANDSHAKE,
    HELLO_ACK,
    LIMITS,
    OTHER_VERSION,
    PLAYED,
    Host,
    ack,
    data,
    names,
    status,
)

from tissueid import wire
from tissueid.errors import LinkLostError
from tissueid.instrument import run_machine as machine
from tissueid.instrument.interface import Correction, empty_samples
from tissueid.instrument.run_machine import TABLE, Mode, row_of, step
from tissueid.wire import Fault, Frame, MessageType, Result, State

ROOT = Path(__file__).resolve().parents[2]


# -- every event in every mode ----------------------------------------------------------------------------------------


def frame(make):
    return lambda host: machine.FrameReceived(host.at, make(host))


def awaited(host):
    """The answer to what is awaited, or one to a request that was never sent."""
    pending = host.state.stop or host.state.request
    sent = pending.sent if pending else machine.SendFrame(MessageType.ARM, 60_000, b"")
    return ack(sent, detail=host.state.next_index or 0)


def taken(host):
    samples = empty_samples(host.state.next_index or 0, BLOCK)
    samples["flags"] = PLAYED if host.state.mode in (Mode.RUNNING, Mode.FINISHING) else 0
    samples["position"], samples["current"], samples["temperature"] = 0.01, 0.0, 23.0
    samples["voltage"] = samples["command"] = 0.0
    return samples


EVENTS = {
    "DATA": frame(lambda host: data(host.state.next_index or 0, int(taken(host)["flags"][0]))),
    "STATUS": frame(lambda host: status(10_000, State.FAULT, Fault.STROKE)),
    "ACK": frame(awaited),
    "HELLO_ACK": frame(lambda host: Frame(MessageType.HELLO_ACK, payload=HELLO_ACK)),
    "a frame of another type": frame(lambda host: Frame(0x7E)),
    "a frame of another version": frame(lambda host: OTHER_VERSION),
    machine.BytesRefused: lambda host: machine.BytesRefused(host.at),
    machine.SamplesTaken: lambda host: machine.SamplesTaken(host.at, taken(host)),
    machine.ClockTick: lambda host: machine.ClockTick(host.at + 0.12),
    machine.PortFailed: lambda host: machine.PortFailed(host.at, LinkLostError("broken")),
    machine.HelloAsked: lambda host: machine.HelloAsked(host.at),
    machine.Greeted: lambda host: machine.Greeted(host.at, HANDSHAKE),
    machine.RequestAsked: lambda host: machine.RequestAsked(host.at, MessageType.STAGE),
    machine.LoadAsked: lambda host: machine.LoadAsked(host.at, COMMAND),
    machine.FollowAsked: lambda host: machine.FollowAsked(host.at, 100, 1.0),
    machine.ArmAsked: lambda host: machine.ArmAsked(host.at, LIMITS),
    machine.StartAsked: lambda host: machine.StartAsked(host.at),
    machine.SetPointsGiven: lambda host: machine.SetPointsGiven(host.at, COMMAND.size, np.full(50, 3.0)),
    machine.FinishAsked: lambda host: machine.FinishAsked(host.at),
    machine.StopAsked: lambda host: machine.StopAsked(host.at),
    machine.StatusAsked: lambda host: machine.StatusAsked(host.at),
    machine.ClearAsked: lambda host: machine.ClearAsked(host.at),
    machine.CalibrationChosen: lambda host: machine.CalibrationChosen(host.at, HANDSHAKE.device, {}),
}

BROKEN = "fail release > FAILED"
SHUT = dict.fromkeys(("OPENING", "STARTING", "FINISHING", "RELEASING", "LOST"), "refuse")
RUNNING = ("STARTING", "RUNNING", "STOPPED", "FINISHING")
EXPECTED: dict[object, dict[str, str]] = {
    "DATA": {
        "usual": "samples",
        "OPENING": "",
        **dict.fromkeys(("STOPPED", "UNSEEN_END"), "samples STATUS_REQUEST"),
    },
    "STATUS": {"usual": "", **dict.fromkeys(("ARMED", *RUNNING, "UNSEEN_END"), BROKEN)},
    "ACK": {"usual": "", **dict.fromkeys(("STARTING", "FINISHING"), "answer > RUNNING"), "RELEASING": "> FREE"},
    "HELLO_ACK": {"usual": "", "OPENING": "greet"},
    "a frame of another type": {"usual": ""},
    "a frame of another version": {
        "usual": BROKEN,
        "RELEASING": "fail release",
        **dict.fromkeys(("OPENING", "FAILED", "LOST"), ""),
    },
    machine.BytesRefused: {"usual": ""},
    machine.SamplesTaken: {"usual": "samples", **dict.fromkeys(("STOPPED", "UNSEEN_END"), "samples STATUS_REQUEST")},
    machine.ClockTick: {"usual": "", "RELEASING": "STOP"},
    machine.PortFailed: {
        "usual": BROKEN,
        "STARTING": "refuse fail stop > RELEASING",
        "FINISHING": "refuse fail release > FAILED",
        "RELEASING": "writeline fail release > LOST",
        **dict.fromkeys(("FAILED", "LOST"), ""),
    },
    machine.HelloAsked: {"usual": "", "OPENING": "HELLO"},
    machine.Greeted: {"usual": ""},
    machine.RequestAsked: {"usual": "STAGE", **SHUT, "OPENING": "STAGE"},
    machine.LoadAsked: {"usual": "STIMULUS_BEGIN", **SHUT},
    machine.FollowAsked: {"usual": "FOLLOW", "FREE": "refuse", **SHUT},
    machine.ArmAsked: {"usual": "refuse", "ARMED": "HEARTBEAT ARM"},
    machine.StartAsked: {"usual": "START", "ARMED": "HEARTBEAT START > STARTING", **SHUT},
    machine.SetPointsGiven: {
        "usual": "SETPOINTS",
        **dict.fromkeys(("OPENING", "FREE", "UNSEEN_END"), "refuse"),
        **dict.fromkeys(("RELEASING", "FAILED", "LOST"), ""),
    },
    machine.FinishAsked: {
        "usual": "FINISH",
        **dict.fromkeys(("RUNNING", "STOPPED"), "FINISH > FINISHING"),
        **SHUT,
    },
    machine.StopAsked: {
        "usual": "stop > RELEASING",
        **dict.fromkeys(("ARMED", "RUNNING", "STOPPED", "FINISHING"), "end stop > RELEASING"),
        "STARTING": "end refuse stop > RELEASING",
        "OPENING": "stop",
        "RELEASING": "",
    },
    machine.StatusAsked: {"usual": "STATUS_REQUEST", **dict.fromkeys(("RELEASING", "LOST"), "")},
    machine.ClearAsked: {"usual": "CLEAR_FAULTS", **SHUT},
    machine.CalibrationChosen: {"usual": "", **dict.fromkeys(("ARMED", *RUNNING), "refuse")},
}
"""Actions of each event by mode, and after ">" the next mode where it is another one."""


def label(row):
    return row if isinstance(row, str) else row.__name__


@pytest.mark.parametrize("mode", Mode, ids=lambda mode: mode.name)
@pytest.mark.parametrize("row", TABLE, ids=label)
def test_an_event_in_a_mode(row, mode):
    host = Host(mode)
    event = EVENTS[row](host)
    assert row_of(event) == row
    expected, _, after = EXPECTED[row].get(mode.name, EXPECTED[row]["usual"]).partition("> ")
    assert (names(host.do(event)), host.state.mode.name) == (expected.strip(), after or mode.name)


def test_every_event_in_every_mode_has_a_reaction_and_a_test():
    assert set(EVENTS) == set(EXPECTED) == set(TABLE)
    assert all(set(row) == set(Mode) for row in TABLE.values())
    every = {
        name for name in vars(machine) if name.endswith(("Asked", "Given", "Chosen", "Taken", "Failed", "Refused"))
    }
    assert every <= {label(row) for row in TABLE} | {"FrameReceived"}


def test_the_page_shows_the_table():
    spec = importlib.util.spec_from_file_location("run_table", ROOT / "docs" / "figures" / "run_table.py")
    run_table = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(run_table)
    page = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
    assert run_table.table() in page
    assert run_table.page_with_table(page) == page, "run docs/figures/run_table.py --write"


# -- what takes more than one event -----------------------------------------------------------------------------------


def error_code(host):
    return host.state.error.code if host.state.error else None


def test_a_heartbeat_follows_checked_samples_only():
    host = Host(Mode.RUNNING)
    host.at += 0.2
    host.receive(data(host.state.next_index, PLAYED))
    assert names(host.tick()) == "HEARTBEAT"
    assert names(host.tick()) == "", "no samples"
    host.receive(data(host.state.next_index, PLAYED))
    assert names(host.tick()) == "", "not yet"
    host.at += 0.2
    assert "fail" in names(host.receive(data(host.state.next_index, PLAYED, current=5.0)))
    assert "HEARTBEAT" not in names(host.tick())


@pytest.mark.parametrize("mode", [Mode.ARMED, Mode.STARTING, Mode.RUNNING, Mode.FINISHING])
def test_a_limit_releases_the_coil(mode):
    host = Host(mode)
    host.at += 0.01
    actions = host.receive(data(host.state.next_index, PLAYED if mode is not Mode.ARMED else 0, current=5.0))
    assert names(actions) == "samples fail stop"
    assert (host.state.mode, error_code(host)) == (Mode.RELEASING, "limit.force")
    host.answer_stop()
    assert host.state.mode is Mode.FAILED


def test_limits_do_not_apply_to_samples_that_arrived_with_the_answer_to_arm():
    host = Host(Mode.FREE)
    host.ask(machine.LoadAsked(host.at, COMMAND))
    host.ask(machine.ArmAsked(host.at, LIMITS))
    assert names(host.receive(data(host.state.next_index, position=0.032))) == "samples"
    host.tick()
    assert "fail" in names(host.play(position=0.032))


@pytest.mark.parametrize("mode", [Mode.FREE, Mode.RUNNING])
def test_silence_ends_a_run(mode):
    host = Host(mode)
    assert names(host.tick(0.9)) == ""
    assert names(host.tick(0.2)) == "fail release"
    assert holding("link.silent", seconds=1.1)(host.state.error)


def test_frames_without_usable_samples_are_silence():
    host = Host(Mode.RUNNING)
    host.at += 1.1
    assert names(host.receive(Frame(MessageType.DATA, sample_index=host.state.next_index, payload=b"x"))) == "writeline"
    assert names(host.receive(data(0))) == "", "a duplicate"
    host.tick(0.0)
    assert holding("link.unusable")(host.state.error)


def test_a_frame_of_another_version_counts_as_unusable_and_is_read_in_the_handshake():
    host = Host(Mode.OPENING)
    hello = Frame(MessageType.HELLO_ACK, payload=HELLO_ACK, version=9)
    assert names(host.receive(hello)) == "greet"
    assert names(host.receive(status())) == ""
    assert host.state.status.state is State.IDLE


def test_a_frame_that_cannot_be_read_changes_nothing():
    host = Host(Mode.RUNNING)
    before = host.state
    assert names(host.receive(Frame(MessageType.STATUS, payload=b"?"))) == "writeline"
    assert vars(host.state) == vars(before)


def test_lost_samples_are_marked():
    host = Host(Mode.RUNNING)
    first = host.state.next_index
    (delivered,) = host.receive(data(first + 40, PLAYED | int(wire.Flag.HELD)))
    assert (delivered.gap.first_index, delivered.gap.count) == (first, 40)
    assert np.array_equal(delivered.samples["index"], first + np.arange(60))
    assert np.isnan(delivered.samples["position"][:40]).all()
    assert np.isfinite(delivered.samples["position"][40:]).all()
    assert host.state.held_samples == BLOCK


def test_a_long_gap_ends_the_link():
    host = Host(Mode.RUNNING)
    assert names(host.receive(data(host.state.next_index + 10_001))) == "fail release"
    assert holding("link.gap", missing=10_001)(host.state.error)


def test_a_run_ends_after_its_last_sample():
    host = Host(Mode.RUNNING)
    end = host.state.run.end_index
    while host.state.next_index < end:
        host.play(PLAYED)
    assert host.state.mode is Mode.RUNNING
    assert names(host.receive(data(host.state.next_index, int(wire.Flag.ENERGISED)))) == "samples end"
    assert (host.state.mode, host.state.error) == (Mode.FREE, None)


@pytest.mark.parametrize(
    ("reported", "code"),
    [
        (status(10_000, State.LOADED, played=COMMAND.size + 200), None),
        (status(10_000, State.LOADED, played=100), "instrument.stopped"),
        (status(10_000, State.FAULT, Fault.STROKE), "instrument.released"),
        (status(10_000, State.ARMED), None),
    ],
    ids=["played", "stopped", "fault", "armed again"],
)
def test_a_run_whose_end_was_lost_is_judged_by_the_status(reported, code):
    host = Host(Mode.UNSEEN_END)
    host.receive(reported)
    assert (host.state.mode, error_code(host)) == (Mode.FAILED if code else Mode.FREE, code)


def test_a_run_whose_end_stays_unknown_fails():
    host = Host(Mode.UNSEEN_END)
    while host.state.mode is Mode.UNSEEN_END:
        host.play()
    assert error_code(host) == "instrument.end_unseen"


def test_a_release_does_not_answer_whether_the_end_was_played():
    host = Host(Mode.UNSEEN_END)
    host.do(machine.StopAsked(host.at))
    host.answer_stop()
    assert host.state.mode is Mode.UNSEEN_END
    host.do(machine.StopAsked(host.at))
    host.receive(status(10_000, State.LOADED, played=COMMAND.size + 200))
    host.answer_stop()
    assert host.state.mode is Mode.FREE


def test_a_run_that_the_device_stopped_fails_by_its_reason():
    host = Host(Mode.STOPPED)
    host.receive(status(host.state.next_index, State.RUNNING))
    assert host.state.mode is Mode.STOPPED
    host.receive(status(host.state.next_index, State.LOADED))
    assert error_code(host) == "instrument.stopped"
    host = Host(Mode.STOPPED)
    while host.state.mode is Mode.STOPPED:
        host.play()
    assert error_code(host) == "instrument.stopped"


@pytest.mark.parametrize("mode", [Mode.RUNNING, Mode.STOPPED])
def test_samples_that_contradict_a_run_release_the_coil(mode):
    host = Host(mode)
    if mode is Mode.RUNNING:
        while host.state.next_index < host.state.run.end_index:
            host.play(PLAYED)
    assert names(host.receive(data(host.state.next_index, PLAYED))) == "samples fail stop"
    assert error_code(host) == "instrument.contradiction"


@pytest.mark.parametrize("first", [0, 10**6])
def test_an_answer_to_start_that_contradicts_the_samples_releases_the_coil(first):
    host = Host(Mode.STARTING)
    host.play(PLAYED)
    assert names(host.answer(detail=first)) == "refuse fail stop"


def test_an_answer_to_finish_that_contradicts_the_samples_releases_the_coil():
    assert names(Host(Mode.FINISHING).answer(detail=0)) == "refuse fail stop"


def test_a_run_that_is_finished_is_shorter():
    host = Host(Mode.FINISHING)
    host.play(0)
    assert host.state.mode is Mode.FINISHING
    host.answer(detail=BLOCK)
    assert (host.state.mode, host.state.run.samples) == (Mode.RUNNING, BLOCK)
    assert "end" in names(host.play(int(wire.Flag.ENERGISED)))
    host = Host(Mode.ARMED)
    host.ask(machine.FinishAsked(host.at))
    assert host.state.mode is Mode.FREE, "it disarms"


def test_a_finish_that_is_refused_or_not_answered_leaves_the_run():
    for mode, actions in ((Mode.RUNNING, ""), (Mode.STOPPED, "STATUS_REQUEST")):
        host = Host(mode)
        host.do(machine.FinishAsked(host.at))
        assert names(host.answer(Result.UNKNOWN)) == "refuse"
        assert host.state.mode is mode
        assert names(host.play(PLAYED if mode is Mode.RUNNING else 0)).split()[1:] == actions.split()
    host = Host(Mode.FINISHING)
    for _ in range(5):
        host.at += 0.31
        host.play(PLAYED)
    assert host.state.unanswered
    assert host.state.mode is Mode.RUNNING


def test_a_start_that_is_refused_leaves_the_run_armed():
    host = Host(Mode.STARTING)
    assert names(host.answer(Result.FAULT_LATCHED, int(Fault.BUTTON))) == "refuse"
    assert host.state.mode is Mode.ARMED


def test_a_start_that_is_not_answered_releases_the_coil():
    host = Host(Mode.STARTING)
    sent = []
    while host.state.mode is Mode.STARTING:
        host.at += 0.3
        sent += names(host.play()).split()
    assert sent.count("START") == 4, "and once before"
    assert sent[-3:] == ["refuse", "end", "stop"]
    host.answer_stop()
    assert (host.state.mode, host.state.error) == (Mode.FREE, None)


def test_a_fault_before_the_answer_to_start_ends_the_run():
    host = Host(Mode.ARMED)
    host.state.status = replace(machine.parse_status(status().payload), faults=Fault.BUTTON)
    host.do(machine.StartAsked(host.at))
    assert names(host.answer(detail=host.state.next_index)) == "answer fail release"


def test_a_request_ends_with_a_new_error_of_the_run():
    host = Host(Mode.STARTING)
    host.receive(status(0, State.FAULT, Fault.BUTTON))
    assert names(host.tick()) == "refuse"
    host = Host(Mode.STARTING)
    host.receive(data(host.state.next_index, PLAYED, current=5.0))
    assert names(host.tick()) == "refuse"
    assert host.state.mode is Mode.RELEASING


@pytest.mark.parametrize("event", ["restart", "coil on"])
def test_an_answer_to_arm_after_a_failure_arms_nothing(event):
    host = Host(Mode.ARMED)
    host.do(machine.ArmAsked(host.at, LIMITS))
    sent = host.state.request.sent
    host.at += 0.01
    host.receive(status(boot_id=1) if event == "restart" else data(host.state.next_index, current=5.0))
    host.receive(ack(sent))
    assert host.state.limits is None
    assert host.state.mode is (Mode.FAILED if event == "restart" else Mode.RELEASING)


def test_a_clear_is_not_ended_by_the_fault_that_it_clears():
    host = Host(Mode.ARMED)
    host.do(machine.ClearAsked(host.at))
    host.receive(status(0, State.FAULT, Fault.BUTTON))
    assert names(host.tick()) == ""
    assert names(host.answer()) == "answer"
    assert (host.state.mode, host.state.error) == (Mode.FREE, None)


def test_stop_is_repeated_and_then_given_up():
    host = Host(Mode.RELEASING)
    sent = []
    while host.state.mode is Mode.RELEASING:
        host.at += 0.1
        sent += names(host.play()).split()
    assert sent.count("STOP") == 5
    assert (host.state.mode, error_code(host)) == (Mode.LOST, "link.lost_with_watchdog")
    assert holding("link.no_answer")(host.state.lost)
    host = Host(Mode.RELEASING)
    host.tick(1.1)
    assert host.state.mode is Mode.LOST
    host = Host(Mode.RELEASING)
    host.answer_stop(Result.BAD_STATE)
    assert host.state.mode is Mode.LOST
    host.do(machine.StopAsked(host.at))
    host.answer_stop()
    assert host.state.mode is Mode.LOST, "from now on this link sends nothing but STOP"


@pytest.mark.parametrize("mode", [Mode.FREE, Mode.FAILED])
@pytest.mark.parametrize("by_status", [False, True])
def test_a_coil_that_is_on_without_a_run_is_released_again(mode, by_status):
    host = Host(mode)
    host.play(count=110)
    host.play(count=100)
    if by_status:
        host.receive(status(10**6, State.RUNNING))
    else:
        host.receive(data(host.state.next_index, int(wire.Flag.ENERGISED)))
    assert host.state.mode is Mode.RELEASING
    count = len(host.actions)
    for _ in range(3):
        host.receive(data(host.state.next_index, int(wire.Flag.ENERGISED), count=100))
    assert "stop" not in names(host.actions[count:]), "once"


def test_a_restart_ends_the_run():
    host = Host(Mode.FREE)
    assert names(host.receive(status(boot_id=1))) == "fail release"
    assert error_code(host) == "instrument.restarted"


def test_a_watchdog_fault_after_silence_is_the_link():
    host = Host(Mode.RUNNING)
    host.at += 0.3
    host.receive(status(0, State.FAULT, Fault.WATCHDOG))
    assert holding("link.silent", seconds=0.3)(host.state.error)


def test_a_run_that_does_not_end_is_released():
    host = Host(Mode.RUNNING)
    host.at = host.state.began_s + host.state.allowed_s + 0.1
    assert names(host.tick(0.0)) == "fail stop"
    assert error_code(host) == "instrument.overdue"


def test_set_points_are_repeated_until_they_are_answered_or_played():
    host = Host(Mode.RUNNING)
    host.do(machine.SetPointsGiven(host.at, COMMAND.size, np.full(50, 3.0)))
    block = host.state.blocks[0]
    assert names(host.tick()) == ""
    assert names(host.tick(0.03)) == "SETPOINTS"
    host.receive(ack(block.sent, Result.LATE, index=host.state.next_index))
    assert (host.state.late_blocks, host.state.repeated_blocks, host.state.blocks) == (1, 1, ())
    assert host.state.margin_samples == COMMAND.size - BLOCK
    host.receive(ack(block.sent, Result.LATE))
    assert host.state.late_blocks == 1, "a repeated answer"
    host.do(machine.SetPointsGiven(host.at, COMMAND.size, np.full(50, 3.0)))
    while host.state.next_index < host.state.run.first_index + COMMAND.size + 60:
        host.receive(data(host.state.next_index, PLAYED))
    host.tick(0.03)
    assert host.state.blocks == ()


def test_a_refused_set_point_releases_the_coil():
    host = Host(Mode.ARMED)
    for _ in range(2):
        host.do(machine.SetPointsGiven(host.at, COMMAND.size, np.full(50, 3.0)))
    for block in host.state.blocks:
        host.receive(ack(block.sent, Result.BEYOND_LIMITS))
    assert host.state.margin_samples is None
    host.start()
    assert names(host.play(PLAYED)) == "samples fail stop"
    assert error_code(host) == "refused.beyond_limits"


def test_the_calibration_is_checked_too():
    host = Host(Mode.ARMED)
    device = replace(HANDSHAKE.device, force_constant_n_per_a=2.0 * HANDSHAKE.device.force_constant_n_per_a)
    host = Host(Mode.FREE)
    host.do(machine.CalibrationChosen(host.at, device, {"current": Correction(1.0, 0.0)}))
    host.ask(machine.LoadAsked(host.at, COMMAND))
    host.ask(machine.ArmAsked(host.at, replace(LIMITS, max_force_n=4.0)))
    host.start()
    assert "fail" in names(host.play(PLAYED, current=0.9))
    assert error_code(host) == "limit.force"


@pytest.mark.parametrize(
    ("event", "code"),
    [
        (machine.ArmAsked(0.0, replace(LIMITS, max_force_n=1.0)), "limit.stimulus_force"),
        (machine.ArmAsked(0.0, replace(LIMITS, max_seconds=0.1)), "limit.stimulus_time"),
        (machine.ArmAsked(0.0, replace(LIMITS, max_position_m=0.04)), "limit.beyond_stroke"),
        (machine.SetPointsGiven(0.0, COMMAND.size, np.full(50, 47.0)), "limit.stimulus_force"),
        (machine.SetPointsGiven(0.0, COMMAND.size - 1, np.full(50, 1.0)), "instrument.unexpected_set_points"),
        (machine.LoadAsked(0.0, np.full(10, 1e4)), "limit.converter"),
    ],
)
def test_a_command_beyond_a_limit_is_not_sent(event, code):
    host = Host(Mode.ARMED)
    before = host.state
    (answer,) = host.do(event)
    assert coded(code)(answer.error)
    assert host.state is before


def test_the_hold_level_is_checked():
    host = Host(Mode.FREE)
    host.ask(machine.LoadAsked(host.at, np.full(400, 1.0)))
    host.ask(machine.FollowAsked(host.at, 100, 40.0))
    (answer,) = host.do(machine.ArmAsked(host.at, LIMITS))
    assert coded("limit.stimulus_force")(answer.error)


def test_a_request_takes_the_place_of_one_whose_caller_was_interrupted():
    host = Host(Mode.FREE)
    host.do(machine.LoadAsked(host.at, COMMAND))
    interrupted = host.state.request.sent
    host.do(machine.RequestAsked(host.at, MessageType.STREAM))
    assert names(host.receive(ack(interrupted))) == ""
    assert names(host.answer()) == "answer"


def test_no_request_drives_without_its_event():
    with pytest.raises(RuntimeError):
        Host(Mode.ARMED).do(machine.RequestAsked(0.0, MessageType.START))


def test_a_request_is_repeated_and_then_given_up():
    host = Host(Mode.FREE)
    trips = host.state.round_trips_s
    host.do(machine.ClearAsked(host.at))
    host.at += 0.3
    assert names(host.play()) == "samples HEARTBEAT CLEAR_FAULTS"
    assert names(host.answer()) == "answer"
    assert host.state.round_trips_s == trips, "unknown to which attempt the answer belongs"
    host.do(machine.ClearAsked(host.at))
    for _ in range(5):
        host.at += 0.3
        host.play()
    assert (host.state.request, host.state.unanswered, host.state.mode) == (None, True, Mode.FREE)
    host.do(machine.StopAsked(host.at))
    assert host.state.stop.tries == 3, "and not six"


def test_a_refused_chunk_ends_a_load():
    host = Host(Mode.FREE)
    host.do(machine.LoadAsked(host.at, COMMAND))
    host.answer()
    assert names(host.answer(Result.BAD_ARGUMENT)) == "refuse"
    assert host.state.request is None


def test_without_a_device_on_a_link_nothing_is_encoded():
    host = Host(Mode.OPENING)
    host.state.mode = Mode.FREE
    host.ask(machine.LoadAsked(0.0, COMMAND))
    host.ask(machine.FollowAsked(0.0, 100, 1.0))
    host.do(machine.SamplesTaken(0.0, taken(host)))
    host.ask(machine.ArmAsked(0.0, LIMITS))
    assert names(host.do(machine.SetPointsGiven(0.0, COMMAND.size, np.full(50, 3.0)))) == ""
    assert names(host.receive(data(0))) == ""
    assert names(host.receive(status(boot_id=5))) == ""


# -- whatever happens -------------------------------------------------------------------------------------------------

DRIVING = {MessageType.ARM, MessageType.START, MessageType.SETPOINTS}
PLAYED_MODES = (Mode.RUNNING, Mode.STOPPED, Mode.FINISHING)
VOLTS_PER_N = HANDSHAKE.device.coil_resistance_ohm / HANDSHAKE.device.force_constant_n_per_a

volts = st.sampled_from([0.0, 6.0, -20.0, 31.9, 32.5, 47.9])
happenings = st.one_of(
    st.tuples(
        st.just("data"), st.sampled_from([0, 0, 0, 20, 100, 11_000]), st.sampled_from([None, None, 0, 4, PLAYED])
    ),
    st.tuples(st.just("spoiled"), st.sampled_from(["force", "position", "temperature", "late", "ragged", "version"])),
    st.tuples(st.just("tick"), st.sampled_from([0.0, 0.01, 0.03, 0.1, 0.3, 1.1])),
    st.tuples(st.just("answer"), st.sampled_from([Result.OK, Result.OK, Result.OK, Result.BAD_STATE, Result.LATE])),
    st.tuples(st.just("status"), st.sampled_from(list(State)), st.sampled_from([0, 0, 1, 32]), st.booleans()),
    st.tuples(st.just("load"), volts, st.booleans()),
    st.tuples(st.just("follow"), volts, st.booleans()),
    st.tuples(st.just("arm"), st.sampled_from([0.5, 8.0, 12.0]), st.booleans()),
    st.tuples(st.just("points"), volts),
    st.tuples(st.sampled_from(["start", "start", "finish", "stop", "clear", "ask", "port", "bytes", "calibrate"])),
)
"""What the cable, the device, the clock and the program may do next."""

PREFIXES = [
    [],
    [("load", 6.0, True), ("arm", 8.0, False)],
    [("load", 6.0, True), ("arm", 8.0, True)],
    [("load", 6.0, True), ("follow", 6.0, True), ("arm", 8.0, True), ("start",)],
    [("load", 6.0, True), ("follow", 6.0, True), ("arm", 8.0, True), ("start",), ("answer", Result.OK)],
]


class Watched(Host):
    """A host of which every step is checked."""

    def __init__(self):
        super().__init__(Mode.FREE)
        self.next_sample = self.state.next_index
        self.armed, self.may_beat, self.limits = False, True, LIMITS

    def do(self, event):
        if not hasattr(self, "armed"):
            return super().do(event)
        before, values = self.state, dict(vars(self.state))
        actions = super().do(event)
        assert vars(before) == values, "a step changes no state"
        assert names(step(before, event)[1]) == names(actions), "and does the same again"
        if isinstance(event, machine.ArmAsked) and names(actions) != "refuse":
            self.armed, self.limits = True, event.limits
        for action in actions:
            self.check(action, before)
        if any(isinstance(action, machine.EndRun) and action.error is not None for action in actions):
            assert isinstance(actions[-1], machine.ReleaseCoil)
        state, mode = self.state, self.state.mode
        assert (state.stop is not None) == (mode is Mode.RELEASING)
        assert (state.error is not None) == (mode in (Mode.FAILED, Mode.LOST)) or mode is Mode.RELEASING
        assert (state.lost is not None) == (mode is Mode.LOST) or mode is Mode.RELEASING
        assert (state.limits is not None) == (mode in (Mode.ARMED, Mode.STARTING, *PLAYED_MODES))
        assert (state.run is not None) == (mode in PLAYED_MODES)
        assert (state.unseen is not None) == (mode is Mode.UNSEEN_END) or mode is Mode.RELEASING
        self.may_beat = mode not in (Mode.RELEASING, Mode.FAILED, Mode.LOST)
        return actions

    def check(self, action, before):
        match action:
            case machine.SendFrame():
                if action.kind is MessageType.HEARTBEAT:
                    assert self.may_beat
                if self.drives(action):
                    assert self.armed, "nothing drives after a release but a new ARM"
                    self.check_command(action)
            case machine.ReleaseCoil():
                self.armed = self.may_beat = False
            case machine.DeliverSamples():
                index = action.samples["index"]
                assert index[0] == self.next_sample
                assert np.array_equal(index, index[0] + np.arange(index.size))
                lost = np.isnan(action.samples["position"])
                assert np.count_nonzero(lost) == (action.gap.count if action.gap else 0)
                assert lost[: np.count_nonzero(lost)].all()
                self.next_sample = int(index[-1]) + 1

    @staticmethod
    def payload(action):
        (decoded,) = wire.FrameDecoder().feed(action.data)
        return decoded.payload

    def drives(self, action):
        """Whether an action lets the coil push; START with a token that no ARM has does not."""
        if not isinstance(action, machine.SendFrame) or action.kind not in DRIVING:
            return False
        return action.kind is not MessageType.START or wire.unpack(wire.START, self.payload(action))[0]["token"] != 0

    def check_command(self, action):
        device, payload = HANDSHAKE.device, self.payload(action)
        if action.kind is MessageType.ARM:
            asked = wire.unpack(wire.ARM, payload)[0]
            own = self.limits
            assert asked["max_force_n"] <= min(own.max_force_n, HANDSHAKE.max_force_n)
            assert asked["max_temperature_c"] <= min(own.max_temperature_c, HANDSHAKE.max_temperature_c)
            assert 0.0 < asked["min_position_m"] < asked["max_position_m"] <= device.stroke_m
            assert asked["max_samples"] <= own.max_seconds * device.sample_rate_hz
            state = self.state
            assert state.command_v.size + state.following <= asked["max_samples"]
            played = np.append(state.command_v, state.hold_v if state.following else 0.0)
            assert np.abs(played).max() <= own.max_force_n * VOLTS_PER_N
        elif action.kind is MessageType.SETPOINTS:
            codes = np.frombuffer(wire.unpack(wire.SETPOINTS, payload, tail=True)[1], "<i2")
            played = np.abs(codes * HANDSHAKE.gains[0] + HANDSHAKE.offsets[0])
            assert played.max() <= self.limits.max_force_n * VOLTS_PER_N + HANDSHAKE.gains[0]

    def happen(self, what, *details):
        at, state = self.at, self.state
        first = state.next_index or 0
        match what:
            case "data":
                lost, flags = details
                usual = PLAYED if state.mode in (Mode.STARTING, Mode.RUNNING, Mode.FINISHING) else 0
                self.receive(data(first + lost, usual if flags is None else flags))
            case "spoiled":
                frames = {
                    "force": data(first, PLAYED, current=5.0),
                    "position": data(first, PLAYED, position=0.0319),
                    "temperature": data(first, PLAYED, temperature=100.0),
                    "late": data(max(0, first - 20)),
                    "ragged": Frame(MessageType.DATA, sample_index=first, payload=b"123"),
                    "version": replace(data(first), version=7),
                }
                self.receive(frames[details[0]])
            case "tick":
                self.tick(details[0])
            case "answer":
                for pending in (state.stop, state.request, *state.blocks):
                    if pending is not None:
                        detail = COMMAND.size if pending.sent.kind is MessageType.FINISH else first
                        self.receive(ack(pending.sent, details[0], detail, first))
            case "status":
                standing, faults, same = details
                self.receive(status(first, standing, faults, None if same else 5, COMMAND.size))
            case "load" | "follow" | "arm":
                event = {
                    "load": lambda: machine.LoadAsked(at, np.full(COMMAND.size, details[0])),
                    "follow": lambda: machine.FollowAsked(at, 200, details[0]),
                    "arm": lambda: machine.ArmAsked(at, replace(LIMITS, max_force_n=details[0])),
                }[what]()
                self.do(event)
                while details[1] and self.state.request is not None and self.state.request.asked is event:
                    self.answer()
            case "points":
                self.do(machine.SetPointsGiven(at, COMMAND.size, np.full(50, details[0])))
            case _:
                events = {
                    "start": machine.StartAsked(at),
                    "finish": machine.FinishAsked(at),
                    "stop": machine.StopAsked(at),
                    "clear": machine.ClearAsked(at),
                    "ask": machine.RequestAsked(at, MessageType.STAGE),
                    "port": machine.PortFailed(at, LinkLostError("broken")),
                    "bytes": machine.BytesRefused(at),
                    "calibrate": machine.CalibrationChosen(at, HANDSHAKE.device, {}),
                }
                self.do(events[what])


@pytest.mark.parametrize("prefix", PREFIXES, ids=["free", "arming", "armed", "starting", "running"])
@settings(max_examples=60)
@given(happened=st.lists(happenings, max_size=40), end=st.sampled_from(["fault", "silence", "stop"]))
def test_whatever_happens_the_coil_is_released_and_every_sample_is_delivered_once(prefix, happened, end):
    host = Watched()
    for what in [*prefix, *happened]:
        host.happen(*what)
    armed = host.state.limits is not None
    if end == "stop":
        host.happen("stop")
        assert host.state.mode is Mode.RELEASING
    elif end == "silence":
        host.happen("tick", 1.1)
        host.happen("tick", 1.1)
        assert host.state.mode in (Mode.FAILED, Mode.LOST)
    else:
        host.receive(status(host.state.next_index or 0, State.FAULT, Fault.STROKE))
        assert not armed or host.state.error is not None
    ends = [action for action in host.actions if isinstance(action, machine.ReleaseCoil) or host.drives(action)]
    if ends and (armed or end != "fault"):
        assert isinstance(ends[-1], machine.ReleaseCoil)
