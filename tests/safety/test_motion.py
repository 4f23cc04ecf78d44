"""How the coil begins and ends to push, the ends of its stroke, and the stage."""

import itertools

import numpy as np
import pytest
from coded import coded
from safety.rigs import RATE, WIDE, last_energised, rig, run_until_it_ends, volts, without_firmware, without_host
from support import softly

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from firmware_sim.identity import Identity
from tissueid import wire
from tissueid.acquisition.guided import find_surface
from tissueid.errors import FirmwareFaultError, InstrumentError, LimitError
from tissueid.instrument import CLINICAL, Limits, SimulatedInstrument
from tissueid.wire import Fault, Flag, MessageType, Result

STEP_V = 60 / 32768
GENTLE = Limits(max_force_n=2.0, min_position_m=-0.001, max_position_m=0.033)

both = pytest.mark.parametrize("opened", [rig, SimulatedInstrument], ids=["firmware", "in process"])


def played(instrument, command, limits=CLINICAL):
    instrument.load(command)
    instrument.arm(limits)
    run = instrument.start()
    blocks = [instrument.poll(0.05)]
    while blocks[-1].size == 0 or blocks[-1]["index"][-1] < run.end_index + 150:
        blocks.append(instrument.poll(0.05))
    samples = np.concatenate(blocks)
    return samples[samples["index"] >= run.first_index]


@both
@pytest.mark.parametrize("level_v", [40.0, -3.0])
def test_a_step_at_the_start_becomes_a_rise_of_50_ms(opened, level_v):
    samples = played(opened(), np.full(400, level_v))
    np.testing.assert_allclose(samples["command"][:400], softly(np.full(400, level_v)), atol=STEP_V)
    assert np.abs(np.diff(samples["command"], prepend=0.0)).max() <= abs(level_v) * np.pi / 2 / 100 + 2 * STEP_V
    softened = (samples["flags"] & Flag.SOFT_START) > 0
    assert softened[:95].all()
    assert not softened[99:].any()


@both
@pytest.mark.parametrize(
    "command",
    [
        np.linspace(0.0, 30.0, 100),
        15.0 * (1.0 - np.cos(np.pi * np.arange(100) / 100)),
        10.0 * np.sin(2 * np.pi * 5 * np.arange(200) / RATE),
        np.append(np.zeros(100), np.full(100, 20.0)),
        np.full(200, 1e-3),
    ],
    ids=["straight", "preload", "sine", "later step", "less than a step of the converter"],
)
def test_what_rises_by_itself_is_played_as_it_is(opened, command):
    samples = played(opened(), command)
    expected = command if opened is rig else softly(command)
    np.testing.assert_allclose(samples["command"][: command.size], expected, atol=STEP_V)
    assert opened is not rig or not np.any(samples["flags"] & Flag.SOFT_START)


@both
def test_every_run_begins_softly_not_only_the_first(opened):
    instrument = opened()
    for _ in range(2):
        assert np.abs(played(instrument, np.full(300, 20.0))["command"][0]) < 0.5


@both
def test_every_run_ends_softly(opened):
    samples = played(opened(), volts(20.0, 0.5))[round(0.5 * RATE) :]
    np.testing.assert_allclose(samples["command"][:100], 20.0 * np.arange(99, -1, -1) / 100, atol=STEP_V)
    assert not np.any(samples["flags"][100:] & Flag.ENERGISED)


def test_a_coil_that_is_let_go_falls_no_faster_than_by_its_weight_braked():
    instrument = rig(Bench("left-posterior-forearm", seed=1))
    instrument.load(volts(-10.0, 3.0))
    instrument.arm(WIDE.__class__(max_force_n=14.0, min_position_m=1e-6))
    instrument.start()
    link = instrument.link
    link.run_for(0.3)
    link.firmware.brown_out()
    trace = [link.firmware.bench.plant.state[2] for _ in range(40) if link.tick() is None]
    assert max(np.abs(trace)) < 0.25, "m/s: the shorted coil brakes the fall"


# -- the ends of the stroke -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "limits", [dict(max_force_n=2.1, min_position_m=-0.001), dict(max_force_n=2.0, min_position_m=-0.0011)]
)
def test_limits_beyond_the_near_end_are_for_gentle_forces(limits):
    value = limits["min_position_m"]
    with pytest.raises(LimitError, check=coded("limit.not_positive", name="min_position_m", value=value)):
        Limits(**limits)


@both
@pytest.mark.parametrize(("force_n", "position_m"), [(2.1, 0.0325), (2.0, 0.0331)])
def test_the_host_alone_refuses_limits_beyond_the_far_end(monkeypatch, opened, force_n, position_m):
    without_firmware(monkeypatch)
    instrument = opened()
    instrument.load(volts(4.0, 0.3))
    with pytest.raises(LimitError, check=coded("limit.beyond_stroke", position=1e3 * position_m, stroke=32.0)):
        instrument.arm(Limits(max_force_n=force_n, max_position_m=position_m))


@pytest.mark.parametrize(
    ("force_n", "near_m", "far_m"),
    [(2.1, 0.0003, 0.0325), (2.0, 0.0003, 0.0331), (2.1, 1e-4, 0.0321)],
)
def test_the_firmware_alone_refuses_limits_beyond_the_ends(monkeypatch, force_n, near_m, far_m):
    without_host(monkeypatch)
    instrument = rig()
    instrument.load(volts(4.0, 0.3))
    with pytest.raises(LimitError, check=coded("refused.beyond_limits", request="ARM")):
        instrument.arm(Limits(max_force_n=force_n, min_position_m=near_m, max_position_m=far_m))


def test_the_probe_leans_on_both_ends_when_it_is_gentle():
    instrument = rig()
    assert instrument.move_stage(None)
    up = played(instrument, volts(-6.0, 1.5), GENTLE)
    assert up["position"][2000:3000].max() < 0.0001
    down = played(instrument, volts(6.0, 1.5), GENTLE)
    assert down["position"][2000:3000].min() > 0.0319
    # Leaning on the near end harder and less hard: the converter ends there, and that is no dead sensor.
    sway = volts(-5.2, 2.0) + np.where(np.arange(4000) > 1500, 2.4 * np.sin(np.arange(4000) / 60.0), 0.0)
    samples = played(instrument, sway, GENTLE)
    assert samples["position"][2000:4000].max() < 0.0001


def test_the_end_of_the_stroke_is_a_fault_where_the_probe_may_push_harder():
    instrument = rig()
    instrument.move_stage(None)
    limits = Limits(max_force_n=2.1, max_position_m=0.0317)
    _, _, error = run_until_it_ends(instrument, volts(7.9, 1.5), limits)
    assert isinstance(error, LimitError | FirmwareFaultError)
    assert instrument.link.firmware.faults == Fault.STROKE


def turned_over_at_the_near_end():
    """A device that points upwards, its probe on the near stop, and nothing to lift it."""
    return rig(Bench("left-posterior-forearm", seed=1, tilt_deg=180.0))


def test_the_firmware_alone_gives_the_probe_half_a_second_to_come_off_the_near_end(monkeypatch):
    without_host(monkeypatch)
    instrument = turned_over_at_the_near_end()
    samples, _, error = run_until_it_ends(instrument, np.full(6000, 1.0), CLINICAL)  # 0.25 N: less than its weight
    assert isinstance(error, FirmwareFaultError)
    assert instrument.link.firmware.faults == Fault.STROKE
    assert samples["position"][:1001].max() < CLINICAL.min_position_m
    assert last_energised(samples) - samples["index"][0] == 0.5 * RATE, "the first sample at which the limit counts"


def test_the_firmware_alone_counts_the_near_limit_at_once_where_the_probe_has_been_inside(monkeypatch):
    without_host(monkeypatch)
    instrument = turned_over_at_the_near_end()
    command = np.concatenate([np.full(400, 8.0), np.full(3000, -2.0)])  # up, and back before half a second is over
    samples, _, _ = run_until_it_ends(instrument, command, CLINICAL)
    assert instrument.link.firmware.faults == Fault.STROKE
    inside = samples["position"] >= CLINICAL.min_position_m
    back = int(np.flatnonzero(inside)[-1]) + 1
    assert back < 0.5 * RATE
    assert last_energised(samples) - samples["index"][0] == back


# -- the stage --------------------------------------------------------------------------------------------------------


@both
def test_the_stage_moves_what_lies_under_the_probe(opened):
    instrument = opened()
    for position_m in (0.008, 0.016):
        assert instrument.move_stage(position_m)
        assert find_surface(instrument) == pytest.approx(position_m, abs=3e-4)


@both
def test_the_stage_stays_where_it_is_while_a_test_is_armed_or_runs(opened):
    instrument = opened()
    instrument.load(volts(4.0, 0.3))
    instrument.arm(CLINICAL)
    with pytest.raises(InstrumentError, check=coded("instrument.stage_in_test")):
        instrument.move_stage(0.01)
    instrument.start()
    with pytest.raises(InstrumentError, check=coded("instrument.stage_in_test")):
        instrument.move_stage(0.01)
    instrument.release()
    assert instrument.move_stage(0.01)


def test_the_firmware_alone_keeps_the_stage_still_while_a_test_is_armed():
    instrument = rig()
    instrument.load(volts(4.0, 0.3))
    instrument.arm(CLINICAL)
    before = instrument.link.firmware.bench.tissue
    instrument.state.limits = None
    with pytest.raises(InstrumentError, check=coded("refused.state", request="STAGE")):
        instrument.move_stage(0.01)
    assert instrument.link.firmware.bench.tissue is before


@both
@pytest.mark.parametrize("position_m", [-0.001, 0.0321, np.inf])
def test_the_stage_does_not_go_beyond_the_stroke(opened, position_m):
    instrument = opened()
    code = "instrument.stage_range" if isinstance(instrument, SimulatedInstrument) else "refused.argument"
    with pytest.raises(InstrumentError, check=coded(code)):
        instrument.move_stage(position_m)


@pytest.mark.parametrize("fault", [Fault.BUTTON, Fault.BROWN_OUT, Fault.WATCHDOG])
def test_the_stage_stays_where_it_is_while_a_fault_is_latched(fault):
    instrument = rig()
    firmware = instrument.link.firmware
    before = firmware.bench.tissue
    firmware.trip(fault)
    with pytest.raises(FirmwareFaultError):
        instrument.move_stage(0.01)
    request = wire.encode_frame(wire.Frame(MessageType.STAGE, 50_000, payload=wire.pack(wire.STAGE, position_m=0.01)))
    firmware.transmit(instrument.link.now)
    firmware.receive(request, instrument.link.now)
    (answer,) = wire.FrameDecoder().feed(firmware.transmit(instrument.link.now))
    result, _ = wire.unpack(wire.ACK, answer.payload)
    assert (result["result"], result["detail"]) == (Result.FAULT_LATCHED, fault)
    assert firmware.bench.tissue is before
    instrument.clear_faults()
    assert instrument.move_stage(0.01)
    assert firmware.bench.tissue.surface_m == 0.01


def test_a_device_without_a_stage_says_so():
    from support import LoopbackLink

    from tissueid.instrument import SerialInstrument

    link = LoopbackLink(Firmware(Bench(seed=1), Identity(stage=False)))
    assert SerialInstrument(link, clock=link.clock).move_stage(0.01) is False


def test_a_stage_that_takes_its_time_is_waited_for():
    instrument = rig()
    link = instrument.link
    held = itertools.count()

    def on_its_way(data):
        """The device goes on, and answers STAGE alone after half a minute but one repeat."""
        (frame,) = wire.FrameDecoder().feed(data)
        return b"" if frame.type == MessageType.STAGE and next(held) < 98 else data

    link.to_device, began = on_its_way, link.now
    assert instrument.move_stage(0.012)
    assert 29.0 < link.now - began < 30.0
