"""Calibrations of the instrument: where its figures come from, and which are in force."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tissueid.calibration.active import InForce, calibrated, in_words, put_in_force, warnings_of
    from tissueid.calibration.coil_check import ElectricalCheck, check_coil
    from tissueid.calibration.file import Calibration, Quantity, keep_calibration, read_calibration, write_calibration
    from tissueid.calibration.static import StaticCalibration, calibrate_static
    from tissueid.calibration.static_procedure import StaticPlan
    from tissueid.calibration.store import (
        Stored,
        calibration_folder,
        free_name,
        is_filed,
        made_folder,
        stored_calibrations,
    )
else:
    __getattr__ = lazy_attributes(
        __name__,
        {
            "coil_check": ("ElectricalCheck", "check_coil"),
            "file": ("Calibration", "Quantity", "keep_calibration", "read_calibration", "write_calibration"),
            "active": ("InForce", "calibrated", "in_words", "put_in_force", "warnings_of"),
            "static_procedure": ("StaticPlan",),
            "static": ("StaticCalibration", "calibrate_static"),
            "store": ("Stored", "calibration_folder", "free_name", "is_filed", "made_folder", "stored_calibrations"),
        },
    )

__all__ = [
    "Calibration",
    "ElectricalCheck",
    "InForce",
    "Quantity",
    "StaticCalibration",
    "StaticPlan",
    "Stored",
    "calibrate_static",
    "calibrated",
    "calibration_folder",
    "check_coil",
    "free_name",
    "in_words",
    "is_filed",
    "keep_calibration",
    "made_folder",
    "put_in_force",
    "read_calibration",
    "stored_calibrations",
    "warnings_of",
    "write_calibration",
]
