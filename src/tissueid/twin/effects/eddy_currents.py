"""Eddy currents in the pole pieces: an inductance that is lossy and falls with frequency."""

from __future__ import annotations

import math

from tissueid.twin import bus
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter

# State: predicted coil current and the currents of the branches' inductances; resistance and inductance of the step's
# matrix; the matrix, and two work matrices.
CURRENTS, MADE_FOR, MATRIX, POWER, PRODUCT = 0, 3, 5, 14, 23
SLOWER = 8.0
"""Ratio of the time constants of the second and the first branch."""
TERMS = 9
"""Terms of the series of the matrix exponential after scaling."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Apply lossy inductances in series with the coil: all three currents are exact over a step."""
    inductance, loss, taken, second = p[0], p[1], p[2], p[3]
    slower = SLOWER * inductance
    own = b[bus.INDUCTANCE] / (1.0 + taken * inductance / b[bus.INDUCTANCE])
    resistance, now = b[bus.RESISTANCE], b[bus.CURRENT]
    changed = abs(resistance - s[MADE_FOR]) > 1e-6 * resistance or abs(own - s[MADE_FOR + 1]) > 1e-6 * own
    if s[MADE_FOR] == 0.0:
        for k in range(3):
            s[CURRENTS + k] = now
    if changed:
        s[MADE_FOR], s[MADE_FOR + 1] = resistance, own
        halvings = 0
        scale = dt
        while scale * ((resistance + loss * (1.0 + second)) / own + loss / inductance) > 0.25:
            scale *= 0.5
            halvings += 1
        for k in range(9):
            s[MATRIX + k] = 0.0
        for k in range(9):
            s[POWER + k] = 0.0
        for k in range(3):
            s[MATRIX + 4 * k] = 1.0
            s[POWER + 4 * k] = 1.0
        for term in range(1, TERMS + 1):
            share = scale / term
            for column in range(3):
                coil, first, slow = s[POWER + column], s[POWER + 3 + column], s[POWER + 6 + column]
                across = loss * (coil - first) + second * loss * (coil - slow)
                s[POWER + column] = -share * (resistance * coil + across) / own
                s[POWER + 3 + column] = share * loss / inductance * (coil - first)
                s[POWER + 6 + column] = share * loss / slower * (coil - slow)
            for k in range(9):
                s[MATRIX + k] += s[POWER + k]
        for _ in range(halvings):
            for row in range(3):
                for column in range(3):
                    total = 0.0
                    for k in range(3):
                        total += s[MATRIX + 3 * row + k] * s[MATRIX + 3 * k + column]
                    s[PRODUCT + 3 * row + column] = total
            for k in range(9):
                s[MATRIX + k] = s[PRODUCT + k]
    off = now - s[CURRENTS]
    if abs(off) > 1e-9:
        # The coil's current was measured or changed by another effect: distribute the difference over the step.
        ratio = dt * loss / inductance
        s[CURRENTS + 1] += off * (1.0 + math.expm1(-ratio) / ratio)
        s[CURRENTS + 2] += off * (1.0 + SLOWER * math.expm1(-ratio / SLOWER) / ratio)
    middle = b[bus.VELOCITY] + 0.5 * dt * b[bus.ACCELERATION]
    settled = (b[bus.VOLTAGE] - b[bus.OPPOSING_VOLTAGE] - b[bus.FORCE_CONSTANT] * middle) / resistance
    coil, first, slow = now - settled, s[CURRENTS + 1] - settled, s[CURRENTS + 2] - settled
    for k in range(3):
        row = MATRIX + 3 * k
        s[CURRENTS + k] = settled + s[row] * coil + s[row + 1] * first + s[row + 2] * slow
    # For the chain: the mean voltage across the branches, and a ramp that leads to the same current.
    rise = s[CURRENTS + 1] - settled - first
    slow_rise = s[CURRENTS + 2] - settled - slow
    opposing = inductance * (rise + SLOWER * second * slow_rise) / dt
    decay = resistance * dt / own
    kept = math.exp(-decay)
    without = settled + (1.0 - kept) * (-opposing / resistance) + kept * coil
    ramp = 1.0 + kept - 2.0 * (1.0 - kept) / decay
    b[bus.INDUCTANCE] = own
    b[bus.OPPOSING_VOLTAGE] += opposing
    b[bus.VOLTAGE_TILT] += (s[CURRENTS] - without) * resistance / ramp


EFFECT = Effect(
    name="eddy_currents",
    stage="coil",
    acts_on=ActsOn.COIL_CURRENT,
    title="Eddy currents: lossy inductance",
    equation="v = R i + L/(1 + h Le/L) i' + Re (i - j) + kf x', Le j' = Re (i - j), and a branch of 8 s Le and s Re; "
    "vanishes with Le = 0",
    signature="current against voltage at high frequencies: resistance rises and inductance falls with frequency, the "
    "same at every depth and amplitude; nothing in slow or quiet records; seen with the coil held still",
    source="Vanderkooy, J. Audio Eng. Soc. 37 (1989) 119-128; Leach, J. Audio Eng. Soc. 50 (2002) 442-450",
    parameters=(
        Parameter("branch_inductance_h", "H", 0.0, 1e-6, 0.05, True, meaning="inductance of the eddy-current branch"),
        Parameter(
            "branch_resistance_ohm", "ohm", None, 0.05, 200.0, True, prior=4.0, prior_std=2.0, meaning="loss across it"
        ),
        Parameter("taken_share", "1", None, 0.0, 3.0, prior=0.3, prior_std=0.7, meaning="share from the coil's own"),
        Parameter("second_share", "1", None, 0.0, 2.0, prior=0.0, prior_std=0.5, meaning="loss of a slower branch"),
    ),
    starts=((5e-4, 4.0, 0.3, 0.05), (2e-3, 2.0, 0.3, 0.05), (5e-4, 20.0, 0.8, 0.05)),
    mistaken_for=("inductance_position", "amplifier_lag", "coil_heating"),
    places=(bus.COIL,),
    hook=hook,
    needs=frozenset({"current"}),
    remedy="Measure the blocked coil's impedance against frequency; include the lossy inductance in the calibration.",
)
