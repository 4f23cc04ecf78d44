"""What a running calibration shows: read-outs, signals, and a curve that grows."""

import numpy as np
import pytest
from support import connect

from firmware_sim.identity import Identity
from tissueid.acquisition import SessionRecorder
from tissueid.app.calibration_controller import LiveCalibration
from tissueid.calibration import StaticPlan, calibrate_static
from tissueid.calibration.plans import SweepPlan
from tissueid.calibration.sweep import Sweep


@pytest.fixture
def instrument():
    return connect("calibration-spring", seed=3, identity=Identity(stage=True))


def test_a_static_calibration_draws_the_line_of_the_spring(instrument):
    live = LiveCalibration(sweep=False)
    live.watch(instrument)
    counts = []
    plan = StaticPlan(steps=("electrical", "force"))
    calibrate_static(instrument, plan, progress=lambda *_: counts.append(live.curve()[0].size))
    current, position = live.curve()
    assert counts[0] == 0
    assert counts == sorted(counts)
    assert counts[-1] > 10
    assert np.polyfit(current, position, 1)[0] == pytest.approx(3.0 / 1000.0, rel=0.03)
    snapshot = live.snapshot()
    assert snapshot.time_s.size == snapshot.position_m.size > 1000
    assert snapshot.safety.position_m == pytest.approx(float(np.nanmedian(snapshot.position_m[-500:])), abs=1e-4)
    assert snapshot.safety.temperature_c is not None


def test_a_sweep_draws_a_point_at_each_position(instrument, tmp_path):
    live = LiveCalibration(sweep=True)
    live.watch(instrument)
    plan = SweepPlan(from_m=0.012, to_m=0.020, step_m=4e-3, seconds=1.0)
    recorder = SessionRecorder(tmp_path / "sweep.h5", instrument.device)
    Sweep(instrument, plan, recorder).run()
    place, swing = live.curve()
    assert place == pytest.approx([0.012, 0.016, 0.020], abs=1e-3)
    assert np.ptp(swing) < 0.2 * swing.mean()  # this coil is alike along its stroke
