"""Calibrations of one device as they lie in a folder, made some days before a fixed day."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from tissueid.calibration import CalibratedQuantity, Calibration, Stored
from tissueid.calibration.file import utc_date
from tissueid.device import DeviceDescription

NOW = datetime(2026, 6, 1, 12, 0, tzinfo=UTC)
DEVICE = DeviceDescription(serial_number="A-1")


def quantities(**figures):
    return {name: CalibratedQuantity(value=value, std=abs(value) * 1e-3) for name, value in figures.items()}


def made(days_ago=10.0, kind="static", **changes):
    figures = (
        {"coil_resistance_ohm": 12.3, "force_constant_n_per_a": 2.9, "current_offset_a": 0.01}
        if kind == "static"
        else {"moving_mass_kg": 0.066, "linear_region_min_m": 0.004, "linear_region_max_m": 0.0275}
    )
    content = {
        "kind": kind,
        "model": DEVICE.model,
        "serial_number": DEVICE.serial_number,
        "date": utc_date(NOW - timedelta(days=days_ago)),
        "software": "tissueid 0",
        "verdict": "passed",
        "quantities": quantities(**figures | changes.pop("figures", {})),
    }
    return Stored(Path(f"{kind}-{days_ago:g}.toml"), Calibration(**content | changes))
