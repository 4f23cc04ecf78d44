"""Calibrations of an instrument: procedures, files, comparison, and selection of the active calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tissueid.lazy_import import lazy_attributes

if TYPE_CHECKING:
    from tissueid.calibration.active import (
        ActiveCalibration,
        activate_calibration,
        apply_calibrations,
        calibration_summary,
    )
    from tissueid.calibration.coil import ElectricalCheck, check_coil
    from tissueid.calibration.file import (
        CalibratedQuantity,
        Calibration,
        read_calibration,
        save_calibration,
        write_calibration,
    )
    from tissueid.calibration.plans import StaticPlan
    from tissueid.calibration.static_procedure import StaticCalibration, calibrate_static
    from tissueid.calibration.status import (
        Stored,
        calibration_folder,
        create_calibration_folder,
        free_name,
        is_in_calibration_folder,
        stored_calibrations,
    )
else:
    __getattr__ = lazy_attributes(
        __name__,
        {
            "coil": ("ElectricalCheck", "check_coil"),
            "file": ("Calibration", "CalibratedQuantity", "save_calibration", "read_calibration", "write_calibration"),
            "active": (
                "ActiveCalibration",
                "activate_calibration",
                "calibration_summary",
                "apply_calibrations",
            ),
            "plans": ("StaticPlan",),
            "static_procedure": ("StaticCalibration", "calibrate_static"),
            "status": (
                "Stored",
                "calibration_folder",
                "free_name",
                "is_in_calibration_folder",
                "create_calibration_folder",
                "stored_calibrations",
            ),
        },
    )

__all__ = [
    "ActiveCalibration",
    "CalibratedQuantity",
    "Calibration",
    "ElectricalCheck",
    "StaticCalibration",
    "StaticPlan",
    "Stored",
    "activate_calibration",
    "apply_calibrations",
    "calibrate_static",
    "calibration_folder",
    "calibration_summary",
    "check_coil",
    "create_calibration_folder",
    "free_name",
    "is_in_calibration_folder",
    "read_calibration",
    "save_calibration",
    "stored_calibrations",
    "write_calibration",
]
