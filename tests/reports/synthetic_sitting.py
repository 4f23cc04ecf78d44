"""A small synthetic sitting: a second-order system with an exponential bend, made here and not by the product."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import signal

from tissueid.device import DeviceDescription
from tissueid.sessions import Session, Subject, Test

RATE_HZ = 1000.0
PRELOAD_S = 0.3
MASS_KG, DAMPING_N_S_PER_M, STIFFNESS_N_PER_M = 0.09, 20.0, 4000.0


def make_test(number: int = 1, seconds: float = 3.0, seed: int = 0, **changes: object) -> Test:
    rng = np.random.default_rng(seed)
    n, preload = round(seconds * RATE_HZ), round(PRELOAD_S * RATE_HZ)
    low_pass = signal.butter(8, 150.0, fs=RATE_HZ, output="sos")
    noise = signal.sosfilt(low_pass, rng.standard_normal(n + 200))[200:]
    force = 5.0 + np.concatenate([np.zeros(preload), 1.5 * noise / noise.std()])
    plant = signal.cont2discrete(
        ([STIFFNESS_N_PER_M], [MASS_KG, DAMPING_N_S_PER_M, STIFFNESS_N_PER_M]), 1.0 / RATE_HZ, "foh"
    )
    load = 5.0 + signal.lfilter(plant[0].ravel(), plant[1], force - 5.0)
    position = 0.010 + 0.0092 * (1.0 - np.exp(-0.15 * load)) + 2e-6 * rng.standard_normal(load.size)
    voltage = 4.0 * force
    force = force + 2e-3 * rng.standard_normal(force.size)
    signals = {
        "time": np.arange(force.size) / RATE_HZ,
        "command": voltage,
        "voltage": voltage + 1e-3 * rng.standard_normal(force.size),
        "current": force / 3.0,
        "force": force,
        "position": position,
    }
    test = Test(
        number=number,
        kind="stochastic",
        signals=signals,
        sample_rate_hz=RATE_HZ,
        site="Left posterior forearm",
        preload_s=PRELOAD_S,
        surface_position_m=0.010,
        stimulus={"type": "guided", "preload_s": 0.3, "stimulus": {"type": "noise", "cutoff_hz": 150.0}},
        seed=seed,
    )
    return replace(test, **changes)  # type: ignore[arg-type]


def make_session(*tests: Test, **changes: object) -> Session:
    session = Session(
        instrument=DeviceDescription(
            serial_number="SIM-7", calibration={"kind": "electrical check", "verdict": "passed"}
        ),
        subject=Subject("TID-0042", {"age_years": 31.0}),
        tests=tests or (make_test(),),
        session_id="5a42e6d6-3058-4033-9637-bfeafebc3d74",
        created="2026-05-04T09:30:00Z",
        software="tissueid 0.1.0",
    )
    return replace(session, **changes)  # type: ignore[arg-type]
