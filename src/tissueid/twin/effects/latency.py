"""Additional pure delay between the host's command and the coil."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.twin import bus
from tissueid.twin.effect import ActsOn, Effect, FloatArray, Parameter

# State: samples seen, the sample period, and the commands of the last samples.
SEEN, PERIOD, RING = 0, 1, 2
LENGTH = 256
EDGE = 0.1
"""Duration of an edge of the delayed command in samples, which makes the delay differentiable."""
LEAST_SAMPLES = 0.02
"""Shortest delay that is proposed as a starting point, samples."""


def hook(where: int, b: FloatArray, p: FloatArray, s: FloatArray, dt: float) -> None:
    """Delay the held command: held again after a delay between samples, or with its edges between samples."""
    delay, held = p[0], p[1]
    n = int(b[bus.SAMPLE])
    if s[SEEN] < n + 1:
        if n == 0:
            # Before the test the command is taken to be its first value.
            for k in range(LENGTH):
                s[RING + k] = b[bus.VOLTAGE]
        else:
            s[PERIOD] = b[bus.TIME] / n
        s[RING + n % LENGTH] = b[bus.VOLTAGE]
        s[SEEN] = n + 1
    if n == 0:
        return
    samples = delay / s[PERIOD]
    whole = min(math.floor(samples), LENGTH - 2)
    part = samples - whole
    again = (1.0 - part) * s[RING + (n - whole) % LENGTH] + part * s[RING + (n - whole - 1) % LENGTH]
    # The edges as a moving average at the end of the step and, over the step's own width, in its mean.
    edge = min(EDGE, samples)
    now, step = b[bus.TIME] / s[PERIOD] - samples, dt / s[PERIOD]
    mean = 0.0
    end = 0.0
    for which in range(2):
        low, high = now + step - max(edge, 1e-6), now + step
        if which == 1:
            middle = now + 0.5 * (step - edge)
            wide = 0.5 * math.sqrt(edge * edge + step * step)
            low, high = middle - wide, middle + wide
        # An edge at the very end of an interval belongs to the next.
        final = min(max(math.ceil(high - 1e-9) - 1, n + 1 - LENGTH), n)
        first = min(max(math.floor(low + 1e-9), n + 1 - LENGTH), final)
        total = 0.0
        for k in range(first, final + 1):
            lower = low if k == first else float(k)
            upper = high if k == final else float(k + 1)
            total += (upper - lower) * s[RING + k % LENGTH]
        if which == 0:
            end = total / (high - low)
        else:
            mean = total / (high - low)
    b[bus.VOLTAGE] = held * again + (1.0 - held) * mean
    b[bus.VOLTAGE_RISE] = (1.0 - held) * (end - mean)
    # An edge within the step acts as a ramp with the same first moment.
    new = math.ceil(now - 0.5 * edge)
    share = (new - now + 0.5 * edge) / step
    if share < 1.0 and n + 2 - LENGTH <= new <= n:
        jump = s[RING + new % LENGTH] - s[RING + (new - 1) % LENGTH]
        b[bus.VOLTAGE_TILT] = (1.0 - held) * 3.0 * share * (1.0 - share) * jump


def starts_from(tests: Sequence[Mapping[str, FloatArray]], sample_rate_hz: float) -> tuple[tuple[float, ...], ...]:
    """Return the delay at which the voltage, or else the current, follows the command best."""
    longest = min(int(0.02 * sample_rate_hz), LENGTH - 2)
    costs, parts = np.zeros(longest), np.zeros(longest)
    for signals in tests:
        command = np.asarray(signals["command"], np.float64)
        answer = np.asarray(signals.get("voltage", signals.get("current", ())), np.float64)
        if answer.size != command.size or command.size < 4 * longest or np.ptp(command) == 0.0:
            continue
        then = answer[longest + 1 :]
        good = np.isfinite(then)
        if good.sum() < 2 * longest or np.std(then[good]) == 0.0:
            continue
        for k in range(longest):
            ends = (longest + 1 - k, longest - k)
            shifted = [command[end : end + then.size][good] for end in ends]
            columns = np.column_stack([*shifted, np.ones(int(good.sum()))])
            shares, _, _, _ = np.linalg.lstsq(columns, then[good], rcond=None)
            costs[k] += float(np.mean((then[good] - columns @ shares) ** 2) / np.var(then[good]))
            total = shares[0] + shares[1]
            parts[k] = min(max(shares[1] / total, 0.0), 1.0) if total != 0.0 else 0.0
    if not costs.any():
        return ()
    best = int(np.argmin(costs))
    samples = best + float(parts[best])
    if samples < LEAST_SAMPLES:
        return ()
    return ((samples / sample_rate_hz, 0.5), ((best + 0.4) / sample_rate_hz, 0.1))


EFFECT = Effect(
    name="latency",
    stage="drive",
    acts_on=ActsOn.HELD_COMMAND,
    title="Extra delay in the drive",
    equation="u(t) = v(t - d); between samples held again (h = 1) or with its own edges (h = 0); vanishes with d = 0",
    signature="voltage, current and position all late by the same time against the command, phase growing in "
    "proportion to frequency, no change of amplitude; nothing at constant command; current against voltage unchanged",
    source="Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed. (1997), ch. 2 (sampling with a time delay)",
    parameters=(
        Parameter("delay_s", "s", 0.0, 2e-7, 0.02, True, meaning="delay of the command"),
        Parameter("held_share", "1", None, 0.0, 1.0, meaning="share held again at the sample edges"),
    ),
    starts=((2e-4, 0.5), (2.5e-4, 0.02), (1.2e-3, 0.5), (3.5e-3, 0.5)),
    mistaken_for=("amplifier_lag", "clock_skew", "dropped_samples"),
    places=(bus.AMPLIFIER,),
    hook=hook,
    needs=frozenset({"command"}),
    starts_from=starts_from,
    remedy="Check for buffering between host and amplifier; measure the delay with a step into a resistor.",
)
