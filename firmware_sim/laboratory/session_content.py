"""Content of a session file of the laboratory: nominal instrument, and attributes of the tests without labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from firmware_sim.laboratory import PRELOAD_S, SIGNALS, Recording
from firmware_sim.plant import SAMPLE_RATE_HZ

CALIBRATION_UNCERTAINTY = 0.015
NOMINAL = {
    "model": "desktop indenter",
    "sample_rate_hz": SAMPLE_RATE_HZ,
    "coil_resistance_ohm": 12.0,
    "coil_inductance_h": 1e-3,
    "force_constant_n_per_a": 3.0,
    "moving_mass_kg": 0.060,
    "bearing_damping_n_s_per_m": 3.5,
    "amplifier_gain": 1.0,
    "amplifier_limit_v": 48.0,
    "stroke_m": 0.032,
    "calibration_relative_uncertainty": CALIBRATION_UNCERTAINTY,
    "calibration_spring_n_per_m": 1000.0,
}


def described(
    number: int,
    instrument: Mapping[str, object],
    tests: Sequence[Mapping[str, object]],
    recordings: Sequence[Recording],
) -> dict[str, object]:
    """Return the content of a session file, which has no labels: instrument and tests, with the place of their signals.

    ``tests`` hold the attributes of each test that only the laboratory knows.
    """
    found: list[dict[str, object]] = []
    offset = 0
    for test, recording in zip(tests, recordings, strict=True):
        found.append(
            {
                "name": f"{len(found) + 1:04d}",
                "kind": recording.kind,
                "configuration": "indentation",
                "preload_s": PRELOAD_S,
                **test,
                "sample_rate_hz": SAMPLE_RATE_HZ,
                "first": offset,
                "samples": recording.time.size,
            }
        )
        offset += recording.time.size * len(SIGNALS)
    return {
        "format": "tissueid-laboratory 1",
        "scenario": number,
        "signals": list(SIGNALS),
        "units": ["s", "V", "V", "A", "m", "degC"],
        "instrument": dict(instrument),
        "tests": found,
    }
