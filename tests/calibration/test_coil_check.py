"""The electrical check of the coil, on the simulated firmware and on instruments with something wrong."""

from dataclasses import replace

import pytest
from coded import coded
from support import LoopbackLink, connect

from firmware_sim.bench import Bench
from firmware_sim.firmware import Firmware
from firmware_sim.plant import PlantParameters
from tissueid.calibration import check_coil
from tissueid.errors import UnusableInputError
from tissueid.instrument import SerialInstrument


def on_a_bench(**figures):
    bench = Bench(parameters=replace(PlantParameters(), **figures))
    link = LoopbackLink(Firmware(bench))
    return SerialInstrument(link, clock=link.clock)


def test_it_finds_the_resistance_within_its_own_uncertainty():
    check = check_coil(connect())
    assert check.passed
    assert check.coil_resistance_ohm.std < 0.03
    assert abs(check.coil_resistance_ohm.value - 12.0) < 4 * check.coil_resistance_ohm.std
    assert check.position_noise_m == pytest.approx(1.0e-6, rel=0.2)
    assert check.as_calibration()["verdict"] == "passed"


def test_a_coil_that_is_not_the_nominal_one_fails():
    instrument = on_a_bench(resistance_ohm=14.0)
    instrument.device = replace(instrument.device, coil_resistance_ohm=12.0)
    check = check_coil(instrument)
    assert check.coil_resistance_ohm.value == pytest.approx(14.0, rel=0.01)
    assert not check.passed


def test_an_open_coil_is_said():
    instrument = on_a_bench(resistance_ohm=200.0, inductance_h=10e-3)
    instrument.device = replace(instrument.device, coil_resistance_ohm=12.0)
    with pytest.raises(UnusableInputError, check=coded("calibration.no_current")):
        check_coil(instrument)


def test_lost_samples_are_said():
    instrument = connect()
    link = instrument.link
    link.to_host = lambda data: b"" if link.now > 0.5 and link.now < 0.85 else data
    with pytest.raises(UnusableInputError, check=coded("calibration.samples_lost.voltage")):
        check_coil(instrument)
