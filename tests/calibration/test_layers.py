"""Merge of several calibrations: the source of each figure, warnings, and the conditions of a sweep."""

from dataclasses import replace

import numpy as np
import pytest
from coded import coded, codes, message, says
from known_calibrations import DEVICE, NOW, made
from static_rig import rig
from support import LoopbackLink

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from tissueid import wire
from tissueid.calibration import StaticPlan, apply_calibrations, calibrate_static, write_calibration
from tissueid.calibration.active import (
    NO_REGION,
    activate_calibration,
    corrections,
    use_static_calibration,
)
from tissueid.calibration.file import CalibratedQuantity, utc_date
from tissueid.calibration.status import first_implausible, label_of, problems_of
from tissueid.errors import InstrumentError
from tissueid.instrument import Correction, SerialInstrument, SimulatedInstrument
from tissueid.instrument.handshake import parse_hello
from tissueid.messages import Quantity as Shown

pytestmark = pytest.mark.usefixtures("long_frames")

CHANNELS = {
    "voltage_offset_v": 0.02,
    "voltage_gain": 0.99,
    "position_gain": 1.01,
    "position_offset_m": 150e-6,
    "temperature_offset_c": 1.5,
    "acceleration_gain": 1.03,
    "acceleration_offset_m_s2": 0.2,
    "calibration_relative_uncertainty": 0.013,
}


def partial(days_ago, **figures):
    """A static calibration of a few steps."""
    item = made(days_ago)
    found = {name: CalibratedQuantity(value=value) for name, value in figures.items()}
    return replace(item, calibration=item.calibration.model_copy(update={"quantities": found}))


def full(days_ago=20.0, **changes):
    return made(days_ago, figures=CHANNELS, **changes)


def test_every_figure_is_laid_over_and_every_channel_corrected():
    device = apply_calibrations(DEVICE, [full(), made(5, "sweep")], NOW)
    assert device.amplifier_gain == 0.99
    assert device.calibration_relative_uncertainty == 0.013
    assert corrections(device) == {
        "current": Correction(1.0, 0.01),
        "voltage": Correction(1.0, 0.02),
        "position": Correction(1.01, 150e-6),
        "temperature": Correction(1.0, 1.5),
        "acceleration_x": Correction(1.03, 0.2),
    }


@pytest.mark.parametrize(
    ("figures", "names"),
    [
        ({"temperature_offset_c": 0.5}, ("Coil resistance", "Force constant", "Zero of the current channel")),
        ({"force_constant_n_per_a": 2.8, "current_offset_a": 0.02}, ("Coil resistance",)),
        ({}, ()),
    ],
)
def test_a_calibration_of_a_few_steps_does_not_undo_a_complete_one(figures, names):
    device = apply_calibrations(DEVICE, [full(20), partial(3, **figures)], NOW)
    known = device.calibration
    assert device.coil_resistance_ohm == 12.3
    assert device.force_constant_n_per_a == figures.get("force_constant_n_per_a", 2.9)
    assert known["position_gain"] == 1.01
    for name, value in figures.items():
        assert known[name] == value
    assert (known["static_file"], known["state"]) == ("static-20.toml", "valid")
    if figures:
        warning = message(device.calibration_warnings, "calibration.completed")
        assert says(warning, "calibration.completed", file="static-3.toml", other="static-20.toml")
        assert warning.values["names"].items[: len(names)] == names
    else:
        assert device.calibration_warnings == (NO_REGION,)


def test_the_deviation_of_a_figure_is_of_the_same_calibration():
    device = apply_calibrations(DEVICE, [full(20), partial(3, coil_resistance_ohm=12.1)], NOW)
    assert device.calibration["coil_resistance_ohm"] == 12.1
    assert "coil_resistance_ohm_std" not in device.calibration


def test_a_missing_figure_gives_a_warning():
    device = apply_calibrations(DEVICE, [partial(3, coil_resistance_ohm=12.1)], NOW)
    assert device.force_constant_n_per_a == DEVICE.force_constant_n_per_a
    warning = message(device.calibration_warnings, "calibration.nominal_used")
    assert warning.values["names"].items == (label_of("force_constant_n_per_a"), label_of("current_offset_a"))


def test_needed_figures_of_a_stale_one_make_it_stale_and_others_do_not():
    device = apply_calibrations(DEVICE, [full(200), partial(3, temperature_offset_c=0.5)], NOW)
    assert device.calibration["state"] == "stale"
    device = apply_calibrations(DEVICE, [full(200), made(3)], NOW)
    assert device.calibration["state"] == "valid"
    assert device.calibration["static_file"] == "static-3.toml"
    assert device.calibration["temperature_offset_c"] == 1.5
    warning = message(device.calibration_warnings, "calibration.completed_by_stale")
    assert says(warning, "calibration.completed_by_stale", other="static-200.toml")
    assert warning.values["reason"].values["days"] == pytest.approx(200.0)


def test_different_calibrations_of_one_date_give_a_warning():
    one, other = made(3), made(3, figures={"coil_resistance_ohm": 12.6})
    one, other = replace(one, path=one.path.with_name("a.toml")), replace(other, path=other.path.with_name("b.toml"))
    for stored in ([one, other], [other, one]):
        device = apply_calibrations(DEVICE, stored, NOW)
        assert device.coil_resistance_ohm == 12.6
        assert says(device.calibration_warnings[0], "calibration.same_time", used="b.toml", other="a.toml")
    copy = replace(one, path=one.path.with_name("b.toml"))
    assert apply_calibrations(DEVICE, [one, copy], NOW).calibration_warnings == (NO_REGION,)


def swept(static=None, **conditions):
    """A sweep made 5 days ago, under a static calibration or under none."""
    if static is not None:
        conditions |= {"static_file": static.path.name, "static_date": static.calibration.date}
    return made(5, "sweep", conditions=conditions)


def test_a_sweep_under_another_position_scale_gives_a_warning():
    old, new = full(), made(2, figures=CHANNELS | {"position_offset_m": 500e-6})
    scale = {"position_gain": 1.01, "position_offset_m": 150e-6}
    assert apply_calibrations(DEVICE, [old, swept(old, **scale)], NOW).calibration_warnings == ()
    assert apply_calibrations(DEVICE, [old, swept(old)], NOW).calibration_warnings == ()
    device = apply_calibrations(DEVICE, [old, new, swept(old, **scale)], NOW)
    shifted = message(device.calibration_warnings, "calibration.region_shifted")
    assert shifted.values["static"] == "static-20.toml"
    assert shifted.values["shift"].value == pytest.approx(0.35, abs=0.005)
    nearly = made(2, figures=CHANNELS | {"position_offset_m": 200e-6})
    assert apply_calibrations(DEVICE, [old, nearly, swept(old, **scale)], NOW).calibration_warnings == ()
    device = apply_calibrations(DEVICE, [old, new, swept(old)], NOW)
    assert "calibration.region_unsure" in codes(device.calibration_warnings)
    device = apply_calibrations(DEVICE, [new, swept()], NOW)
    assert (
        message(device.calibration_warnings, "calibration.region_shifted").values["static"] == "no static calibration"
    )


def test_a_sweep_carries_the_static_calibration_that_corrected_it(tmp_path):
    instrument = SimulatedInstrument("spring")
    item = full(3, serial_number=instrument.nominal.serial_number, model=instrument.nominal.model)
    write_calibration(tmp_path / "s.toml", item.calibration)
    conditions = use_static_calibration(instrument, tmp_path, NOW)
    assert conditions == {
        "static_file": "s.toml",
        "static_date": item.calibration.date,
        "position_gain": 1.01,
        "position_offset_m": 150e-6,
    }
    device = instrument.device
    assert device.coil_resistance_ohm == 12.3
    assert device.force_constant_n_per_a == instrument.nominal.force_constant_n_per_a
    assert corrections(device)["position"] == Correction(1.01, 150e-6)
    assert corrections(device)["acceleration_x"] == Correction(1.03, 0.2)
    assert device.calibration["static_file"] == "s.toml"
    assert not any("force_constant" in name for name in device.calibration)
    assert device.calibration_warnings == ()


def test_without_a_static_calibration_a_sweep_carries_none(tmp_path):
    instrument = SimulatedInstrument("spring")
    assert use_static_calibration(instrument, tmp_path, NOW) == {}
    assert instrument.device == instrument.nominal


# -- what cannot be true --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "within", "beyond"),
    [
        ("coil_resistance_ohm", 14.3, 14.5),
        ("coil_resistance_ohm", 9.7, 9.5),
        ("force_constant_n_per_a", 3.59, 3.61),
        ("moving_mass_kg", 0.0715, 0.0725),
        ("coil_inductance_h", 1.49e-3, 1.51e-3),
        ("bearing_damping_n_s_per_m", 1.76, 1.74),
        ("current_offset_a", -0.29, -0.31),
        ("voltage_offset_v", 0.99, 1.01),
        ("voltage_gain", 1.19, 1.21),
        ("position_gain", 0.81, 0.79),
        ("position_offset_m", 2.9e-3, 3.1e-3),
        ("temperature_offset_c", 9.9, 10.1),
        ("acceleration_gain", 1.19, 1.21),
        ("acceleration_offset_m_s2", -1.9, -2.1),
        ("calibration_relative_uncertainty", 0.49, 0.51),
        ("linear_region_min_m", -1.9e-3, -2.1e-3),
        ("linear_region_min_m", 0.030, 5.0),
        ("stroke_max_m", 0.0339, 0.0341),
    ],
)
def test_each_bound_is_sharp(name, within, beyond):
    assert first_implausible(partial(3, **{name: within}).calibration, DEVICE) == ""
    assert first_implausible(partial(3, **{name: beyond}).calibration, DEVICE)


def test_ends_must_be_in_order():
    found = partial(3, linear_region_min_m=0.020, linear_region_max_m=0.010).calibration
    assert says(
        first_implausible(found, DEVICE),
        "calibration.implausible.range",
        low=Shown(20.0, "mm", 1),
        high=Shown(10.0, "mm", 1),
    )


@pytest.mark.parametrize("nominal", [0.0, float("nan")])
def test_nothing_is_near_a_nominal_figure_that_is_none(nominal):
    device = replace(DEVICE, bearing_damping_n_s_per_m=nominal, moving_mass_kg=nominal)
    for name, value in (("moving_mass_kg", 0.06), ("bearing_damping_n_s_per_m", 3.5)):
        assert first_implausible(partial(3, **{name: value}).calibration, device).values["name"] == name


def hello():
    """What a simulated device says of itself."""
    link, frames = LoopbackLink(Firmware(Bench())), []
    decoder = wire.FrameDecoder()

    def listen(data):
        frames.extend(decoder.feed(data))
        return data

    link.to_host = listen
    SerialInstrument(link, clock=link.clock).close()
    return next(frame.payload for frame in frames if frame.type == wire.MessageType.HELLO_ACK)


@pytest.fixture(scope="module")
def payload():
    return hello()


@pytest.mark.parametrize("name", ["moving_mass_kg", "coil_inductance_h", "force_constant_n_per_a", "amplifier_limit_v"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1.0, 1e300, -1e-300])
def test_a_device_that_says_the_impossible_of_itself_is_refused(payload, name, value):
    assert parse_hello(payload, "port").device.moving_mass_kg == DEVICE.moving_mass_kg
    at = wire.HELLO_ACK.fields[name][1]
    with pytest.raises(InstrumentError, check=coded("handshake.impossible", port="port")):
        parse_hello(payload[:at] + np.float64(value).tobytes() + payload[at + 8 :], "port")


def test_a_stage_that_is_off_fails_the_verdict_and_not_only_the_use(tmp_path, monkeypatch):
    instrument = rig(errors={})
    move = instrument.move_stage
    monkeypatch.setattr(instrument, "move_stage", lambda place: move(None if place is None else place - 2.5e-3))
    found = calibrate_static(instrument, StaticPlan(steps=("position", "range"))).calibration
    assert found.verdict == "failed"
    assert codes(problems_of(found)) == ["calibration.implausible"]


def test_the_force_step_alone_keeps_the_zero_it_was_found_with(tmp_path):
    instrument = rig()
    found = calibrate_static(instrument, StaticPlan(steps=("force",)), now=NOW).calibration
    assert found.quantities["current_offset_a"].value == pytest.approx(0.010, abs=1e-3)
    assert "coil_resistance_ohm" not in found.quantities
    write_calibration(tmp_path / "a.toml", found)
    assert utc_date(NOW) == found.date
    in_force = activate_calibration(instrument, tmp_path, now=NOW)
    assert corrections(in_force.device)["current"].offset == found.quantities["current_offset_a"].value
