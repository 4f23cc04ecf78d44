"""Static calibration of instruments that differ from their nominal values."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from engine_claims.base import Claim
from static_rig import EXPECTED, TRUTH, rig

from firmware_sim.coil import coil_profile
from tissueid.calibration import StaticPlan, calibrate_static

SEEDS = 10
BAR = 0.005
NAMES = {
    "coil_resistance_ohm": "coil resistance",
    "force_constant_n_per_a": "force constant",
    "voltage_gain": "measured volts per commanded volt",
    "position_gain": "position scale",
}


def claims() -> Iterator[Claim]:
    """Ten instruments with a finite coil, each with its own noise: errors against the truth, and their spread."""
    runs, seconds = [], []
    for seed in range(SEEDS):
        instrument = rig(seed, coil="finite")
        found = calibrate_static(instrument, StaticPlan(ambient_c=TRUTH.ambient_degc)).calibration
        runs.append(found)
        seconds.append(instrument.link.now)
    passed = sum(found.verdict == "passed" for found in runs)
    yield Claim(
        f"{SEEDS} runs passed; duration of one run on the instrument's clock",
        f"{SEEDS}",
        f"{passed}; {max(seconds):.0f} s",
        passed == SEEDS,
    )
    # The spring is pushed about mid-stroke, where a finite coil is a little stronger than its plateau.
    share = coil_profile("finite", TRUTH.stroke_m).at(0.5 * TRUTH.stroke_m)
    truths = EXPECTED | {"force_constant_n_per_a": EXPECTED["force_constant_n_per_a"] * share}
    for name, words in NAMES.items():
        values = np.array([found.quantities[name].value for found in runs])
        stds = np.array([found.quantities[name].std for found in runs])
        error = np.abs(values / truths[name] - 1.0)
        covered = int(np.sum(np.abs(values - truths[name]) < 1.96 * stds))
        yield Claim(
            f"{words}: worst error; standard deviation of {SEEDS} runs; reported standard deviation; 95 % intervals "
            "that contain the true value",
            "0.5 %",
            f"{100 * error.max():.3f} %; {100 * values.std(ddof=1) / abs(values.mean()):.3f} %; "
            f"{100 * stds.mean() / abs(values.mean()):.3f} %; {covered} of {SEEDS}",
            bool(error.max() <= BAR),
        )
    for name, truth, scale, unit, bar in (
        ("current_offset_a", 0.010, 1e3, "mA", 1.0),
        ("position_offset_m", 150e-6, 1e6, "um", 20.0),
        ("stroke_min_m", 0.0, 1e6, "um", 100.0),
        ("stroke_max_m", 0.032, 1e6, "um", 100.0),
        ("temperature_offset_c", 1.5, 1.0, "K", 0.1),
    ):
        values = np.array([found.quantities[name].value for found in runs])
        worst = scale * float(np.abs(values - truth).max())
        yield Claim(
            f"`{name}`: worst error, and spread of {SEEDS} runs",
            f"{bar:g} {unit}",
            f"{worst:.3g} {unit}, {scale * values.std(ddof=1):.2g} {unit}",
            worst <= bar,
        )
