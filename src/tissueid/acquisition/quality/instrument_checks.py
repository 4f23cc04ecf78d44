"""Quality checks of the instrument: lost samples, saturation, sensors, drive, temperature and calibration."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tissueid.acquisition.quality.prepared_test import PreparedTest, longest_run
from tissueid.device import CALIBRATE_STATIC, CALIBRATE_SWEEP
from tissueid.instrument.force_profile import USED_NOTE
from tissueid.language import marked
from tissueid.messages import Listing, Message
from tissueid.sessions.model import IMPORTED, reason_codes
from tissueid.sessions.quality import QualityFinding, Severity

LOST_SHARE, LOST_REPEAT_SHARE = 0.01, 0.10
"""Shares of samples that were not received, above which a test is doubtful or should be repeated."""
LONG_GAP_S = 0.1
"""Maximum gap, s, that does not make a test doubtful."""
HELD_SHARE = 0.01
"""Share of samples with a late set-point above which a test is doubtful."""

FULL_SHARE, FULL_REPEAT_SHARE = 0.0005, 0.02
"""Shares of saturated samples above which a test is doubtful or should be repeated."""
_LIMIT_SHARE = 0.99
"""Share of the amplifier's limit from which a sample counts as saturated."""
_MISSING_V = 1.5
"""Missing voltage, V, above which a sample counts as saturated."""
_STROKE_MARGIN_M = 1.0e-3
"""Distance from an end of the stroke, m, below which a test is doubtful."""
STUCK_S = 0.1
"""Duration of equal readings, s, above which a sensor counts as frozen."""
_STUCK_DRIVE_N = 0.3
"""Standard deviation of the commanded force, N, above which every working sensor changes."""
GAIN_OFF = 0.10
"""Relative deviation of the amplifier's gain that is reported."""
RESISTANCE_OFF = 0.25
"""Relative deviation of the coil's resistance that is reported."""
_OPEN_RATIO = 5.0
"""Resistance relative to the expected one above which the coil counts as open."""
_WINDOW_S = 0.2
"""Length of the windows, s, that are checked for an open coil."""

OUTSIDE_SHARE = 0.01
"""Share of samples outside the linear region above which a test is doubtful."""
WARM_C, HOT_C = 50.0, 65.0
"""Coil temperatures, degC, above which a note is given, and above which a test is doubtful."""
WARMED_K = 15.0
"""Rise of the coil temperature within a test, K, above which a note is given."""
_TOO_HOT = {"fault.over_temperature", "limit.winding_temperature"}
"""Codes in the reason of a test that was stopped because of the coil temperature."""
_COPPER_PER_K = 0.0039
"""Relative change of the resistance of copper, 1/K."""


def check_completion(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a test that was stopped early or recovered."""
    test = prepared.test
    if test.status not in ("aborted", "recovered"):
        return
    seconds = max(0.0, (test.samples - prepared.first) / prepared.rate)
    held_s = test.samples / prepared.rate
    reason = test.reason
    if test.samples <= round(test.preload_s * prepared.rate):
        when = Message(
            "quality.ended_early.preload",
            "after {held:.2f} s of its {preload:.2f} s preload, before the stimulus",
            held=held_s,
            preload=test.preload_s,
        )
    else:
        when = Message("quality.ended_early.stimulus", "after {seconds:.1f} s of its stimulus", seconds=seconds)
    if test.status == "aborted":
        message = Message("quality.ended_early", "The test was stopped {when}.", when=when)
        if reason:
            message = Message("quality.ended_early", "The test was stopped {when}: {reason}.", when=when, reason=reason)
    else:
        message = Message("quality.recovered", "The recording was interrupted {when} and was recovered.", when=when)
        if reason:
            message = Message(
                "quality.recovered",
                "The recording was interrupted {when} and was recovered: {reason}.",
                when=when,
                reason=reason,
            )
    yield QualityFinding(
        "ended_early",
        "repeat",
        message,
        marked("Remove the cause and run the test again. The recorded part can be analysed, but is short."),
        seconds,
    )


def check_lost_samples(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report samples that were not received and set-points that came too late."""
    test = prepared.test
    signals = [test.signals[name] for name in ("force", "position") if name in test.signals]
    if signals:
        missing = np.any([np.isnan(values) for values in signals], axis=0)
        share = float(missing.mean())
        gap_s = longest_run(missing) / prepared.rate
        if share > 0.0:
            severity: Severity = "repeat" if share > LOST_REPEAT_SHARE else "look"
            if share <= LOST_SHARE and gap_s <= LONG_GAP_S:
                severity = "note"
            yield QualityFinding(
                "samples_lost",
                severity,
                Message(
                    "quality.samples_lost",
                    "{lost} of {samples} samples ({percent:.2f} %) were not received; the longest gap lasts "
                    "{gap:.0f} ms.",
                    lost=int(missing.sum()),
                    samples=int(missing.size),
                    percent=100 * share,
                    gap=1e3 * gap_s,
                ),
                marked("Check the cable and close other programs. Missing samples stay empty and are not analysed."),
                share,
            )
    held = test.notes.get("held_samples")
    if isinstance(held, int | float) and held > 0:
        share = float(held) / max(1, test.samples)
        yield QualityFinding(
            "setpoints_late",
            "look" if share > HELD_SHARE else "note",
            Message(
                "quality.setpoints_late",
                "For {held:.0f} samples ({percent:.1f} %) the next set-point came too late, and the instrument held "
                "the force constant.",
                held=float(held),
                percent=100 * share,
            ),
            marked("Close other programs, or compute the stimulus further ahead (its option lead)."),
            share,
        )


def check_saturation(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report saturation of a converter or of the amplifier."""
    test = prepared.test
    counted = test.notes.get("saturated_samples")
    full = float(counted) / max(1, test.samples) if isinstance(counted, int | float) else 0.0
    weak = _share_at_limit(prepared)
    worst = max(full, weak)
    if worst <= FULL_SHARE:
        return
    if full >= weak:
        message = Message(
            "quality.saturated.converter",
            "A converter was at the end of its range for {percent:.2f} % of the test: the recording is clipped there.",
            percent=100 * worst,
        )
    else:
        message = Message(
            "quality.saturated.amplifier",
            "The amplifier was at its limit for {percent:.2f} % of the test: the force is clipped there.",
            percent=100 * worst,
        )
    yield QualityFinding(
        "saturated",
        "repeat" if worst > FULL_REPEAT_SHARE else "look",
        message,
        marked("Lower the force, and check that the probe neither strikes anything nor reaches the end of its stroke."),
        worst,
    )


def _share_at_limit(prepared: PreparedTest) -> float:
    """Return the share of the stimulus in which the amplifier is at its limit or clearly below the command."""
    device = prepared.device
    volts = prepared.stimulus("voltage")
    if not volts.size:
        return 0.0
    most = float(np.mean(np.abs(volts) >= _LIMIT_SHARE * device.amplifier_limit_v))
    command, voltage = prepared.signal("command"), prepared.signal("voltage")
    if command is None or voltage is None:
        return most
    asked, given = (np.abs(values[prepared.first :]) for values in (device.amplifier_gain * command, voltage))
    there = np.isfinite(asked) & np.isfinite(given)
    # A constant ratio is a gain error, which ``check_drive`` reports.
    gain = float(np.median(given[there] / np.maximum(asked[there], 1e-3))) if there.any() else 1.0
    short = there & (asked * min(gain, 1.0) - given > _MISSING_V)
    return max(most, float(short.sum() / max(1, there.sum())))


def check_stroke(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a probe that came close to an end of its stroke, if the stroke is known."""
    position = prepared.stimulus("position")
    if not position.size or prepared.test.kind == "free_air" or not np.isfinite(prepared.device.stroke_m):
        return
    low = min(_limit(prepared, "limit_min_position_m", 0.0), 0.5 * prepared.device.stroke_m)
    high = max(_limit(prepared, "limit_max_position_m", prepared.device.stroke_m), low)
    room = float(min(position.min() - low, high - position.max()))
    if room >= _STROKE_MARGIN_M:
        return
    room_mm = 1e3 * max(room, 0.0)
    if position.min() - low < high - position.max():
        message = Message(
            "quality.end_of_stroke.inner",
            "The probe came within {room:.2f} mm of the inner end of its stroke.",
            room=room_mm,
        )
    else:
        message = Message(
            "quality.end_of_stroke.outer",
            "The probe came within {room:.2f} mm of the outer end of its stroke.",
            room=room_mm,
        )
    yield QualityFinding(
        "end_of_stroke",
        "repeat" if room <= 0.0 else "look",
        message,
        prepared.texts.stroke_advice,
        room,
    )


def _limit(prepared: PreparedTest, name: str, otherwise: float) -> float:
    value = prepared.test.notes.get(name)
    return float(value) if isinstance(value, int | float) else otherwise


_STUCK_LABELS = {"position": marked("position"), "current": marked("current"), "voltage": marked("voltage")}


def check_sensors(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a sensor whose reading is frozen while the coil is driven."""
    command = prepared.stimulus("command")
    if command.size < 2 or float(np.std(command)) < _STUCK_DRIVE_N * prepared.device.voltage_for_force(1.0):
        return
    for name, label in _STUCK_LABELS.items():
        values = prepared.stimulus(name)
        if values.size < 2:
            continue
        still = (longest_run(np.diff(values) == 0.0) + 1) / prepared.rate
        if still < STUCK_S:
            continue
        yield QualityFinding(
            "sensor_stuck",
            "repeat",
            Message(
                "quality.sensor_stuck",
                "The {signal} reading did not change for {seconds:.2f} s while the coil was driven.",
                signal=label,
                seconds=still,
            ),
            marked("Do not use the test. Check the sensor and its cable, and calibrate before the next test."),
            still,
        )


def check_drive(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a voltage that does not follow the command, and a current that does not follow the voltage."""
    device = prepared.device
    named = [prepared.signal(name) for name in ("command", "voltage", "current")]
    if prepared.test.kind == "quiet" or any(values is None for values in named):
        return
    command, voltage, current = (np.asarray(values)[prepared.first :] for values in named)
    there = np.isfinite(command) & np.isfinite(voltage) & np.isfinite(current)
    command, voltage, current = command[there], voltage[there], current[there]
    if command.size < 2 or float(np.std(command)) < _STUCK_DRIVE_N * device.voltage_for_force(1.0):
        return
    gain = _slope(command, voltage) / device.amplifier_gain
    if abs(gain - 1.0) > GAIN_OFF:
        yield QualityFinding(
            "drive_weak",
            "look",
            Message("quality.drive_weak", "The coil got {percent:.0f} % of the commanded voltage.", percent=100 * gain),
            marked("Check the power supply. The measured force is valid, but differs from the designed one."),
            gain,
        )
    conductance = _least_slope(voltage, current, round(_WINDOW_S * prepared.rate)) * device.coil_resistance_ohm
    if conductance < 1.0 / _OPEN_RATIO:
        yield QualityFinding(
            "coil_open",
            "repeat",
            Message("quality.coil_open", "Hardly any current flowed through the coil in a part or all of the test."),
            Message(
                "quality.coil_open.advice",
                "Check that the coil is connected, then run {action}.",
                action=CALIBRATE_STATIC,
            ),
            conductance,
        )
    elif not 1.0 - RESISTANCE_OFF < _resting_ratio(voltage, current) * device.coil_resistance_ohm < 1 + RESISTANCE_OFF:
        yield QualityFinding(
            "coil_resistance",
            "look",
            Message(
                "quality.coil_resistance",
                "The coil's resistance is about {found:.1f} Ω; {expected:.1f} Ω was expected.",
                found=1.0 / _resting_ratio(voltage, current),
                expected=device.coil_resistance_ohm,
            ),
            Message("quality.coil_resistance.advice", "Run {action} before the next test.", action=CALIBRATE_STATIC),
            1.0 / _resting_ratio(voltage, current),
        )


def _slope(x: np.ndarray, y: np.ndarray) -> float:
    deviations = x - x.mean()
    return float(deviations @ (y - y.mean()) / (deviations @ deviations))


def _least_slope(x: np.ndarray, y: np.ndarray, window: int) -> float:
    """Return the minimum slope of y against x over windows of ``window`` samples in which x varies sufficiently."""
    moving, slopes = 0.5 * float(x.std()), [_slope(x, y)]
    for first in range(0, x.size - window + 1, max(2, window)):
        part = slice(first, first + window)
        if window >= 2 and float(x[part].std()) > moving:
            slopes.append(_slope(x[part], y[part]))
    return min(slopes)


def _resting_ratio(voltage: np.ndarray, current: np.ndarray) -> float:
    """Return mean current over mean voltage, which cancels the back-EMF; the slope if the means are small."""
    level = float(voltage.mean())
    return float(current.mean()) / level if abs(level) > 0.5 * float(voltage.std()) else _slope(voltage, current)


def check_linear_region(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report positions outside the range in which the calibrated coil is linear."""
    calibration = prepared.device.calibration
    low, high = calibration.get("linear_region_min_m"), calibration.get("linear_region_max_m")
    position = prepared.stimulus("position")
    if not isinstance(low, int | float) or not isinstance(high, int | float) or not position.size or not low < high:
        return
    share = float(np.mean((position < low) | (position > high)))
    if share == 0.0:
        return
    compensated = USED_NOTE in prepared.test.notes  # by the force constant at each position
    yield QualityFinding(
        "outside_linear_region",
        "look" if share > OUTSIDE_SHARE and not compensated else "note",
        Message(
            "quality.outside_linear_region",
            "For {percent:.1f} % of the test the probe was outside the range of {low:.1f} to {high:.1f} mm in which "
            "the coil is linear.",
            percent=100 * share,
            low=1e3 * low,
            high=1e3 * high,
        ),
        marked("Place the instrument so that the probe stays inside: outside, the force is less certain.")
        if compensated
        else marked("Place the instrument so that the probe stays inside: outside, the displayed force is too high."),
        share,
    )


def check_temperature(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a coil that is hot or was heated considerably by the test."""
    signal = prepared.signal("temperature")
    if signal is None:
        return
    temperatures = signal[np.isfinite(signal)]
    tenth = max(1, temperatures.size // 10)
    # Means suppress the noise of single samples.
    begin, end = float(temperatures[:tenth].mean()), float(temperatures[-tenth:].mean())
    hottest = max(begin, end)
    limit_c = _limit(prepared, "limit_max_temperature_c", np.nan)
    test = prepared.test
    too_hot = test.status == "aborted" and not _TOO_HOT.isdisjoint(reason_codes(test.reason))
    if too_hot and float(temperatures.max()) < limit_c:
        yield QualityFinding(
            "coil_warm",
            "look",
            Message(
                "quality.coil_warm.calculated",
                "The temperature calculated from the current ended the test: the winding reached the limit of "
                "{limit:.0f} °C. The sensor lags and read {read:.0f} °C.",
                limit=limit_c,
                read=hottest,
            ),
            marked("Let the coil cool for some minutes, and pause between repeats."),
            limit_c,
        )
    elif hottest > WARM_C:
        yield QualityFinding(
            "coil_warm",
            "look" if hottest > HOT_C else "note",
            Message("quality.coil_warm", "The coil was at {hottest:.0f} °C.", hottest=hottest),
            marked("Let it cool before the next test, and keep it off the skin."),
            hottest,
        )
    elif end - begin > WARMED_K:
        yield QualityFinding(
            "coil_warmed",
            "note",
            Message(
                "quality.coil_warmed",
                "The coil warmed by {kelvin:.0f} K in this test, which raised its resistance by about {percent:.0f} %.",
                kelvin=end - begin,
                percent=100 * _COPPER_PER_K * (end - begin),
            ),
            marked("The force is measured from the current and stays valid. Pause between tests."),
            end - begin,
        )


def check_calibration(prepared: PreparedTest) -> Iterator[QualityFinding]:
    """Report a missing, outdated or failed calibration, and its warnings."""
    calibration = prepared.device.calibration
    state = calibration.get("state")
    device_warnings = prepared.device.calibration_warnings
    warnings = Listing(device_warnings, "; ", "; ")
    if not calibration and IMPORTED in prepared.test.notes:
        return  # imported tests carry no calibration information
    if not calibration or state == "none":
        yield QualityFinding(
            "calibration_none",
            "note",
            Message("quality.calibration_none", "The instrument was not calibrated: its nominal values were used."),
            Message(
                "quality.calibration_none.advice",
                "Run {action} before measurements that are to be compared.",
                action=CALIBRATE_STATIC,
            ),
        )
    elif state == "stale":
        yield QualityFinding(
            "calibration_stale",
            "look",
            Message("quality.calibration_stale", "The calibration is out of date: {warnings}.", warnings=warnings)
            if device_warnings
            else Message("quality.calibration_stale", "The calibration is out of date."),
            Message(
                "quality.calibration_stale.advice",
                "Run {static}, and also {sweep} if the sweep is out of date.",
                static=CALIBRATE_STATIC,
                sweep=CALIBRATE_SWEEP,
            ),
        )
    elif calibration.get("verdict") == "failed" or state not in (None, "valid"):
        yield QualityFinding(
            "calibration_failed",
            "look",
            Message(
                "quality.calibration_failed", "The active calibration is not reliable: {warnings}.", warnings=warnings
            )
            if device_warnings
            else Message("quality.calibration_failed", "The active calibration is not reliable."),
            marked("Have the instrument calibrated before the next test."),
        )
    elif device_warnings:
        yield QualityFinding(
            "calibration_warning",
            "note",
            Message("quality.calibration_warning", "Calibration: {warnings}.", warnings=warnings),
            "",
        )
