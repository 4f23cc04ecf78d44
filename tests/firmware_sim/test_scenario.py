"""What a scenario makes of a device: its model, its true figures, its tilt and its rate."""

import json
import os
from dataclasses import fields

import numpy as np
import pytest
from coded import coded
from firmware_sim_process import firmware_process
from plant_support import VOLTS_PER_NEWTON, standard_force
from support import connect_scenario

from firmware_sim import __main__ as command
from firmware_sim.__main__ import main
from firmware_sim.device_models import DESKTOP, HANDHELD
from firmware_sim.effects import EFFECTS
from firmware_sim.plant import SUBSTEPS, Plant, PlantParameters
from firmware_sim.presets import load_preset
from firmware_sim.scenario import Scenario, TrueParameters, load_scenario
from tissueid import device
from tissueid.errors import LimitError
from tissueid.instrument import CLINICAL, Limits, SerialInstrument, SerialLink

GRAVITY = 9.80665


def played(instrument, volts, limits=CLINICAL):
    """The run's samples, from the first that was played."""
    instrument.load(volts)
    instrument.arm(limits)
    run = instrument.start()
    blocks = []
    while not blocks or blocks[-1]["index"][-1] < run.end_index:
        blocks.append(instrument.poll(0.1))
    instrument.release()
    samples = np.concatenate([block for block in blocks if block.size])
    return samples[(samples["index"] >= run.first_index) & (samples["index"] < run.end_index)]


def streamed(instrument, samples):
    blocks = []
    while sum(map(len, blocks)) < samples:
        blocks.append(instrument.poll(0.1))
    return np.concatenate(blocks)


# -- true and nominal figures ----------------------------------------------------------------------------------


def test_the_default_scenario_is_the_device_as_it_always_was():
    scenario = Scenario()
    assert scenario.real == scenario.nominal == PlantParameters()
    assert scenario.identity().model == "desktop indenter (simulated)"
    assert scenario.identity().max_force_n == 15.0


def test_the_true_figures_are_not_announced(tmp_path):
    path = tmp_path / "scenario.toml"
    path.write_text(
        'preset = "linear-demo"\nsensor_supply_share = 0.99\n'
        "[truth]\nresistance_ohm = 12.31\nforce_constant_n_per_a = 2.93\nambient_degc = 19.0\n"
        "[channels.current]\ngain_error = 0.012\noffset = 0.010\n",
        encoding="utf-8",
    )
    with connect_scenario(load_scenario(path)) as instrument:
        said = instrument.device
        assert (said.coil_resistance_ohm, said.force_constant_n_per_a) == (12.0, 3.0)
        samples = played(instrument, np.full(3000, 12.0))[1500:]
        assert samples["current"].mean() == pytest.approx(1.012 * 12.0 / 12.31 + 0.010, abs=2e-3)
        position = 0.010 + (2.93 * 12.0 / 12.31 + 0.588399) / 4670.0
        assert samples["position"].mean() == pytest.approx(0.99 * position, abs=2e-6)
        assert samples["temperature"].mean() == pytest.approx(19.0, abs=0.5)


def test_every_figure_of_the_plant_can_be_overridden():
    assert set(TrueParameters.model_fields) == {item.name for item in fields(PlantParameters)}
    for name in TrueParameters.model_fields:
        value = 0.9 * getattr(PlantParameters(), name)
        assert getattr(TrueParameters(**{name: value}).over(PlantParameters()), name) == value


def test_a_weight_goes_with_the_mass_unless_it_is_given():
    heavier = TrueParameters(moving_mass_kg=0.062).over(PlantParameters())
    assert heavier.gravity_force_n == pytest.approx(0.062 * GRAVITY)
    assert TrueParameters(moving_mass_kg=0.062, gravity_force_n=0.5).over(PlantParameters()).gravity_force_n == 0.5


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[truth]\nresistance_ohm = 0.0", "truth.resistance_ohm cannot be used: it must be greater"),
        ("[truth]\nresistance_ohm = nan", "truth.resistance_ohm cannot be used"),
        ("[truth]\ncolour = 3", "truth.colour cannot be used: the name is unknown"),
        ("[truth]\nstroke_m = 0.040", "truth.stroke_m cannot be used"),
        ("[channels.current]\ngain_error = 2.0", "channels.current.gain_error cannot be used"),
        ("[channels.current]\noffset = inf", "channels.current.offset cannot be used"),
        ("[channels.current]\noffset = 3.0", "channels.current.offset must be within a tenth of the converter's range"),
        ("[channels.colour]\noffset = 3.0", "channels has no 'colour'; there are: command, voltage"),
        ("sensor_supply_share = 0.1", "sensor_supply_share cannot be used"),
        ('model = "pocket"', "model cannot be used: it must be 'desktop' or 'handheld'"),
        ("tilt_deg = 270.0", "tilt_deg cannot be used"),
        ("sample_rate_hz = 20000", "sample_rate_hz cannot be used"),
        ('stage = "high"', "stage cannot be used"),
        ("a = " + "[" * 10_000, "nested too deeply"),
        (".".join("a" * 10_000) + " = 1", "more than 16384 bytes"),
    ],
)
def test_a_scenario_that_cannot_be_is_one_line(tmp_path, text, words):
    path = tmp_path / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the complaint is compared below
        load_scenario(path)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--model", "pocket", "model cannot be used: it must be 'desktop' or 'handheld'"),
        ("--tilt", "nan", "tilt_deg cannot be used"),
        ("--rate", "20000", "sample_rate_hz cannot be used"),
    ],
)
def test_an_option_that_cannot_be_is_one_line_and_status_2(option, value, words, capsys):
    assert main([option, value]) == 2
    result = capsys.readouterr().err
    assert words in result
    assert result.count("\n") == 1


def test_the_plant_s_own_values_are_the_true_ones(capsys):
    assert main(["--model", "handheld", "--preset", "linear-demo", "--local-values", "0.012"]) == 0
    assert json.loads(capsys.readouterr().out)["mass_kg"] == pytest.approx(0.0395 + 0.0312)


# -- the handheld device and its tilt ---------------------------------------------------------------------------


def test_the_handheld_s_figures_follow_from_the_thesis():
    plant = HANDHELD.plant
    assert (plant.resistance_ohm, plant.moving_mass_kg, plant.stroke_m) == (9.5, 0.0395, 0.032)
    assert HANDHELD.frame_mass_kg + plant.moving_mass_kg == pytest.approx(0.256)
    # Force per ampere is field times wire: 5.66 m of the desktop's wire lie in 0.53 T.
    in_field_m = 3.0 / 0.53
    assert plant.force_constant_n_per_a == pytest.approx(0.35 * in_field_m * 9.5 / 12.0)
    assert plant.inductance_h == pytest.approx(1e-3 * (9.5 / 12.0) ** 2)
    assert plant.gravity_force_n == pytest.approx(0.0395 * GRAVITY)
    # What it warms by under a given power, and how soon, follows the copper.
    time_constant = plant.thermal_resistance_k_per_w * plant.heat_capacity_j_per_k
    assert time_constant == pytest.approx(8.0 * 18.0)
    at_the_limit = HANDHELD.max_force_n * 9.5 / plant.force_constant_n_per_a
    assert at_the_limit < plant.amplifier_limit_v
    assert HANDHELD.max_force_n < DESKTOP.max_force_n


def test_the_software_knows_the_handheld_by_the_same_figures():
    with connect_scenario(Scenario(model="handheld")) as instrument:
        for name in (
            "coil_resistance_ohm",
            "coil_inductance_h",
            "force_constant_n_per_a",
            "moving_mass_kg",
            "bearing_damping_n_s_per_m",
            "amplifier_limit_v",
            "stroke_m",
        ):
            assert getattr(instrument.device, name) == pytest.approx(getattr(device.HANDHELD, name)), name


def test_the_handheld_announces_itself_and_holds_its_own_limit():
    with connect_scenario(Scenario(model="handheld", preset="linear-demo")) as instrument:
        said = instrument.device
        assert said.model == "handheld indenter (simulated)"
        assert (said.coil_resistance_ohm, said.moving_mass_kg) == (9.5, 0.0395)
        samples = played(instrument, np.full(2000, 20.0), Limits(max_force_n=15.0))[1000:]
        assert samples["current"].mean() == pytest.approx(20.0 / 9.5, rel=2e-3)
        with pytest.raises(
            LimitError, check=coded("limit.stimulus_force", force=pytest.approx(7.9, abs=0.05), limit=7.8)
        ):
            played(instrument, np.full(2000, 47.9), Limits(max_force_n=15.0))
        assert instrument.move_stage(0.012) is False  # a handheld has no stage


def test_a_stage_is_the_scenario_s_to_give():
    assert Scenario(model="handheld", stage=True).identity().stage
    assert not Scenario(stage=False).identity().stage
    assert Scenario().identity().stage


@pytest.mark.parametrize("tilt", [0.0, 35.0, 90.0, 150.0, -60.0])
def test_the_accelerometer_tells_gravity_along_the_stroke(tilt):
    with connect_scenario(Scenario(model="handheld", preset="linear-demo", tilt_deg=tilt)) as instrument:
        samples = streamed(instrument, 2000)
        along = GRAVITY * np.cos(np.radians(tilt))
        assert samples["acceleration_x"].mean() == pytest.approx(along, abs=0.01)
        assert samples["acceleration_y"].mean() == pytest.approx(GRAVITY * np.sin(np.radians(tilt)), abs=0.01)
        assert samples["position"].mean() == pytest.approx(0.010 + 0.0395 * along / 4670.0, abs=5e-7)


def test_the_handheld_s_light_body_feels_the_coil():
    shares = {}
    for model in ("desktop", "handheld"):
        bench = Scenario(model=model, preset="linear-demo").bench()
        volts = 10.0 * np.sign(np.sin(2 * np.pi * 30.0 * np.arange(2000) / 2000.0))
        trace = bench.plant.advance(volts)["acceleration"]
        bench.reset()
        k = [channel.name for channel in bench.channels].index("accelerometer_x")
        read = bench.channels[k].decode(bench.block(volts, energised=True).codes[:, k])
        shares[model] = np.polyfit(trace, read, 1)[0]
    assert shares["desktop"] == pytest.approx(-0.060 / 5.0, abs=2e-3)
    assert shares["handheld"] == pytest.approx(-0.0395 / 0.2165, abs=2e-3)


# -- ten thousand samples a second ------------------------------------------------------------------------------


@pytest.mark.parametrize("preset", ["left-posterior-forearm", "hammerstein-demo", "buna"])
def test_the_step_is_fine_enough_at_any_rate(preset):
    """The same volts, held for the same times: 10 kHz with its own steps against 2 kHz with steps far finer."""
    volts = standard_force("uniform")[:3000] * VOLTS_PER_NEWTON
    tissue = load_preset(preset)
    reference = Plant(PlantParameters(), tissue, substeps=10 * SUBSTEPS).advance(volts)
    for rate in (10_000.0, 4000.0):
        bench = Scenario(preset=preset, sample_rate_hz=rate).bench()
        times = round(rate / 2000.0)
        trace = bench.plant.advance(np.repeat(volts, times))[times - 1 :: times]
        for name in ("position", "velocity", "current", "filtered_current", "filtered_position"):
            error = trace[name] - reference[name]
            assert error.std() < 1e-4 * reference[name].std(), (rate, name)


def test_each_conversion_has_its_own_noise_at_any_rate():
    for rate in (1000.0, 10_000.0):
        bench = Scenario(preset="linear-demo", sample_rate_hz=rate).bench()
        codes = bench.block(np.zeros(20_000), energised=False).codes
        for k, channel in enumerate(bench.channels):
            if channel.noise_rms:
                values = channel.decode(codes[:, k])
                assert values.std() == pytest.approx(np.hypot(channel.noise_rms, channel.gain / 12**0.5), rel=0.03)
                assert abs(np.corrcoef(values[1:], values[:-1])[0, 1]) < 4.5 / 20_000**0.5


def test_the_filter_is_the_same_at_any_rate():
    """2 kHz, first order: at 10 kHz its step response shows from sample to sample."""
    bench = Scenario(preset="linear-demo", sample_rate_hz=10_000).bench()
    trace = bench.plant.advance(np.full(5, 10.0))
    assert trace["filtered_voltage"] == pytest.approx(10.0 * (1 - np.exp(-0.4 * np.pi * np.arange(1, 6))), rel=2e-3)


@pytest.mark.parametrize("rate", [1000.0, 10_000.0])
def test_a_run_at_another_rate_loses_nothing_and_takes_the_same_time(rate):
    time = np.arange(round(rate)) / rate
    volts = 12.0 + 4.0 * np.sin(2 * np.pi * 20 * time)
    with connect_scenario(Scenario(preset="linear-demo", sample_rate_hz=rate)) as instrument:
        assert instrument.device.sample_rate_hz == rate
        began = instrument.link.now
        samples = played(instrument, volts)
        assert instrument.link.now - began < 1.3
        assert samples.size == volts.size
        assert not np.isnan(samples["position"]).any()
        assert instrument.gaps == []
        settled = time > 0.2
        phasor = 2 * np.mean((3.0 * samples["current"] * np.exp(-2j * np.pi * 20 * time))[settled])
        turn = 2j * np.pi * 20
        mechanics = 0.0912 * turn**2 + 22.77 * turn + 4670.0
        coil = 3.0 / (12.0 + 1e-3 * turn + 9.0 * turn / mechanics)  # volts to newtons, back-EMF included
        assert abs(phasor) == pytest.approx(abs(4.0 * coil), rel=0.01)


def test_ten_thousand_samples_a_second_through_a_real_cable():
    with (
        firmware_process("--tcp=0", "--rate", "10000", "--preset", "linear-demo") as (url, _),
        SerialInstrument(SerialLink(url)) as instrument,
    ):
        samples = played(instrument, np.full(10_000, 12.0))
        assert samples.size == 10_000
        assert not np.isnan(samples["position"]).any()
        assert instrument.gaps == []


def test_an_effect_is_hidden_at_its_typical_level_or_at_the_one_named(monkeypatch):
    served = []
    monkeypatch.setattr(command, "_serve", lambda scenario, port: served.append(scenario.acting) or 0)
    assert main(["--hide", "dry_friction", "--hide", "cogging=0.1"]) == 0
    assert main([]) == 0
    hidden = {effect.name: effect.level for effect in served[0]}
    assert hidden == {"dry_friction": EFFECTS["dry_friction"].typical, "cogging": 0.1}
    assert served[1] == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("rust", "there is no effect 'rust'; there are: latency"),
        ("cogging=much", "the level of cogging must be a number"),
    ],
)
def test_what_cannot_be_hidden_is_refused(text, words, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["--hide", text])
    assert words in capsys.readouterr().err


def test_a_level_out_of_range_is_refused(capsys):
    assert main(["--hide", "dry_friction=1e9"]) == 2
    assert "effects" in capsys.readouterr().err


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes with names")
def test_a_scenario_that_is_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "scenario.toml")
    with pytest.raises(ValueError, match="not an ordinary file"):
        load_scenario(tmp_path / "scenario.toml")
