"""Nonlinear position reading: a smooth curve along the stroke, or a periodic error of the sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tissueid.messages import Message
from tissueid.twin import _estimates
from tissueid.twin._interpolation import curve, travelled_range
from tissueid.twin.effect import Effect, FloatArray, Parameter, Readings

KNOTS = 13
MIDDLE_M = 0.012
"""Reference position of the periodic error, m, in the middle of the range of tests."""
SHORTEST_M, LONGEST_M = 2e-4, 2e-2
FEWEST_READINGS = 200
_FIRST = 2
_FLAT = (0.0,) * KNOTS
_BOWED = tuple(2e-5 * (1.0 - (k / 6.0 - 1.0) ** 2) for k in range(KNOTS))
_NO_WAVE = (0.0, 0.0, 0.0, 0.0, 2e-3)


def recording(readings: Readings, values: FloatArray) -> Readings:
    """Add a smooth curve along the stroke and one periodic error with its second harmonic to the position."""
    low, high = values[:_FIRST]
    cosine, sine, cosine_2, sine_2, period = values[_FIRST + KNOTS :]
    error = curve(values[_FIRST : _FIRST + KNOTS], (readings.position - low) / (high - low))
    angle = 2.0 * np.pi * (readings.position - MIDDLE_M) / period
    error += cosine * np.cos(angle) + sine * np.sin(angle)
    error += cosine_2 * np.cos(2.0 * angle) + sine_2 * np.sin(2.0 * angle)
    return replace(readings, position=readings.position + error)


def starts_from(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> tuple[tuple[float, ...], ...]:
    """Return a bow over the range of the probe, and the periodic error that explains most of the unexplained part."""
    ends = travelled_range(tests)
    if ends is None:
        return ()
    bowed = (*ends, *_BOWED, *_NO_WAVE)
    positions: list[FloatArray] = []
    errors: list[FloatArray] = []
    for signals in tests:
        residual = _estimates.unexplained(signals, "position", sample_rate_hz)
        valid = np.isfinite(signals["position"]) & (residual != 0.0)
        positions.append(signals["position"][valid][::4] - MIDDLE_M)
        errors.append(residual[valid][::4])
    position, error = np.concatenate(positions), np.concatenate(errors)
    if position.size < FEWEST_READINGS:
        return (bowed,)
    waves_per_m, (cosine, sine) = _estimates.line(error, position, (1,), 1.0 / LONGEST_M, 1.0 / SHORTEST_M)
    return (bowed, (*ends, *_FLAT, float(cosine), float(sine), 0.0, 0.0, 1.0 / waves_per_m))


def _error_at(k: int) -> Message:
    return Message("effect.error_at", "error at {place} of the curve", place=f"{k}/{KNOTS - 1}")


EFFECT = Effect(
    name="sensor_nonlinearity",
    stage="sensing",
    title="Position reading is nonlinear along the stroke",
    equation="y = x + e(x) + p cos(2 pi d/l) + q sin(2 pi d/l) + the same of l/2, d = x - 12 mm, e a smooth curve "
    "through thirteen errors over the range that the probe reached; vanishes with all of them and the waves 0",
    signature="an error in position only that is a function of position, the same in every test, at any speed, on "
    "tissue and on the spring; back-EMF in the current contradicts it",
    source="Nyce, Linear Position Sensors (2004), ch. 2 (linearity) and 11; Heydemann, Applied Optics 20 (1981) "
    "3382-3384 (cyclic error)",
    parameters=(
        Parameter("low_m", "m", None, -0.05, 0.1, fixed=True, meaning="position where the curve begins"),
        Parameter("high_m", "m", None, -0.05, 0.1, fixed=True, meaning="position where the curve ends"),
        *(
            Parameter(f"error_{k}_m", "m", 0.0, -3e-3, 3e-3, prior=0.0, prior_std=3e-4, meaning=_error_at(k))
            for k in range(KNOTS)
        ),
        Parameter(
            "cosine_m", "m", 0.0, -1e-3, 1e-3, prior=0.0, prior_std=1e-4, meaning="wave with its maximum at 12 mm"
        ),
        Parameter("sine_m", "m", 0.0, -1e-3, 1e-3, prior=0.0, prior_std=1e-4, meaning="wave rising through 0 at 12 mm"),
        Parameter("cosine_2_m", "m", 0.0, -5e-4, 5e-4, prior=0.0, prior_std=5e-5, meaning="same at half the period"),
        Parameter("sine_2_m", "m", 0.0, -5e-4, 5e-4, prior=0.0, prior_std=5e-5, meaning="same, rising at 12 mm"),
        Parameter("period_m", "m", None, SHORTEST_M, LONGEST_M, True, meaning="period along the stroke"),
    ),
    starts=((0.0, 0.032, *_FLAT, 1e-5, 1e-5, 0.0, 0.0, 2e-3),),
    mistaken_for=("force_constant_position", "tissue_stiffening", "cogging"),
    recording=recording,
    needs=frozenset({"position"}),
    starts_from=starts_from,
    jointly=True,
    remedy="Calibrate the position channel along the stroke against gauge blocks.",
)
