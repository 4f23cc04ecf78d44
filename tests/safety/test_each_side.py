"""Every limit on either side, with the other side's safety switched off; and how many samples pass till the release."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from coded import coded, holding, says
from safety.rigs import (
    WIDE,
    last_energised,
    rig,
    run_until_it_ends,
    shaken,
    true_winding_c,
    volts,
    without_firmware,
    without_host,
)

from firmware_sim.bench import Bench
from firmware_sim.plant import PlantParameters
from firmware_sim.thermal import WindingModel
from tissueid.errors import FirmwareFaultError, InstrumentError, LimitError, LinkLostError
from tissueid.instrument import Limits
from tissueid.instrument.replies import describe_faults
from tissueid.instrument.thermal import WindingTemperature
from tissueid.wire import Fault, State

SHORTED = PlantParameters(resistance_ohm=8.0)
"""A coil with shorted turns draws more than its firmware believes: only the measured current tells."""


@dataclass(frozen=True)
class Case:
    """A hazard: the fault of the firmware, the error of the host, and the samples each may take to free the coil."""

    fault: Fault
    host_error: type[Exception]
    host_check: Callable[[BaseException], bool]
    command: np.ndarray
    limits: Limits = WIDE
    bench: Callable[[], Bench] = lambda: Bench(seed=1)
    upset: Callable[[Bench], object] | None = None
    broken: Callable[[np.ndarray], np.ndarray] | None = None
    firmware_samples: int = 0
    host_samples: int = 60


CASES = {
    "force": Case(
        Fault.OVER_FORCE,
        LimitError,
        coded("limit.force", force=pytest.approx(5.5, abs=0.5), limit=5.0),
        volts(19.5, 1.0),
        replace(WIDE, max_force_n=5.0),
        lambda: Bench(seed=1, parameters=SHORTED, nominal=PlantParameters()),
        broken=lambda samples: np.abs(samples["current"]) * 3.0 > 5.25,
    ),
    "far end": Case(
        Fault.STROKE,
        LimitError,
        coded("limit.position", position=pytest.approx(12.5, abs=0.5)),
        volts(30.0, 2.0),
        replace(WIDE, max_position_m=0.0125),
        broken=lambda samples: samples["position"] > 0.0125,
    ),
    "near end": Case(
        Fault.STROKE,
        LimitError,
        coded("limit.position", position=pytest.approx(4.5, abs=0.5)),
        volts(-8.0, 2.0),
        replace(WIDE, min_position_m=0.005),
        broken=lambda samples: samples["position"] < 0.005,
    ),
    "sensor": Case(
        Fault.SENSOR,
        InstrumentError,
        coded("sensor.position_stuck"),
        shaken(3.0),
        upset=lambda bench: bench.stuck.add("position"),
        firmware_samples=240,
        host_samples=300,
    ),
    "open coil": Case(
        Fault.OPEN_COIL,
        InstrumentError,
        coded("sensor.no_current"),
        volts(12.0, 3.0),
        upset=lambda bench: setattr(bench, "coil_open", True),
        firmware_samples=60,
        host_samples=120,
    ),
    "stuck current": Case(
        Fault.OPEN_COIL,
        InstrumentError,
        coded("sensor.no_current"),
        shaken(3.0),
        upset=lambda bench: bench.stuck.add("current"),
        firmware_samples=160,
        host_samples=220,
    ),
    "current stuck at rest": Case(
        Fault.OPEN_COIL,
        InstrumentError,
        coded("sensor.no_current"),
        volts(12.0, 3.0),
        bench=lambda: _stuck(Bench(seed=1), "current"),
        broken=lambda samples: samples["voltage"] > 0.3,
        firmware_samples=120,
        host_samples=180,
    ),
}


def _stuck(bench: Bench, name: str) -> Bench:
    bench.stuck.add(name)
    return bench


each_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def begun(case: Case, samples: np.ndarray, onset: int | None) -> int:
    """The sample from which on something was wrong."""
    if case.broken is None:
        assert onset is not None
        return onset
    return int(samples["index"][int(np.argmax(case.broken(samples)))])


@each_case
def test_the_firmware_alone_frees_the_coil(monkeypatch, case):
    without_host(monkeypatch)
    instrument = rig(case.bench())
    samples, onset, error = run_until_it_ends(instrument, case.command, case.limits, case.upset)
    firmware = instrument.link.firmware
    assert isinstance(error, FirmwareFaultError)
    assert firmware.faults == case.fault
    assert not firmware.energised
    with pytest.raises(FirmwareFaultError, check=coded("instrument.released", why=describe_faults(case.fault))):
        instrument.poll(0.0)
    assert last_energised(samples) - begun(case, samples, onset) <= case.firmware_samples


@each_case
def test_the_host_alone_frees_the_coil(monkeypatch, case):
    without_firmware(monkeypatch)
    instrument = rig(case.bench(), watchdog_s=1e9)
    samples, onset, error = run_until_it_ends(instrument, case.command, case.limits, case.upset)
    firmware = instrument.link.firmware
    assert isinstance(error, case.host_error)
    assert firmware.faults == Fault.NONE
    assert not firmware.energised
    with pytest.raises(case.host_error, check=case.host_check):
        instrument.poll(0.0)
    assert last_energised(samples) - begun(case, samples, onset) <= case.host_samples


@each_case
def test_after_a_fault_the_program_goes_on_without_touching_the_device(case):
    instrument = rig(case.bench())
    run_until_it_ends(instrument, case.command, case.limits, case.upset)
    link = instrument.link
    instrument.close()
    link.closed = False
    bench = link.firmware.bench
    bench.stuck.clear()
    bench.coil_open = False
    again = type(instrument)(link, clock=link.clock)
    again.load(volts(4.0, 0.4))
    again.arm(WIDE)
    run = again.start()
    while again.poll(0.05)["index"][-1] < run.end_index:
        pass
    link.run_for(0.1)
    assert link.firmware.state is State.LOADED


# -- temperature: by its sensor, and by calculation -------------------------------------------------------------------


HOT = volts(44.0, 8.0)
WARM = replace(WIDE, max_temperature_c=60.0)


def test_the_firmware_alone_goes_by_the_temperature_sensor(monkeypatch):
    without_host(monkeypatch)
    monkeypatch.setattr(WindingModel, "advance", lambda *_: None)
    instrument = rig()
    samples, _, error = run_until_it_ends(instrument, HOT, WARM)
    assert instrument.link.firmware.faults == Fault.OVER_TEMPERATURE
    assert says(error.message, "instrument.released", why=describe_faults(Fault.OVER_TEMPERATURE))
    hot = int(samples["index"][int(np.argmax(samples["temperature"] > 60.0))])
    assert last_energised(samples) == hot


def test_the_host_alone_goes_by_the_temperature_sensor(monkeypatch):
    without_firmware(monkeypatch)
    monkeypatch.setattr(WindingTemperature, "take", lambda *_: None)
    instrument = rig(watchdog_s=1e9)
    samples, _, error = run_until_it_ends(instrument, HOT, WARM)
    assert isinstance(error, LimitError)
    assert says(error.message, "limit.temperature", temperature=pytest.approx(60.0, abs=0.1), limit=60.0)
    hot = int(samples["index"][int(np.argmax(samples["temperature"] > 60.0))])
    assert last_energised(samples) - hot <= 60


def full_voltage(bench):
    """The hottest that there is: 48 V for 10 s, the probe on a spring stiff enough for it, the sensor dead."""
    bench.stuck.add("temperature")
    return np.minimum(np.arange(20_000) / 500, 1.0) * 48.0


def test_the_firmware_alone_stops_before_the_winding_is_too_hot_though_its_sensor_is_dead(monkeypatch):
    without_host(monkeypatch)
    instrument = rig()
    command = full_voltage(instrument.link.firmware.bench)
    samples, _, error = run_until_it_ends(instrument, command, replace(WIDE, max_temperature_c=80.0))
    assert instrument.link.firmware.faults == Fault.OVER_TEMPERATURE
    assert error.faults == Fault.OVER_TEMPERATURE
    assert np.ptp(samples["temperature"]) == 0.0, "the sensor saw nothing"
    assert 45.0 < true_winding_c(instrument) < 78.0


def test_the_host_alone_stops_before_the_winding_is_too_hot_though_its_sensor_is_dead(monkeypatch):
    without_firmware(monkeypatch)
    instrument = rig(watchdog_s=1e9)
    command = full_voltage(instrument.link.firmware.bench)
    _, _, error = run_until_it_ends(instrument, command, replace(WIDE, max_temperature_c=80.0))
    assert isinstance(error, LimitError)
    temperature = pytest.approx(80.1, abs=0.1)  # the first block of samples beyond the limit; one heats by 0.15 °C
    assert says(error.message, "limit.winding_temperature", temperature=temperature, limit=80.0)
    assert 45.0 < true_winding_c(instrument) < 78.0


# -- time, and silence ------------------------------------------------------------------------------------------------


def test_the_firmware_alone_ends_a_test_that_is_too_long(monkeypatch):
    without_host(monkeypatch)
    instrument = rig()
    instrument.load(volts(8.0, 1.0))
    instrument.arm(WIDE)
    firmware = instrument.link.firmware
    firmware.armed = replace(firmware.armed, max_samples=1000)
    run = instrument.start()
    samples = []
    with pytest.raises(FirmwareFaultError, check=holding("fault.over_time")):
        while True:
            samples.append(instrument.poll(0.05))
    assert firmware.faults == Fault.OVER_TIME
    # The ramp of a release, 100 samples, is granted to a run that ends in time.
    assert last_energised(np.concatenate(samples)) - run.first_index == 1000 + 100


def test_the_firmware_alone_refuses_what_is_too_long_or_too_strong(monkeypatch):
    without_host(monkeypatch)
    instrument = rig()
    instrument.load(volts(20.0, 1.0))
    for limits in (replace(WIDE, max_seconds=0.9), replace(WIDE, max_force_n=4.7)):
        with pytest.raises(LimitError, check=coded("refused.beyond_limits")):
            instrument.arm(limits)
    assert instrument.link.firmware.state is State.LOADED


def test_the_host_alone_ends_a_test_that_is_too_long(monkeypatch):
    without_firmware(monkeypatch)
    instrument = rig(watchdog_s=1e9)
    instrument.load(volts(8.0, 3.0))
    instrument.arm(WIDE)
    instrument.state.limits = replace(WIDE, max_seconds=0.5)
    instrument.start()
    with pytest.raises(LimitError, check=coded("limit.time", seconds=pytest.approx(1.5, abs=0.02), limit=0.5)):
        while True:
            instrument.poll(0.05)
    assert not instrument.link.firmware.energised


def test_the_host_alone_refuses_what_is_too_long_or_too_strong(monkeypatch):
    without_firmware(monkeypatch)
    instrument = rig()
    instrument.load(volts(20.0, 1.0))
    with pytest.raises(LimitError, check=coded("limit.stimulus_time", seconds=1.0, limit=0.9)):
        instrument.arm(replace(WIDE, max_seconds=0.9))
    with pytest.raises(LimitError, check=coded("limit.stimulus_force", force=5.0, limit=4.7)):
        instrument.arm(replace(WIDE, max_force_n=4.7))
    assert instrument.link.firmware.state is State.LOADED


def test_the_firmware_alone_frees_the_coil_when_the_host_is_gone():
    instrument = rig()
    instrument.load(volts(8.0, 5.0))
    instrument.arm(WIDE)
    instrument.start()
    link = instrument.link
    before = link.now
    while link.firmware.energised:
        link.tick()
    assert link.firmware.faults == Fault.WATCHDOG
    assert link.now - before <= 0.5 + 0.02


def test_the_host_alone_notices_a_firmware_that_hangs():
    instrument = rig(watchdog_s=1e9)
    instrument.load(volts(8.0, 5.0))
    instrument.arm(WIDE)
    instrument.start()
    link = instrument.link
    instrument.poll(0.3)
    link.firmware.stall(1e9)
    before = link.now
    with pytest.raises(LinkLostError, check=holding("link.silent", seconds=1.0)):
        while True:
            instrument.poll(0.05)
    assert link.now - before <= 1.1
