"""The recorded force follows the force constant that the sweep found at each position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_calibrations import DEVICE, NOW, made

from tissueid.acquisition.recovery import OpenTest
from tissueid.calibration.active import apply_calibrations
from tissueid.device import DeviceDescription
from tissueid.instrument import SAMPLE, Run, force
from tissueid.instrument.force_profile import PROFILE, USED_NOTE, recorded_force, relative_force_constant
from tissueid.sessions import Test
from tissueid.wire.messages import Flag

PLACES = np.linspace(0.002, 0.030, 57)
PLATEAU = 3.05


def true_constant(position_m: np.ndarray) -> np.ndarray:
    """Force constant of a finite coil, N/A: falls by 20 % towards the ends."""
    return PLATEAU * (1.0 - 0.2 * ((position_m - 0.016) / 0.014) ** 4)


def sweep(values: np.ndarray, **changes: float):
    figures = {"force_constant_n_per_a": PLATEAU} | changes
    table = {"position_m": tuple(PLACES), "value_n_per_a": tuple(values)}
    return made(kind="sweep", figures=figures, tables={"force_constant": table})


def calibrated(values: np.ndarray) -> DeviceDescription:
    statics = made(days_ago=5.0, figures={"force_constant_n_per_a": PLATEAU})
    return apply_calibrations(DEVICE, (statics, sweep(values)), NOW)


def samples_at(position_m: np.ndarray, current_a: float = 2.0) -> np.ndarray:
    samples = np.zeros(position_m.size, SAMPLE)
    samples["index"] = np.arange(position_m.size)
    samples["position"], samples["current"] = position_m, current_a
    samples["flags"] = Flag.PLAYING
    return samples


def test_force_along_the_stroke_is_that_of_the_coil():
    device = calibrated(true_constant(PLACES))
    position = np.linspace(0.003, 0.029, 200)
    true = 2.0 * true_constant(position)
    found = recorded_force(samples_at(position), device)
    np.testing.assert_allclose(found, true, rtol=1e-3)
    constant = force(samples_at(position), device)
    assert np.max(np.abs(constant / true - 1.0)) > 0.15


def test_beyond_the_sweep_the_nearest_value_holds():
    device = calibrated(true_constant(PLACES))
    ends = relative_force_constant(device, np.array([0.0, 0.032, np.nan]))
    np.testing.assert_allclose(ends, [0.8, 0.8, 1.0], atol=1e-6)


@pytest.mark.parametrize(
    "damage", ["[[0.0, 0.1], [1.0, 9.0]]", "[[0.1, 0.0], [1.0, 1.0]]", "[[0.1], [1.0]]", "{", "[1, 2]"]
)
def test_a_damaged_profile_is_not_used(damage: str):
    device = replace(DEVICE, calibration={PROFILE: damage})
    samples = samples_at(np.array([0.01, 0.02]))
    np.testing.assert_array_equal(recorded_force(samples, device), force(samples, device))


def test_an_implausible_profile_is_not_taken_over():
    assert PROFILE not in calibrated(2.0 * true_constant(PLACES)).calibration


@pytest.mark.parametrize("compensated", [True, False])
def test_a_test_notes_which_force_constant_was_used(compensated: bool):
    device = calibrated(true_constant(PLACES)) if compensated else DEVICE
    samples = samples_at(np.full(20, 0.029))
    opened = OpenTest(Test(1, "stochastic", {}, 2000.0), Run(0, 20))
    opened.blocks.append(samples)
    opened.end("completed", {}, 20)
    test = opened.close(device)
    assert test is not None
    assert (USED_NOTE in test.notes) is compensated
    expected = 2.0 * true_constant(np.array([0.029]))[0] if compensated else 2.0 * DEVICE.force_constant_n_per_a
    np.testing.assert_allclose(test.signals["force"], expected, rtol=1e-3)


def test_limits_keep_the_plateau():
    """A limit in newtons is checked with the force constant of the plateau, which this coil nowhere exceeds."""
    device = calibrated(true_constant(PLACES))
    assert device.force_constant_n_per_a == PLATEAU
    position = np.linspace(0.0, 0.032, 50)
    assert np.all(recorded_force(samples_at(position), device) <= force(samples_at(position), device) + 1e-12)
