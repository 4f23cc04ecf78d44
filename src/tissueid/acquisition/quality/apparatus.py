"""Did the instrument do what it was told, and within what it was calibrated for."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tissueid.acquisition.quality.evidence import Evidence, longest
from tissueid.instrument.answers import describe_faults
from tissueid.instrument.judge import BY_CURRENT
from tissueid.sessions.quality import QualityFinding, Severity
from tissueid.wire import Fault
from tissueid.wording import fixed, grouped

LOST_SHARE, LOST_REPEAT_SHARE = 0.01, 0.10
LONG_GAP_S = 0.1
HELD_SHARE = 0.01

FULL_SHARE, FULL_REPEAT_SHARE = 0.0005, 0.02
_AT_LIMIT = 0.99
_SHORT_V = 1.5
_STROKE_MARGIN_M = 1.0e-3
STUCK_S = 0.1
_STUCK_DRIVE_N = 0.3
"""Spread of the commanded force beyond which every reading must change."""
GAIN_OFF = 0.10
RESISTANCE_OFF = 0.25
_OPEN = 5.0
_WINDOW_S = 0.2

OUTSIDE_SHARE = 0.01
WARM_C, HOT_C = 50.0, 65.0
WARMED_K = 15.0
_COPPER_PER_K = 0.0039

SHORTEST_S = 1.0


def ended(evidence: Evidence) -> Iterator[QualityFinding]:
    """Tests that were broken off or recovered."""
    test = evidence.test
    if test.status not in ("aborted", "recovered"):
        return
    seconds = max(0.0, (test.samples - evidence.first) / evidence.rate)
    why = test.notes.get("reason")
    said = f": {why}" if isinstance(why, str) and why else ""
    when = f"{fixed(seconds, 1)} s of its stimulus"
    if test.samples <= round(test.preload_s * evidence.rate):
        held_s = test.samples / evidence.rate
        when = f"{fixed(held_s, 2)} of the {fixed(test.preload_s, 2)} s of its preload, without any stimulus"
    how = "was broken off" if test.status == "aborted" else "was recovered after its recording was interrupted"
    yield QualityFinding(
        "ended_early",
        "repeat" if seconds < SHORTEST_S else "look",
        f"The test {how} after {when}{said}.",
        "Run it again when the cause is mended; what was recorded can be analysed, but is shorter than planned.",
        seconds,
    )


def lost(evidence: Evidence) -> Iterator[QualityFinding]:
    """Samples that were not received, and set-points that came too late."""
    test = evidence.test
    signals = [test.signals[name] for name in ("force", "position") if name in test.signals]
    if signals:
        missing = np.any([np.isnan(values) for values in signals], axis=0)
        share = float(missing.mean())
        gap_s = longest(missing) / evidence.rate
        if share > 0.0:
            severity: Severity = "repeat" if share > LOST_REPEAT_SHARE else "look"
            if share <= LOST_SHARE and gap_s <= LONG_GAP_S:
                severity = "note"
            yield QualityFinding(
                "samples_lost",
                severity,
                f"{grouped(missing.sum())} of {grouped(missing.size)} samples ({fixed(100 * share, 2)} %) did not "
                f"arrive, {fixed(1e3 * gap_s, 0)} ms of them in one piece.",
                "Check the cable and close other programs. What is missing stays empty and is left out.",
                share,
            )
    held = test.notes.get("held_samples")
    if isinstance(held, int | float) and held > 0:
        share = float(held) / max(1, test.samples)
        yield QualityFinding(
            "setpoints_late",
            "look" if share > HELD_SHARE else "note",
            f"For {grouped(held)} samples ({fixed(100 * share, 1)} %) the next force was not there in time, and the "
            "instrument held a steady one.",
            "Close other programs, or let the stimulus be made further ahead (its option lead).",
            share,
        )


def saturated(evidence: Evidence) -> Iterator[QualityFinding]:
    """A converter or the amplifier at its end."""
    test = evidence.test
    counted = test.notes.get("saturated_samples")
    full = float(counted) / max(1, test.samples) if isinstance(counted, int | float) else 0.0
    weak = _share_at_limit(evidence)
    worst = max(full, weak)
    if worst <= FULL_SHARE:
        return
    what = "A converter was at the end of its range" if full >= weak else "The amplifier was at its limit"
    yield QualityFinding(
        "saturated",
        "repeat" if worst > FULL_REPEAT_SHARE else "look",
        f"{what} for {fixed(100 * worst, 2)} % of the test: what was recorded there is cut off.",
        "Lower the force, and look whether the instrument is knocked or at the end of its stroke.",
        worst,
    )


def _share_at_limit(evidence: Evidence) -> float:
    """Share of the stimulus in which the amplifier gave its most, or clearly less than it was asked for."""
    device = evidence.device
    volts = evidence.stimulus("voltage")
    if not volts.size:
        return 0.0
    most = float(np.mean(np.abs(volts) >= _AT_LIMIT * device.amplifier_limit_v))
    command, voltage = evidence.signal("command"), evidence.signal("voltage")
    if command is None or voltage is None:
        return most
    asked, given = (np.abs(values[evidence.first :]) for values in (device.amplifier_gain * command, voltage))
    there = np.isfinite(asked) & np.isfinite(given)
    # Less by a constant share is a gain that is off, and told as that.
    gain = float(np.median(given[there] / np.maximum(asked[there], 1e-3))) if there.any() else 1.0
    short = there & (asked * min(gain, 1.0) - given > _SHORT_V)
    return max(most, float(short.sum() / max(1, there.sum())))


def at_the_end(evidence: Evidence) -> Iterator[QualityFinding]:
    """The probe came near an end of its stroke."""
    position = evidence.stimulus("position")
    if not position.size or evidence.test.kind == "free_air":
        return
    low = min(_limit(evidence, "limit_min_position_m", 0.0), 0.5 * evidence.device.stroke_m)
    high = max(_limit(evidence, "limit_max_position_m", evidence.device.stroke_m), low)
    room = float(min(position.min() - low, high - position.max()))
    if room >= _STROKE_MARGIN_M:
        return
    inner = position.min() - low < high - position.max()
    yield QualityFinding(
        "end_of_stroke",
        "repeat" if room <= 0.0 else "look",
        f"The probe came within {fixed(1e3 * max(room, 0.0), 2)} mm of the {'inner' if inner else 'outer'} end of its "
        "stroke.",
        evidence.setting.to_centre,
        room,
    )


def _limit(evidence: Evidence, name: str, otherwise: float) -> float:
    value = evidence.test.notes.get(name)
    return float(value) if isinstance(value, int | float) else otherwise


def stuck(evidence: Evidence) -> Iterator[QualityFinding]:
    """A reading that stands still while the force is driven."""
    command = evidence.stimulus("command")
    if command.size < 2 or float(np.std(command)) < _STUCK_DRIVE_N * evidence.device.voltage_for_force(1.0):
        return
    for name, label in (("position", "position"), ("current", "current"), ("voltage", "voltage")):
        values = evidence.stimulus(name)
        if values.size < 2:
            continue
        still = (longest(np.diff(values) == 0.0) + 1) / evidence.rate
        if still < STUCK_S:
            continue
        yield QualityFinding(
            "sensor_stuck",
            "repeat",
            f"The reading of the {label} stood still for {fixed(still, 2)} s while the coil was driven.",
            "Do not use the test. Check the sensor and its cable, and calibrate before the next one.",
            still,
        )


def driven(evidence: Evidence) -> Iterator[QualityFinding]:
    """Voltage that does not follow the command, current that does not follow the voltage."""
    device = evidence.device
    named = [evidence.signal(name) for name in ("command", "voltage", "current")]
    if evidence.test.kind == "quiet" or any(values is None for values in named):
        return
    command, voltage, current = (np.asarray(values)[evidence.first :] for values in named)
    there = np.isfinite(command) & np.isfinite(voltage) & np.isfinite(current)
    command, voltage, current = command[there], voltage[there], current[there]
    if command.size < 2 or float(np.std(command)) < _STUCK_DRIVE_N * device.voltage_for_force(1.0):
        return
    gain = _slope(command, voltage) / device.amplifier_gain
    if abs(gain - 1.0) > GAIN_OFF:
        yield QualityFinding(
            "drive_weak",
            "look",
            f"The coil got {fixed(100 * gain, 0)} % of the voltage that was asked for.",
            "Check the power supply; the force is measured and can be used, but was not the one that was designed.",
            gain,
        )
    conductance = _least_slope(voltage, current, round(_WINDOW_S * evidence.rate)) * device.coil_resistance_ohm
    if conductance < 1.0 / _OPEN:
        yield QualityFinding(
            "coil_open",
            "repeat",
            "Hardly any current flowed through the coil, for some of the test or for all of it.",
            "Check that the coil is connected, then run 'tissueid calibrate static'.",
            conductance,
        )
    elif not 1.0 - RESISTANCE_OFF < _resting_ratio(voltage, current) * device.coil_resistance_ohm < 1 + RESISTANCE_OFF:
        yield QualityFinding(
            "coil_resistance",
            "look",
            f"The coil's resistance looks like {fixed(1.0 / _resting_ratio(voltage, current), 1)} Ω; "
            f"{fixed(device.coil_resistance_ohm, 1)} Ω was expected.",
            "Run 'tissueid calibrate static' before the next test.",
            1.0 / _resting_ratio(voltage, current),
        )


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    deviations = x - x.mean()
    return float(deviations @ (y - y.mean()) / (deviations @ deviations))


def _least_slope(x: np.ndarray, y: np.ndarray, window: int) -> float:
    """The least slope of y against x in any window of so many samples in which x moves as it does throughout."""
    moving, slopes = 0.5 * float(x.std()), [_slope(x, y)]
    for first in range(0, x.size - window + 1, max(2, window)):
        part = slice(first, first + window)
        if window >= 2 and float(x[part].std()) > moving:
            slopes.append(_slope(x[part], y[part]))
    return min(slopes)


def _resting_ratio(voltage: np.ndarray, current: np.ndarray) -> float:
    """Mean current over mean voltage: over a test the probe comes back to where it was, and the back-EMF averages out.

    Where the means are next to nothing they say nothing: then it is the ratio that the slope gives.
    """
    level = float(voltage.mean())
    return float(current.mean()) / level if abs(level) > 0.5 * float(voltage.std()) else _slope(voltage, current)


def outside(evidence: Evidence) -> Iterator[QualityFinding]:
    """Positions outside the stretch of the stroke where the calibrated coil is linear."""
    calibration = evidence.device.calibration
    low, high = calibration.get("linear_region_min_m"), calibration.get("linear_region_max_m")
    position = evidence.stimulus("position")
    if not isinstance(low, int | float) or not isinstance(high, int | float) or not position.size or not low < high:
        return
    share = float(np.mean((position < low) | (position > high)))
    if share == 0.0:
        return
    yield QualityFinding(
        "outside_linear_region",
        "look" if share > OUTSIDE_SHARE else "note",
        f"For {fixed(100 * share, 1)} % of the test the probe was outside the stretch of {fixed(1e3 * low, 1)} to "
        f"{fixed(1e3 * high, 1)} mm where the coil was found to be linear.",
        "Place the instrument so that the test stays inside it; forces outside are less than they read.",
        share,
    )


def warm(evidence: Evidence) -> Iterator[QualityFinding]:
    """A coil that is warm, or was warmed much by the test."""
    signal = evidence.signal("temperature")
    if signal is None:
        return
    known = signal[np.isfinite(signal)]
    tenth = max(1, known.size // 10)
    # Means, so that the noise of single samples does not count.
    begin, end = float(known[:tenth].mean()), float(known[-tenth:].mean())
    hottest = max(begin, end)
    limit_c = _limit(evidence, "limit_max_temperature_c", np.nan)
    if _too_hot(evidence) and float(known.max()) < limit_c:
        yield QualityFinding(
            "coil_warm",
            "look",
            f"It was the calculation that ended the test: by its current the winding came to the limit of "
            f"{fixed(limit_c, 0)} °C. The sensor beside it, which lags, read {fixed(hottest, 0)} °C.",
            "Let the coil cool for some minutes, and rest between repeats (--rest).",
            limit_c,
        )
    elif hottest > WARM_C:
        yield QualityFinding(
            "coil_warm",
            "look" if hottest > HOT_C else "note",
            f"The coil was at {fixed(hottest, 0)} °C.",
            "Let it cool before the next test, and keep it off the skin.",
            hottest,
        )
    elif end - begin > WARMED_K:
        yield QualityFinding(
            "coil_warmed",
            "note",
            f"The coil warmed by {fixed(end - begin, 0)} K in this test, its resistance by some "
            f"{fixed(100 * _COPPER_PER_K * (end - begin), 0)} %.",
            "The force is measured by the current and holds; pause between tests.",
            end - begin,
        )


def _too_hot(evidence: Evidence) -> bool:
    """Whether the coil's temperature broke the test off, by the instrument's word or the host's own."""
    reason = evidence.test.notes.get("reason")
    if evidence.test.status != "aborted" or not isinstance(reason, str):
        return False
    return describe_faults(Fault.OVER_TEMPERATURE) in reason or BY_CURRENT in reason


def calibrated(evidence: Evidence) -> Iterator[QualityFinding]:
    """No calibration, or one that should not be relied on."""
    calibration = evidence.device.calibration
    state = calibration.get("state")
    verdict = calibration.get("verdict")
    warnings = str(calibration.get("warnings") or "").strip()
    if warnings and not warnings.endswith((".", "!", "?")):
        warnings += "."
    if not calibration or state == "none":
        yield QualityFinding(
            "calibration_none",
            "note",
            "No calibration was in force: nominal figures of the instrument were used.",
            "Run 'tissueid calibrate static' before measurements that are to be compared.",
        )
    elif state == "stale":
        yield QualityFinding(
            "calibration_stale",
            "look",
            f"The calibration is out of date. {warnings}".strip(),
            "Run 'tissueid calibrate static', and 'tissueid calibrate sweep' where its date has passed.",
        )
    elif verdict == "failed" or state not in (None, "valid"):
        yield QualityFinding(
            "calibration_failed",
            "look",
            f"The calibration in force should not be relied on. {warnings}".strip(),
            "Have the instrument calibrated before the next test.",
        )
    elif warnings:
        yield QualityFinding("calibration_warning", "note", f"Of the calibration: {warnings}", "")
