"""Clauses of docs/protocol.md, section 5: the safety rules, each tested without any check of the host."""

from __future__ import annotations

import struct
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tissueid.instrument.interface import SIGNALS
from tissueid.language import marked
from tissueid.wire import Fault, Flag, MessageType, Result, State
from tissueid_lab.conformance.clause import NotTestedError, clause, require
from tissueid_lab.conformance.device import GENTLE_N, DeviceRun, DeviceUnderTest
from tissueid_lab.conformance.exchange import Act, require_status
from tissueid_lab.conformance.run_clauses import STEP

_LATER_S = 0.1
"""Time after the watchdog's own within which the fault must be reported."""
_CEILING = 1.01
_TRIP = 1.05
_SHARE = 0.8
"""Share of the confirmed force that is held, so that the noise of the current sensor does not trip."""


def _require_fault(run: DeviceRun, fault: Fault, last: int | None = None) -> None:
    """Require that a run ended by a fault, and that the amplifier was off after sample ``last`` of the run."""
    require_status(run.status, faults=fault, state=State.FAULT)
    on = np.flatnonzero(run.flagged(Flag.ENERGISED))
    if last is not None:
        newest = int(on[-1]) if on.size else -1
        require(newest <= last, f"the amplifier off after sample {last} of the run", f"on at sample {newest}")


def _quiet(device: DeviceUnderTest, seconds: float) -> NDArray[np.int16]:
    return np.zeros(round(seconds * device.rate_hz), "<i2")


@clause("5.1a", marked("The amplifier is enabled in RUNNING only"), drives=True)
def _enabled(device: DeviceUnderTest) -> None:
    device.stream()
    device.pump(0.1)
    device.load(device.codes(0.5 * device.force_n, 200))
    device.pump(0.1)
    device.keep_alive(True)
    device.arm()
    device.pump(0.2)
    samples = device.samples()
    require(samples.size > 0.3 * device.rate_hz, "DATA while streaming", samples.size)
    on = np.count_nonzero(samples["flags"] & int(Flag.ENERGISED))
    require(on == 0, "the amplifier off in IDLE, LOADED and ARMED", f"{on} samples on")
    run = device.finish_run(device.start(), 2.0)
    require(run.flagged(Flag.ENERGISED)[:200].all(), "the amplifier on in RUNNING", "samples without")


@clause("5.2a", marked("Watchdog: without a heartbeat ARMED ends with a fault in time"))
def _watchdog_armed(device: DeviceUnderTest) -> None:
    device.load(_quiet(device, 0.01))
    answer = device.expect(Result.OK, MessageType.ARM, device.arm_payload())
    promised = device.known.watchdog_s
    status = device.wait_for_fault(Fault.WATCHDOG, promised + 0.5, "in ARMED")
    seconds = (status["index"] - answer.index) / device.rate_hz
    device.measured = {"watchdog_s": seconds}
    within = promised - 0.05 <= seconds <= promised + _LATER_S
    require(within, f"the fault {promised:.2f} s after ARM", f"{seconds:.2f} s")


@clause("5.2b", marked("Watchdog: without a heartbeat a run is released in time"), drives=True)
def _watchdog_running(device: DeviceUnderTest) -> None:
    first = device.begin_run(device.codes(0.2 * device.force_n, round(2.0 * device.rate_hz)))
    device.keep_alive(False)
    promised = device.known.watchdog_s
    run = device.finish_run(first, promised + 0.5)
    _require_fault(run, Fault.WATCHDOG, round((promised + _LATER_S) * device.rate_hz))
    seconds = np.count_nonzero(run.flagged(Flag.ENERGISED)) / device.rate_hz
    device.measured = {"released_after_s": seconds}
    require(seconds >= promised - 0.05, f"a run of {promised:.2f} s without a heartbeat", f"{seconds:.2f} s")


@clause("5.2c", marked("Heartbeats keep a run alive; other frames do not"), drives=True)
def _heartbeats(device: DeviceUnderTest) -> None:
    run = device.play(_quiet(device, 1.2))
    require_status(run.status, faults=Fault.NONE, state=State.LOADED)
    device.arm()
    first = device.start()
    device.keep_alive(False)
    for _ in range(8):
        device.pump(0.1)
        device.send(MessageType.STATUS_REQUEST)
    run = device.finish_run(first, 0.5)
    require_status(run.status, faults=Fault.WATCHDOG)


@clause("5.3a", marked("NaN and infinite limits are refused"))
def _not_finite(device: DeviceUnderTest) -> None:
    device.load(_quiet(device, 0.01))
    for name in ("max_force_n", "min_position_m", "max_position_m", "max_temperature_c"):
        for value in (np.nan, np.inf, -np.inf):
            payload = device.arm_payload(**{name: value})
            device.expect(Result.BEYOND_LIMITS, MessageType.ARM, payload, f"with {name} {value}")
    device.require_state(State.LOADED)


@clause(
    "5.3b", marked("Limits above those of the device, that contradict each other, or below any reading are refused")
)
def _beyond(device: DeviceUnderTest) -> None:
    device.load(_quiet(device, 0.01))
    stroke = device.known.device.stroke_m
    for changed in (
        {"max_force_n": 0.0},
        {"max_force_n": -1.0},
        {"max_force_n": 5e-324},
        {"max_temperature_c": -1e308},
        {"min_position_m": 0.01, "max_position_m": 0.01 + 1e-9},
        {"max_force_n": device.known.max_force_n * 1.01, "min_position_m": 0.0, "max_position_m": stroke},
        {"max_temperature_c": device.known.max_temperature_c + 0.5},
        {"min_position_m": 0.01, "max_position_m": 0.01},
        {"min_position_m": 0.02, "max_position_m": 0.01},
        {"max_samples": 0},
        {"max_samples": round(90.0 * device.rate_hz) + 1},
        {"max_samples": 2**32 - 1},
    ):
        values = ", ".join(f"{name} {value:g}" for name, value in changed.items())
        device.expect(Result.BEYOND_LIMITS, MessageType.ARM, device.arm_payload(**changed), f"with {values}")


@clause("5.3c", marked("A stimulus more than 5 % above the force limit is refused"))
def _too_strong(device: DeviceUnderTest) -> None:
    low = 0.5 * device.force_n
    for sign in (1.0, -1.0):
        codes = _quiet(device, 0.1)
        codes[50] = device.codes(sign * 1.08 * low)[0]
        device.load(codes)
        payload = device.arm_payload(max_force_n=low)
        device.expect(Result.BEYOND_LIMITS, MessageType.ARM, payload, "with a sample 8 % above the force limit")
    codes[50] = device.codes(1.02 * low)[0]
    device.load(codes)
    device.arm(max_force_n=low)


@clause("5.3d", marked("A stimulus longer than agreed is refused"))
def _too_long(device: DeviceUnderTest) -> None:
    device.load(np.zeros(100, "<i2"))
    device.expect(Result.BEYOND_LIMITS, MessageType.ARM, device.arm_payload(max_samples=99), "with 100 of 99 samples")
    device.arm(max_samples=100)


@clause("5.3e", marked("Position limits lie within the stroke; up to 1 mm beyond it with 2 N or less"))
def _ends(device: DeviceUnderTest) -> None:
    stroke = device.known.device.stroke_m
    device.load(_quiet(device, 0.01))
    within = {"min_position_m": 0.0, "max_position_m": stroke}
    for force_n, beyond in ((2.1, 0.0), (min(2.0, device.force_n), 1e-3)):
        for changed in ({"min_position_m": -beyond - 2e-4}, {"max_position_m": stroke + beyond + 2e-4}):
            payload = device.arm_payload(**(within | changed), max_force_n=force_n)
            name, value = next(iter(changed.items()))
            device.expect(Result.BEYOND_LIMITS, MessageType.ARM, payload, f"with {name} {value:g} and {force_n:g} N")


@clause("5.4a", marked("Force above 1.05 times its limit releases the coil before the next sample"), drives=True)
def _force(device: DeviceUnderTest) -> None:
    constant = device.known.device.force_constant_n_per_a
    noise_a = np.abs(device.physical(device.readings(0.2), "current"))
    step_a = float(device.known.gains[SIGNALS.index("current")])
    if not noise_a.max() > 2.0 * step_a:
        raise NotTestedError("conformance.no_noise", "the current reads zero without a command")
    # A limit within the noise of the sensor: the force need not be real for the check to see it.
    limit = min(0.5 * constant * float(noise_a.max()), device.force_n)
    run = device.play(_quiet(device, 0.5), max_force_n=limit)
    force = constant * np.abs(device.physical(run.samples, "current"))
    beyond = np.flatnonzero(force > _TRIP * limit)
    _require_fault(run, Fault.OVER_FORCE, int(beyond[0]) if beyond.size else 0)


@clause("5.4b", marked("A position beyond its limit releases the coil before the next sample"), drives=True)
def _stroke(device: DeviceUnderTest) -> None:
    position = float(np.median(device.physical(device.readings(), "position")))
    run = device.play(_quiet(device, 0.5), max_position_m=max(position - 5e-4, -9e-4), min_position_m=-1e-3)
    _require_fault(run, Fault.STROKE, 0)


@clause("5.4c", marked("The near limit applies after 0.5 s to a probe that was never inside"), drives=True)
def _near(device: DeviceUnderTest) -> None:
    position = float(np.median(device.physical(device.readings(), "position")))
    run = device.play(_quiet(device, 1.0), min_position_m=position + 5e-4)
    half = round(0.5 * device.rate_hz)
    _require_fault(run, Fault.STROKE, half + 1)
    on = int(np.count_nonzero(run.flagged(Flag.ENERGISED)))
    require(on >= half - 1, f"a run of {half} samples before the limit applies", on)


@clause("5.4d", marked("A temperature above its limit releases the coil before the next sample"), drives=True)
def _temperature(device: DeviceUnderTest) -> None:
    temperature = float(np.median(device.physical(device.readings(), "temperature")))
    run = device.play(_quiet(device, 0.5), max_temperature_c=temperature - 5.0)
    _require_fault(run, Fault.OVER_TEMPERATURE, 0)


@clause("5.4e", marked("A command is lowered where motion would raise the force by more than 1 %"), drives=True)
def _lowered(device: DeviceUnderTest) -> None:
    limit = 0.95 * device.force_n
    codes = _quiet(device, 0.6)
    every = round(0.01 * device.rate_hz)
    pulses = np.arange(6 * every, codes.size, every)  # after the soft start; the noise of the current may end them
    signs = np.where(np.arange(pulses.size) % 2, -1.04, 1.04)
    codes[pulses] = np.rint(signs * float(device.codes(limit)[0])).astype("<i2")
    run = device.play(codes, max_force_n=limit)
    body, gain = device.known.device, device.known.gains[0]
    position = device.physical(run.samples, "position")[: codes.size]
    step = np.diff(position) * device.rate_hz
    speed = step[1:-1] + 0.5 * (step[1:-1] - step[:-2])  # at the start of samples 3, 4, ...
    command = device.physical(run.samples, "command")[3 : position.size]
    sign = np.sign(command)
    ceiling_v = _CEILING * limit * body.coil_resistance_ohm / body.force_constant_n_per_a
    most_v = np.maximum(0.0, ceiling_v + body.force_constant_n_per_a * speed * sign) / body.amplifier_gain
    excess = np.abs(command) - most_v
    playing = run.flagged(Flag.PLAYING)[3 : position.size]
    worst = float(excess[playing].max(initial=-1.0))
    require(worst <= STEP * gain, "no command above the predicted limit", f"{worst:.3f} V above it")
    wanted = np.abs(codes[3 : position.size]) * gain - most_v
    lowered = run.flagged(Flag.LIMITED)[3 : position.size]
    require(lowered[wanted > STEP * gain].any(), "flag 64 on lowered samples", "none")


@clause("5.4f", marked("Above 2 N the near end of the position converter is a STROKE fault"), drives=True)
def _end_of_converter(device: DeviceUnderTest) -> None:
    end, force_n = -32768, 1.05 * GENTLE_N
    codes = device.codes(-0.9 * device.force_n, round(0.8 * device.rate_hz))
    device.play(codes)  # off the far end, where a free coil lies
    reached = False
    if device.known.max_force_n >= force_n:
        device.keep_alive(True)
        device.arm(max_force_n=force_n, min_position_m=0.0, max_position_m=device.known.device.stroke_m)
        run = device.finish_run(device.start(), 2.0)
        at_end = np.flatnonzero(run.samples["position"] == end)
        reached = at_end.size > 0
    if not reached:
        raise NotTestedError("conformance.end_not_reached", "the probe does not reach that end")
    # A probe that begins there has half a second to leave.
    _require_fault(run, Fault.STROKE, int(at_end[0]) if at_end[0] > 0 else round(0.5 * device.rate_hz) + 1)


@clause(
    "5.5a",
    marked("Soft start: 50 ms follow a quarter of a sine, and lowered samples are flagged"),
    drives=True,
)
def _soft_start(device: DeviceUnderTest) -> None:
    count = round(0.05 * device.rate_hz)
    codes = device.codes(0.5 * device.force_n, 3 * count)
    run = device.play(codes)
    share = np.sin(0.5 * np.pi * np.minimum((1.0 + np.arange(3 * count)) / count, 1.0))
    expected = share * float(codes[0])
    played = run.samples["command"][: 3 * count].astype(np.float64)
    require(played.size == 3 * count, f"{3 * count} samples", played.size)
    excess = np.abs(played) - np.abs(expected)
    require(excess.max() <= STEP, "no command above the soft start", f"{excess.max():.0f} codes above")
    free = ~run.flagged(Flag.LIMITED)[: 3 * count]
    worst = float(np.abs(played - expected)[free].max(initial=0.0))
    require(worst <= STEP, "a quarter of a sine", f"{worst:.0f} codes from it")
    lowered = np.abs(expected - codes) > STEP
    flagged = run.flagged(Flag.SOFT_START)[: 3 * count]
    require(flagged[lowered].all(), "flag 32 on lowered samples", "samples without")
    require(not flagged[count:].any(), "no flag 32 after 50 ms", "samples with it")


@clause(
    "5.6a", marked("The button releases the coil, and prevents every motion while it is down"), drives=True, person=True
)
def _button(device: DeviceUnderTest) -> None:
    device.load(_quiet(device, 0.1))
    device.keep_alive(True)
    device.arm()
    seconds = device.act(Act.PRESS_BUTTON)
    device.wait_for_fault(Fault.BUTTON, seconds + 0.1, "in ARMED")
    device.expect(Result.OK, MessageType.CLEAR_FAULTS)
    device.load(_quiet(device, 0.1))
    for kind, payload in (
        (MessageType.ARM, device.arm_payload()),
        (MessageType.START, struct.pack("<I", 7)),
        (MessageType.STAGE, struct.pack("<d", np.nan)),
    ):
        answer = device.ask(kind, payload)
        if kind != MessageType.STAGE or answer.result != Result.UNKNOWN:
            require(answer.result == Result.FAULT_LATCHED, f"FAULT_LATCHED to {kind.name} with the button down", answer)
            require(answer.detail == Fault.BUTTON, f"detail {int(Fault.BUTTON)}", answer.detail)
    released = device.act(Act.RELEASE_BUTTON)
    device.pump(released)
    device.expect(Result.OK, MessageType.CLEAR_FAULTS)
    device.expect(Result.OK, MessageType.RELEASE)
    first = device.begin_run(_quiet(device, 25.0))
    run = device.finish_run(first, device.act(Act.PRESS_BUTTON) + 0.1)
    down = np.flatnonzero(run.flagged(Flag.BUTTON))
    _require_fault(run, Fault.BUTTON, int(down[0]) if down.size else 0)
    device.pump(device.act(Act.RELEASE_BUTTON))


@clause("5.7a", marked("The calculated temperature releases the coil although its sensor reads less"), drives=True)
def _calculated(device: DeviceUnderTest) -> None:
    body = device.known.device
    current = _SHARE * device.force_n / body.force_constant_n_per_a
    heat_w = body.coil_resistance_ohm * current**2
    if heat_w < 0.5:
        raise NotTestedError("conformance.too_little_heat", "needs a larger confirmed force: {heat:.2f} W", heat=heat_w)
    sensor = float(np.median(device.physical(device.readings(), "temperature")))
    limit = max(sensor, 28.0) + 1.0
    if limit > min(device.known.max_temperature_c, device.confirmed.max_temperature_c):
        raise NotTestedError("conformance.hot", "the coil is too warm: {degrees:.0f} degC", degrees=sensor)
    # From the surroundings of 28 degC on; the device may begin warmer, and is then earlier.
    seconds = 16.5 * body.coil_resistance_ohm / 12.0 / (heat_w - 0.12)
    codes = device.codes(_SHARE * device.force_n, round(1.3 * seconds * device.rate_hz))
    run = device.play(codes, max_temperature_c=limit)
    read = device.physical(run.samples, "temperature")
    device.measured = {"seconds": float(np.count_nonzero(run.flagged(Flag.ENERGISED)) / device.rate_hz)}
    _require_fault(run, Fault.OVER_TEMPERATURE)
    require(np.median(read[-20:]) <= limit, "a sensor below the limit", f"{np.median(read[-20:]):.1f} degC")


def _steps(device: DeviceUnderTest) -> NDArray[np.int16]:
    """Return steps between two forces, for ten seconds."""
    low, high = (float(device.codes(share * device.force_n)[0]) for share in (-0.5, _SHARE))
    block = round(0.04 * device.rate_hz)
    on = np.arange(round(10.0 * device.rate_hz)) // block % 2 == 0
    return np.where(on, high, low).astype("<i2")


@clause("5.8a", marked("A position that does not follow the force is a SENSOR fault"), drives=True, person=True)
def _position_sensor(device: DeviceUnderTest) -> None:
    first = device.begin_run(_steps(device))
    device.pump(0.2)
    seconds = device.act(Act.DISCONNECT_POSITION)
    run = device.finish_run(first, seconds + 0.3)
    device.pump(device.act(Act.CONNECT_POSITION))
    faults = Fault(run.status["faults"])
    require(faults in (Fault.SENSOR, Fault.STROKE), "fault SENSOR", faults)


@clause("5.8b", marked("A current that does not follow the voltage is an OPEN_COIL fault"), drives=True, person=True)
def _open_coil(device: DeviceUnderTest) -> None:
    volts = device.known.device.voltage_for_force(device.force_n)
    if _SHARE * volts < 2.2:
        raise NotTestedError("conformance.few_volts", "needs 2 V: a larger confirmed force")
    first = device.begin_run(device.codes(_SHARE * device.force_n, round(20.0 * device.rate_hz)))
    device.pump(0.2)
    seconds = device.act(Act.DISCONNECT_COIL)
    run = device.finish_run(first, seconds + 0.1)
    device.pump(device.act(Act.CONNECT_COIL))
    _require_fault(run, Fault.OPEN_COIL)


@clause("5.9a", marked("A supply that sags latches BROWN_OUT in any state, again while it lasts"), person=True)
def _supply(device: DeviceUnderTest) -> None:
    seconds = device.act(Act.LOWER_SUPPLY)
    device.wait(lambda: bool(device.statuses), seconds + 0.1, "fault BROWN_OUT in IDLE")
    require_status(device.status(), faults=Fault.BROWN_OUT, state=State.FAULT)
    device.expect(Result.OK, MessageType.CLEAR_FAULTS)
    device.pump(0.05)
    device.require_state(State.FAULT, "while the supply is low")
    device.pump(device.act(Act.RESTORE_SUPPLY))
    device.expect(Result.OK, MessageType.CLEAR_FAULTS)
    device.require_state(State.IDLE, "after the supply has returned")


@clause("5.10a", marked("A fault latches: requests are refused until CLEAR_FAULTS, and accepted again after it"))
def _latched(device: DeviceUnderTest) -> None:
    device.load(np.zeros(10, "<i2"))
    device.arm()
    device.wait_for_fault(Fault.WATCHDOG, 1.5)
    for kind in (*range(MessageType.STIMULUS_BEGIN, MessageType.SETPOINTS + 1), 0x20, 0x21, 0x25):
        device.expect(Result.FAULT_LATCHED, kind, bytes(12), "while a fault is latched", detail=Fault.WATCHDOG)
    device.expect(Result.OK, MessageType.STOP)
    device.hello()
    device.require_state(State.FAULT, "after STOP and HELLO")
    device.expect(Result.OK, MessageType.CLEAR_FAULTS)
    device.require_state(State.IDLE, "after CLEAR_FAULTS")
    device.expect(Result.BAD_STATE, MessageType.ARM, device.arm_payload(), "after CLEAR_FAULTS")


@clause("5.11a", marked("A host that does not read does not stop the device; dropped frames are counted"))
def _unread(device: DeviceUnderTest) -> None:
    device.stream()
    device.load(np.zeros(10, "<i2"))
    dropped = device.status()["dropped_frames"]
    answer = device.expect(Result.OK, MessageType.ARM, device.arm_payload())
    device.blocks.clear()
    for _ in range(6):  # more than a device can keep, and never silent for so long that streaming ends
        device.send(MessageType.STATUS_REQUEST)
        device.line.pause(0.5)
    device.pump(0.3)
    faults = [item for item in device.statuses if item["state"] == State.FAULT]
    status = device.require_state(State.FAULT, "by the watchdog although nothing was read")
    if faults:
        seconds = (faults[0]["index"] - answer.index) / device.rate_hz
        promised = device.known.watchdog_s
        require(seconds <= promised + _LATER_S, f"the fault after {promised:.2f} s", f"{seconds:.2f} s")
    size = device.properties["samples_per_frame"]
    indices = [index for index, _ in device.blocks]
    require(len(indices) >= 2, "DATA while streaming", "none")
    missing = sum((b - a) // size - 1 for a, b in pairwise(indices))
    counted = status["dropped_frames"] - dropped
    device.measured = {"dropped_frames": float(counted)}
    require(missing <= counted, f"{missing} dropped frames to be counted", counted)
